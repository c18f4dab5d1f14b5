#!/usr/bin/env bash
# pandas 3.1.1, Python 3.11: a comma at the end of each row gives every column the name of its neighbour.
#
# Guess: rows that end with a separator, as many loggers write them, have one more column, which is empty and unnamed,
# or are refused: there are three names and four cells.
# Seen: read_csv takes the first column for the index and moves the names by one: "time" holds the force, "force" the
# acceleration, and the last one is empty. No warning. index_col=False keeps them in place.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet pandas==3.1.1 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import io
import warnings
from importlib.metadata import version

import pandas as pd

warnings.simplefilter("error")
print("pandas", version("pandas"))
text = "time,force,acceleration\n0.0,300,-1,\n0.1,301,-2,\n"
print("as it is:", pd.read_csv(io.StringIO(text)).to_dict("list"))
print("index_col=False:", pd.read_csv(io.StringIO(text), index_col=False).to_dict("list"))
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
pandas 3.1.1
as it is: {'time': [300, 301], 'force': [-1, -2], 'acceleration': [nan, nan]}
index_col=False: {'time': [0.0, 0.1], 'force': [300, 301], 'acceleration': [-1, -2]}
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
