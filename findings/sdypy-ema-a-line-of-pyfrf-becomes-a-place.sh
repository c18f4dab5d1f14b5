#!/usr/bin/env bash
# sdypy-EMA 0.31.0 with pyFRF 1.5.0, Python 3.11: what one hands over is no longer what the other takes.
#
# Guess: Model(pyfrf=True).add_frf(frf) adds one place with a response at each line, in the form that the model states.
# Seen: a response of 1025 lines becomes 1025 places with one line each, a second one 2050. pyFRF 1.5 gives three
# axes (responses, inputs, lines), and they are stacked as if there were one. What is taken is the receptance, while
# the model's default goes on calling it accelerance. add_frf says nothing; the search for poles raises an error about
# "0 data points".
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet sdypy-EMA==0.31.0 pyFRF==1.5.0 pyuff==2.5.8 numpy==2.4.6 scipy==1.17.1
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
import pyFRF
from sdypy.EMA import EMA

print("sdypy-EMA", version("sdypy-EMA"), "pyFRF", version("pyFRF"))
force = np.random.default_rng(1).standard_normal(2048)
response = pyFRF.FRF(2048, force, 2.0 * force, exc_type="f", resp_type="a", fft_len=2048)
print("pyFRF gives", response.get_FRF().shape)
model = EMA.Model(pyfrf=True, lower=20, upper=990)
for count in (1, 2):
    model.add_frf(response)
    print(f"{count} added: places x lines", model.frf.shape, "called", model.frf_form)
same = np.allclose(model.frf[1:1025, 0], response.get_FRF(form="receptance").ravel()[1:])
print("they are receptances:", same)
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" 2>"$folder/said" | tee "$folder/seen"
diff "$folder/seen" - <<'SEEN'
sdypy-EMA 0.31.0 pyFRF 1.5.0
pyFRF gives (1, 1, 1025)
1 added: places x lines (1025, 1) called accelerance
2 added: places x lines (2050, 1) called accelerance
they are receptances: True
SEEN
