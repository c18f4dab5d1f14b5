#!/usr/bin/env bash
# asammdf 8.8.28, Python 3.11: a reader writes to standard output.
#
# Guess: reading a channel part by part prints nothing, so that a program can print a JSON document of its own.
# Seen: where more than ten seconds pass between the first part and the end, whoever spends them, the generator behind
# MDF.iter_get prints a line of megabytes a second to standard output (blocks/mdf_v4.py, _load_data), between what the
# program prints. A long file, or a slow consumer, makes its output no JSON.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet asammdf==8.8.28 numpy==2.4.6
cat > "$folder/seen.py" <<'PYTHON'
import contextlib
import io
import time

import numpy as np
from asammdf import MDF, Signal

with MDF(version="4.10") as file:
    file.append([Signal(np.arange(1000.0), np.arange(1000) / 1000.0, name="torque")])
    file.save("a.mf4", overwrite=True)


def printed(seconds):
    with contextlib.redirect_stdout(io.StringIO()) as output, MDF("a.mf4", process_bus_logging=False) as file:
        for _ in file.iter_get("torque", samples_only=True):
            time.sleep(seconds)
    return "MB/s" in output.getvalue()


print("at once:", printed(0.0))
print("after eleven seconds:", printed(11.0))
PYTHON
(cd "$folder" && venv/bin/python seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
at once: False
after eleven seconds: True
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
