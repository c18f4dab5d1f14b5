#!/usr/bin/env bash
# h5py 3.16.0, Python 3.11: 40 000 written to a dataset of 16 bits becomes 32 767, and 1.7 becomes 1.
#
# Guess: numbers that the type of the dataset cannot hold are refused, or wrap around as NumPy's cast does.
# Seen: HDF5 converts: values beyond the type are clipped at its ends and fractions cut off, without an error or a
# warning. A recording that was scaled before it was stored as counts looks clipped by its amplifier.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet h5py==3.16.0 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import warnings
from importlib.metadata import version

import h5py
import numpy as np

warnings.simplefilter("error")
print("h5py", version("h5py"))
with h5py.File("a.h5", "w") as file:
    counts = file.create_dataset("counts", (4,), "i2")
    counts[...] = np.array([1.7, -1.7, 40_000.0, -1e9])
    print("numbers:", *counts[...].tolist())
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
h5py 3.16.0
numbers: 1 -1 32767 -32768
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
