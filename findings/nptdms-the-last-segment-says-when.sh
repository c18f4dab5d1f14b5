#!/usr/bin/env bash
# npTDMS 1.13.0, Python 3.11: a recorder that was stopped and started again gives one record with the times of the
# last part.
#
# Guess: time_track() follows the segments: each has a step and a start of its own, which a TDMS file states anew
# where they change.
# Seen: properties are those of the last segment that states them, and time_track() takes them for all samples: a
# record that began at 06:00 at 10 Hz and went on at 07:00 at 5 Hz becomes one at 5 Hz without a gap that begins at
# 07:00.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet npTDMS==1.13.0 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

print("npTDMS", version("npTDMS"))
with TdmsWriter("a.tdms") as writer:
    for hour, step in (("06", 0.1), ("07", 0.2)):
        stated = {
            "wf_increment": step, "wf_start_offset": 0.0, "wf_start_time": np.datetime64(f"2025-03-01T{hour}:00:00"),
        }
        writer.write_segment([ChannelObject("g", "a", np.arange(3.0), properties=stated)])
channel = TdmsFile.read("a.tdms")["g"]["a"]
print("seconds:", *(f"{t:g}" for t in channel.time_track()))
print("begins:", str(channel.time_track(absolute_time=True)[0])[:19])
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
npTDMS 1.13.0
seconds: 0 0.2 0.4 0.6 0.8 1
begins: 2025-03-01T07:00:00
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
