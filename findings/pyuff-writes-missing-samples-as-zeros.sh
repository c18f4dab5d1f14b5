#!/usr/bin/env bash
# pyuff 2.5.8, Python 3.11: a sample that is not a number is written as 0, and in the caller's data too.
#
# Guess: NaN stands for a missing sample and goes into the file as it is, or is refused; what is handed over is not
# changed.
# Seen: write_sets replaces data by numpy.nan_to_num(data) in the dictionary that it was given: NaN becomes 0.0, an
# infinite value 1.8e308. A gap in a record reads back as a rest at zero, and the caller's own dictionary has it too.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet pyuff==2.5.8
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
import pyuff

print("pyuff", version("pyuff"))
POINTS = {
    "rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1, "abscissa_spec_data_type": 17,
    "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0,
}  # fmt: skip
data_set = pyuff.prepare_58(
    binary=0, id1="force", func_type=1, ord_data_type=4, **POINTS, num_pts=4, abscissa_spacing=1, abscissa_inc=0.5,
    data=np.array([1.0, np.nan, 3.0, 4.0]), x=0.5 * np.arange(4),
)
pyuff.UFF("a.uff").write_sets(data_set, "add")
print("written:", *pyuff.UFF("a.uff").read_sets(0)["data"])
print("the caller has:", *data_set["data"])
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
pyuff 2.5.8
written: 1.0 0.0 3.0 4.0
the caller has: 1.0 0.0 3.0 4.0
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
