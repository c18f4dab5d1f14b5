#!/usr/bin/env bash
# NumPy 2.4.6, Python 3.11: columns are called by the words of a sentence, where a comment stands above their names.
#
# Guess: genfromtxt(names=True) leaves comments out and takes the names from the last row above the numbers.
# Seen: the first row counts, comment or not. "# 2 axes recorded" over "# time force acceleration" makes columns "2",
# "axes" and "recorded" if the words are as many as the columns, else a complaint of rows of other lengths.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import io
from importlib.metadata import version

import numpy as np

print("numpy", version("numpy"))
text = "# 2 axes recorded\n# time force acceleration\n0.0 300 -1\n0.1 301 -2\n"
print("names:", *np.genfromtxt(io.StringIO(text), names=True).dtype.names)
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
numpy 2.4.6
names: 2 axes recorded
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
