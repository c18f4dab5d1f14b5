#!/usr/bin/env bash
# pyuff 2.5.8, Python 3.11: a sampling rate of 1024 Hz is read back as 1024.0005 Hz.
#
# Guess: what write_sets writes, read_sets gives back: samples and step to the last bit where the set is binary.
# Seen: the step stands in the text of the header in six digits (%13.5e), in binary sets too, and the times x are made
# of it: 1/1024 s comes back as 0.000976562 s. Records of an hour end 1.8 ms late, and two recorders of one clock
# differ.
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
n = 3600 * 1024
for rate in (1024.0, 1000.0):
    times = np.arange(n) / rate
    data_set = pyuff.prepare_58(
        binary=1, id1="force", func_type=1, ord_data_type=4, **POINTS,
        num_pts=n, abscissa_spacing=1, abscissa_inc=1.0 / rate,
        data=np.zeros(n), x=times,
    )
    file = pyuff.UFF(f"{rate:g}.uff")
    file.write_sets(data_set, "add")
    read = pyuff.UFF(f"{rate:g}.uff").read_sets(0)
    late = 1e3 * (read["x"][-1] - times[-1])
    print(f"{rate:g} Hz: read as {1.0 / read['abscissa_inc']:.7g} Hz, the last of {n} samples {abs(late):.2f} ms off")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
pyuff 2.5.8
1024 Hz: read as 1024.001 Hz, the last of 3686400 samples 1.84 ms off
1000 Hz: read as 1000 Hz, the last of 3686400 samples 0.00 ms off
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
