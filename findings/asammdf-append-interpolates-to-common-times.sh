#!/usr/bin/env bash
# asammdf 8.8.28, Python 3.11: two signals appended together with times of their own come back as values nobody
# measured.
#
# Guess: MDF.append([a, b]) keeps the samples of each, in one group if their times are the same and otherwise in two.
# Seen: signals of other times are brought to all times of both, by straight lines, and beyond their ends by their
# last value. Six values stand where three were measured, and nothing in the file says which ones. One append for each
# signal keeps them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet asammdf==8.8.28
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
from asammdf import MDF, Signal

print("asammdf", version("asammdf"))
early = Signal(np.array([0.0, 10.0, 20.0]), np.array([0.0, 0.1, 0.2]), name="early")
late = Signal(np.array([5.0, 15.0, 25.0]), np.array([0.05, 0.15, 0.25]), name="late")
together, apart = MDF(version="4.10"), MDF(version="4.10")
together.append([early, late])
for signal in (early, late):
    apart.append([signal])
for name, file in (("one append", together), ("an append for each", apart)):
    for channel in ("early", "late"):
        signal = file.get(channel)
        print(f"{name}, {channel}:", *(f"{v:g} at {t:g}" for v, t in zip(signal.samples, signal.timestamps)), sep="; ")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
asammdf 8.8.28
one append, early:; 0 at 0; 5 at 0.05; 10 at 0.1; 15 at 0.15; 20 at 0.2; 20 at 0.25
one append, late:; 5 at 0; 5 at 0.05; 10 at 0.1; 15 at 0.15; 20 at 0.2; 25 at 0.25
an append for each, early:; 0 at 0; 10 at 0.1; 20 at 0.2
an append for each, late:; 5 at 0.05; 15 at 0.15; 25 at 0.25
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
