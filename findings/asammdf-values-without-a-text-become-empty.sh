#!/usr/bin/env bash
# asammdf 8.8.28, Python 3.11: of a channel whose conversion gives texts to some values only, the other values are lost.
#
# Guess: values 2 and 3, for which the table has no text and no default, come as numbers, as they stand in the file.
# Seen: get() and to_dataframe() answer an empty text for each of them; only raw=True tells 2 from 3. A status of *0 not
# available, 1 fault, else the measured value* shows nothing of what was measured.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet asammdf==8.8.28
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
from asammdf import MDF, Signal

print("asammdf", version("asammdf"))
texts = {"val_0": 0, "text_0": "not available", "val_1": 1, "text_1": "fault"}
with MDF(version="4.10") as file:
    file.append([Signal(np.array([0, 1, 2, 3], np.uint8), np.arange(4.0), name="state", conversion=texts)])
    file.save("a.mf4")
with MDF("a.mf4") as file:
    print("get:", *file.get("state").samples.tolist())
    print("raw:", *file.get("state", raw=True).samples.tolist())
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
asammdf 8.8.28
get: b'not available' b'fault' b'' b''
raw: 0 1 2 3
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
