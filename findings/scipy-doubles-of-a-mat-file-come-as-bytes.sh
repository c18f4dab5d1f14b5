#!/usr/bin/env bash
# SciPy 1.17.1, Python 3.11: an array that MATLAB calls double may be uint8 in Python, where 0 - 1 is 255.
#
# Guess: loadmat gives an array of the class double as float64.
# Seen: MATLAB stores whole numbers of an array of doubles in the smallest type that holds them, as its format allows,
# and loadmat gives that type. Whether counts of an encoder are bytes or doubles depends on their values on that day;
# a mean that is taken off in place, or a negated sample, wraps around without a word. mat_dtype=True gives doubles.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet scipy==1.17.1 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import struct
from importlib.metadata import version

import scipy.io

print("scipy", version("scipy"))
INT8, UINT8, INT32, UINT32, MATRIX, DOUBLE_CLASS = 1, 2, 5, 6, 14, 6


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


array = (
    element(UINT32, struct.pack("<II", DOUBLE_CLASS, 0)) + element(INT32, struct.pack("<ii", 1, 4))
    + element(INT8, b"counts") + element(UINT8, bytes([0, 1, 2, 3]))
)  # fmt: skip
with open("a.mat", "wb") as file:
    file.write(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49) + element(MATRIX, array))
for asked in (False, True):
    counts = scipy.io.loadmat("a.mat", mat_dtype=asked)["counts"]
    print(f"mat_dtype={asked}: {counts.dtype}, less one:", *(counts - 1).reshape(-1).tolist())
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
scipy 1.17.1
mat_dtype=False: uint8, less one: 255 0 1 2
mat_dtype=True: float64, less one: -1.0 0.0 1.0 2.0
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
