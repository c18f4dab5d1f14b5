#!/usr/bin/env bash
# npTDMS 1.13.0 with pandas 3.1.1, Python 3.11: channels that began three seconds apart stand in the same rows.
#
# Guess: as_dataframe(time_index=True) puts samples that were taken at one time into one row.
# Seen: the index is the relative time of each channel, and the zero of it is the channel's own wf_start_time, so that
# force and acceleration of two devices are compared three seconds apart. absolute_time=True keeps them apart.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet npTDMS==1.13.0 pandas==3.1.1 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

print("npTDMS", version("npTDMS"))
with TdmsWriter("a.tdms") as writer:
    writer.write_segment([
        ChannelObject("g", name, np.array([1.0, 2.0]), properties={
            "wf_increment": 1.0, "wf_start_offset": 0.0, "wf_start_time": np.datetime64(f"2025-03-01T06:00:0{second}"),
        })
        for name, second in (("force", 0), ("acceleration", 3))
    ])
for absolute in (False, True):
    frame = TdmsFile.read("a.tdms").as_dataframe(time_index=True, absolute_time=absolute)
    both = int(frame.notna().all(axis=1).sum())
    print(f"absolute_time={absolute}: {len(frame)} rows, {both} of them with both channels")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
npTDMS 1.13.0
absolute_time=False: 2 rows, 2 of them with both channels
absolute_time=True: 4 rows, 0 of them with both channels
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
