#!/usr/bin/env bash
# asammdf 8.8.28, Python 3.11: files that are joined in the wrong order become one record that never was.
#
# Guess: MDF.concatenate([second, first]) sorts by the starts that the headers state, leaves the hour between them, or
# refuses.
# Seen: the start of the file is the earliest, the samples of the first argument stand an hour later, as they should,
# and those of the earlier file follow them within a step, an hour and more after they were taken. With sync=False
# starts do not count at all, in either order: a pause of an hour is gone. Nothing is said.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet asammdf==8.8.28
cat > "$folder/seen.py" <<'PYTHON'
import datetime
from importlib.metadata import version

import numpy as np
from asammdf import MDF, Signal

print("asammdf", version("asammdf"))


def recorded(hour, value):
    file = MDF(version="4.10")
    file.append([Signal(np.full(2, float(value)), np.array([0.0, 0.1]), name="a")])
    file.header.start_time = datetime.datetime(2025, 3, 1, hour, tzinfo=datetime.UTC)
    return file


for order, sync in (((5, 6), True), ((6, 5), True), ((5, 6), False)):
    joined = MDF.concatenate([recorded(hour, hour) for hour in order], sync=sync)
    signal = joined.get("a")
    print(f"{order}, sync={sync}:", *(f"{v:g} at {t:g} s" for v, t in zip(signal.samples, signal.timestamps)), sep="; ")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
asammdf 8.8.28
(5, 6), sync=True:; 5 at 0 s; 5 at 0.1 s; 6 at 3600 s; 6 at 3600.1 s
(6, 5), sync=True:; 6 at 3600 s; 6 at 3600.1 s; 5 at 3600.2 s; 5 at 3600.3 s
(5, 6), sync=False:; 5 at 0 s; 5 at 0.1 s; 6 at 0.2 s; 6 at 0.3 s
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
