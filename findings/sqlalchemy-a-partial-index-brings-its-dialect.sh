#!/usr/bin/env bash
# SQLAlchemy 2.1.9, Python 3.11: to state an index with `postgresql_where` imports the dialect of PostgreSQL, in a
# program that only ever opens SQLite.
#
# Guess: an option named `postgresql_where` is kept under its name until that dialect creates a table; with SQLite none
# of its modules is imported.
# Seen: `Index(...)` validates each option by the dialect in its prefix at once (sqlalchemy/sql/base.py,
# DialectKWArgs._validate_dialect_kwargs), for which it imports all of sqlalchemy.dialects.postgresql: some twenty
# modules at the start of every program that imports the tables.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet sqlalchemy==2.1.9
cat > "$folder/seen.py" <<'PYTHON'
import sys

import sqlalchemy as sa


def imported():
    return any(name.startswith("sqlalchemy.dialects.postgresql") for name in sys.modules)


table = sa.Table("parts", sa.MetaData(), sa.Column("id", sa.Integer, primary_key=True), sa.Column("state", sa.String))
sa.Index("plain", table.c.state)
print("after a plain index:", imported())
sa.Index("some", table.c.state, sqlite_where=table.c.state == "open")
print("after sqlite_where:", imported())
sa.Index("few", table.c.state, postgresql_where=table.c.state == "open")
print("after postgresql_where:", imported())
engine = sa.create_engine("sqlite://")
table.metadata.create_all(engine)
print("opened:", engine.dialect.name)
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
after a plain index: False
after sqlite_where: False
after postgresql_where: True
opened: sqlite
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
