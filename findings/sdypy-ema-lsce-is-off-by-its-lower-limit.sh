#!/usr/bin/env bash
# sdypy-EMA 0.31.0 (pyEMA is the same code), Python 3.11: the lower limit of a band moves the frequencies found in it.
#
# Guess: method="lsce" finds a resonance of 150 Hz at 150 Hz whatever band it is sought in, as method="lscf" does.
# Seen: from 0 Hz on 150.00 Hz, from 20 Hz on 152.68, from 50 Hz on 155.32, from 100 Hz on 155.62 Hz. With the band
# cut at the lower limit the step of the impulse response is longer, and that of the whole band is used: what is found
# is lower + (f - lower) * upper / (upper - lower). The damping is off alike. Its default lower limit is 50 Hz.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet sdypy-EMA==0.31.0 pyuff==2.5.8 numpy==2.4.6 scipy==1.17.1
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import numpy as np
from sdypy.EMA import EMA

print("sdypy-EMA", version("sdypy-EMA"))
lines, natural = np.arange(0, 1000.5, 0.5), 2 * np.pi * 150.0
omega = 2 * np.pi * lines
receptance = 0.5 / (natural**2 - omega**2 + 2j * 0.02 * natural * omega)
for method, lower in (("lscf", 50), ("lsce", 0), ("lsce", 20), ("lsce", 50), ("lsce", 100)):
    model = EMA.Model(receptance[None], lines, lower=lower, upper=990, pol_order_high=30, frf_form="receptance")
    model.get_poles(method=method, show_progress=False)
    model.select_closest_poles([150.0])
    formula = lower + (150.0 - lower) * model.freq[-1] / (model.freq[-1] - lower)
    print(f"{method} from {lower} Hz on: {model.nat_freq[0]:.2f} Hz" + f" (formula: {formula:.2f})" * (method == "lsce"))
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" 2>"$folder/said" | tee "$folder/seen"
diff "$folder/seen" - <<'SEEN'
sdypy-EMA 0.31.0
lscf from 50 Hz on: 150.00 Hz
lsce from 0 Hz on: 150.00 Hz (formula: 150.00)
lsce from 20 Hz on: 152.68 Hz (formula: 152.68)
lsce from 50 Hz on: 155.32 Hz (formula: 155.32)
lsce from 100 Hz on: 155.62 Hz (formula: 155.62)
SEEN
