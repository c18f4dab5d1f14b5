#!/usr/bin/env bash
# sdypy-EMA 0.31.0 (pyEMA is the same code), Python 3.11: frequencies that are handed over with a response are not used.
#
# Guess: Model(frf, freq) fits at the frequencies of freq, or refuses those that are not evenly spaced from zero on.
# Seen: one resonance at 150 Hz of known damping, computed exactly. Lines of 0, 0.5, 1 ... Hz give 150.00 Hz. A stepped
# sine whose lines are closer about the resonance gives 57.67 Hz, logarithmic lines none at all, and lines that begin
# at half a step give 150.21 Hz: the response counts as if its lines stood a step apart from zero on. Nothing is said.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet sdypy-EMA==0.31.0 pyuff==2.5.8 numpy==2.4.6 scipy==1.17.1
cat > "$folder/seen.py" <<'PYTHON'
import warnings
from importlib.metadata import version

import numpy as np
from sdypy.EMA import EMA

print("sdypy-EMA", version("sdypy-EMA"))


def frequency(lines):
    omega, natural = 2 * np.pi * lines, 2 * np.pi * 150.0
    receptance = 0.5 / (natural**2 - omega**2 + 2j * 0.02 * natural * omega)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # whatever it has to say ends this
        model = EMA.Model(receptance[None], lines, lower=20, upper=990, pol_order_high=30, frf_form="receptance")
        model.get_poles(show_progress=False)
        model.select_closest_poles([150.0])
    return f"{abs(model.nat_freq[0]):.2f} Hz"


stepped = np.concatenate([np.arange(20, 100, 2.0), np.arange(100, 200, 0.25), np.arange(200, 1000, 2.0)])
print("evenly from zero on:", frequency(np.arange(0, 1000.5, 0.5)))
print("evenly from half a step on:", frequency(np.arange(0.25, 1000, 0.5)))
print("closer about the resonance:", frequency(stepped))
print("logarithmic:", frequency(np.geomspace(20, 1000, 2000)))
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" 2>"$folder/said" | tee "$folder/seen"
diff "$folder/seen" - <<'SEEN'
sdypy-EMA 0.31.0
evenly from zero on: 150.00 Hz
evenly from half a step on: 150.21 Hz
closer about the resonance: 57.67 Hz
logarithmic: 0.00 Hz
SEEN
