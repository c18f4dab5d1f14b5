#!/usr/bin/env bash
# SciPy 1.17.1, Python 3.11: of several objects of a MAT file (timetable, string, missing, …) the last alone is kept.
#
# Guess: loadmat gives each variable by its name; what it cannot read it gives as MatlabOpaque, or leaves out and says so.
# Seen: objects have no name where other variables have theirs, so all of them are called "None", each replaces the one
# before with a warning about a duplicate name. The name that MATLAB shows stands in the field s0 of what is left.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet scipy==1.17.1 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import struct
import warnings
from importlib.metadata import version

import scipy.io

print("scipy", version("scipy"))
INT8, INT32, UINT32, MATRIX, UINT32_CLASS, OPAQUE = 1, 5, 6, 14, 13, 17


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def an_object(name, of_class):
    place = element(UINT32, struct.pack("<II", UINT32_CLASS, 0)) + element(INT32, struct.pack("<ii", 1, 1))
    place += element(INT8, b"") + element(UINT32, struct.pack("<I", 1))
    texts = element(INT8, name) + element(INT8, b"MCOS") + element(INT8, of_class)
    return element(MATRIX, element(UINT32, struct.pack("<II", OPAQUE, 0)) + texts + element(MATRIX, place))


with open("a.mat", "wb") as file:
    file.write(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49))
    file.write(an_object(b"T", b"timetable") + an_object(b"m", b"missing"))
with warnings.catch_warnings(action="ignore"):
    read = {name: value for name, value in scipy.io.loadmat("a.mat").items() if not name.startswith("__")}
for name, value in read.items():
    print(name, type(value).__name__, value["s0"].item().decode(), value["s2"].item().decode())
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
scipy 1.17.1
None MatlabOpaque m missing
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
