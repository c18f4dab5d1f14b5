#!/usr/bin/env bash
# pyarrow 26.0.1, Python 3.11: instants of a zone come back without one where they are stored as INT96.
#
# Guess: a column that holds instants in UTC says so when it is read, however it is stored.
# Seen: INT96, which Spark and Impala write, has no mark for UTC, and pyarrow reads it as local time, in nanoseconds, if
# its own schema does not stand beside it. The same column as INT64 comes back in UTC. Who takes the first instant of a
# file for its start must know which of the two it is.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet pyarrow==26.0.1
cat > "$folder/seen.py" <<'PYTHON'
import datetime
from importlib.metadata import version

import pyarrow as pa
import pyarrow.parquet as pq

print("pyarrow", version("pyarrow"))
instants = pa.array([datetime.datetime(2025, 3, 1, 6, tzinfo=datetime.UTC)], pa.timestamp("us", "UTC"))
for old in (True, False):
    pq.write_table(pa.table({"t": instants}), "a.parquet", use_deprecated_int96_timestamps=old, store_schema=False)
    print(f"INT96 {old}: {pq.read_table('a.parquet').schema.field('t').type}")
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
pyarrow 26.0.1
INT96 True: timestamp[ns]
INT96 False: timestamp[us, tz=UTC]
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
