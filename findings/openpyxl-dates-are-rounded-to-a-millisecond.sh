#!/usr/bin/env bash
# openpyxl 3.1.5, Python 3.11: times of a sheet come to the nearest millisecond, whatever the cell holds.
#
# Guess: a cell holds days as a double, which is good to 0.6 microseconds in our century, and datetime has microseconds:
# 1024 samples a second come back with their times.
# Seen: dates, times of day and durations are rounded to whole milliseconds when they are read. 1024 Hz become steps of
# 1 ms with now and then none; from 2 kHz on samples share a time.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet openpyxl==3.1.5
cat > "$folder/seen.py" <<'PYTHON'
import datetime
from importlib.metadata import version

import openpyxl

print("openpyxl", version("openpyxl"))
start = datetime.datetime(2025, 3, 1, 6)
book = openpyxl.Workbook()
for i in range(6):
    book.active.append([start + datetime.timedelta(seconds=i / 4096)])
book.save("a.xlsx")
cells = [cell for (cell,) in openpyxl.load_workbook("a.xlsx").active.iter_rows(values_only=True)]
print("written, in us:", *(round(i * 1e6 / 4096) for i in range(6)))
print("read, in us:", *(round((cell - start).total_seconds() * 1e6) for cell in cells))
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
openpyxl 3.1.5
written, in us: 0 244 488 732 977 1221
read, in us: 0 0 0 1000 1000 1000
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
