#!/usr/bin/env bash
# openpyxl 3.1.5, Python 3.11: in a row that is read only, the empty cell cannot be counted or looked for.
#
# Guess: EMPTY_CELL stands in every gap of a row, as one object; tuple.count and "in" compare with ==, which is there.
# Seen: a filled cell compares all its fields with those of the other, and the empty one has none of its own: each filled
# cell in front of it raises AttributeError. Values have to be compared, or identities.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet openpyxl==3.1.5
cat > "$folder/seen.py" <<'PYTHON'
from importlib.metadata import version

import openpyxl
from openpyxl.cell.read_only import EMPTY_CELL

print("openpyxl", version("openpyxl"))
book = openpyxl.Workbook()
book.active.append([1.5, None, 2.5])
book.save("a.xlsx")
((*row,),) = openpyxl.load_workbook("a.xlsx", read_only=True).active.iter_rows()
print("the gap is the empty cell:", row[1] is EMPTY_CELL, "and equals itself:", row[1] == EMPTY_CELL)
for what, look in (("count", lambda: row.count(EMPTY_CELL)), ("in", lambda: EMPTY_CELL in row)):
    try:
        print(what, look())
    except AttributeError as error:
        print(what, "raises AttributeError:", error)
print("values:", [cell.value for cell in row].count(None))
PYTHON
(cd "$folder" && venv/bin/python -W error::DeprecationWarning seen.py) > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
openpyxl 3.1.5
the gap is the empty cell: True and equals itself: True
count raises AttributeError: 'EmptyCell' object has no attribute 'parent'
in raises AttributeError: 'EmptyCell' object has no attribute 'parent'
values: 1
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
