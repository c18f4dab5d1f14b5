#!/usr/bin/env bash
# SciPy 1.17.1, Python 3.11: whole numbers of a WAV file of 24 bits come 256 times as large as they stand in the file.
#
# Guess: scipy.io.wavfile.read gives the counts of the converter, as it does for 16 and 32 bits.
# Seen: it puts the three bytes on top of an int32, so that full scale is 2**31. A sensitivity in counts, taken from the
# data sheet of a converter of 24 bits, is then off by 256. The module wave of Python's own gives the three bytes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet scipy==1.17.1 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import wave
from importlib.metadata import version

import scipy.io.wavfile

print("scipy", version("scipy"))
counts = [1, -1, 1000, 2**23 - 1]
for width in (2, 3, 4):
    stored = [count for count in counts if count < 2 ** (8 * width - 1)]
    with wave.open("a.wav", "wb") as file:
        file.setparams((1, width, 51200, 0, "NONE", "NONE"))
        file.writeframes(b"".join(count.to_bytes(width, "little", signed=True) for count in stored))
    _, read = scipy.io.wavfile.read("a.wav")
    print(f"{8 * width} bits, {read.dtype}:", *(f"{a} is read as {b}" for a, b in zip(stored, read.tolist())), sep="; ")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
scipy 1.17.1
16 bits, int16:; 1 is read as 1; -1 is read as -1; 1000 is read as 1000
24 bits, int32:; 1 is read as 256; -1 is read as -256; 1000 is read as 256000; 8388607 is read as 2147483392
32 bits, int32:; 1 is read as 1; -1 is read as -1; 1000 is read as 1000; 8388607 is read as 8388607
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
