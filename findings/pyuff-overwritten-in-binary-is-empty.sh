#!/usr/bin/env bash
# pyuff 2.5.8, Python 3.11: a data set 58b that is written in the mode "overwrite" leaves a file of its last line
# alone.
#
# Guess: write_sets(set, "overwrite") with binary=1 makes a file with one data set, as it does with binary=0; the mode
# says what becomes of the file that was there before.
# Seen: _write58 closes the file behind the header and opens it again in the same mode, once for the samples and once
# for the closing "    -1". In the mode "overwrite" each of them empties it: 7 bytes are left, and nothing is said. In
# the default mode, "add", header and samples stay.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet pyuff==2.5.8
cat > "$folder/seen.py" <<'PYTHON'
import pathlib
from importlib.metadata import version

import numpy as np
import pyuff

print("pyuff", version("pyuff"))
POINTS = {
    "rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1, "abscissa_spec_data_type": 17,
    "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0,
}  # fmt: skip
samples = np.arange(1.0, 9.0)
for mode in ("add", "overwrite"):
    for binary in (0, 1):
        path = pathlib.Path(f"{mode}-{binary}.uff")
        data_set = pyuff.prepare_58(
            binary=binary, id1="force", func_type=1, ord_data_type=4, **POINTS,
            num_pts=8, abscissa_spacing=1, abscissa_inc=0.5,
            data=samples, x=0.5 * np.arange(8),
        )
        pyuff.UFF(str(path)).write_sets(data_set, mode)
        kept = pyuff.UFF(str(path)).get_n_sets()
        print(f"{mode}, binary={binary}: {path.stat().st_size} bytes, {kept} data sets")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
pyuff 2.5.8
add, binary=0: 1085 bytes, 1 data sets
add, binary=1: 986 bytes, 1 data sets
overwrite, binary=0: 1085 bytes, 1 data sets
overwrite, binary=1: 7 bytes, 0 data sets
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
