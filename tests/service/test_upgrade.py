"""Data folders of older programs: one is opened as it is, and says what it said; a still older one says what to do.

``older/0017.tar.xz`` was written by commit 7bd100f, the last whose schema grew by Alembic's migrations: a data folder
with an axis that lost its preload, its answers (``answers.json``), and its schema on PostgreSQL (``postgresql.sql``).
"""

import hashlib
import json
import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Column, Connection, MetaData, Table, inspect, text

from service.errors import DataFolderError
from service.store import schema
from service.store.database import Database, reading, writing
from service.store.tables import Base
from service.store.trend.lost_motion import CHARTS, LOST_MOTION, READINGS, ReadingChart, read_chart, readings_of
from service.store.trend.points import Span
from tests.service.conftest import START, emptied, running_service
from tests.service.test_older_folders import differences


@pytest.fixture
def older(tmp_path: Path) -> Path:
    with tarfile.open(Path(__file__).parent / "older" / "0017.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path


@pytest.fixture(params=["sqlite", "postgresql"])
def older_database(request: pytest.FixtureRequest, older: Path) -> Database:
    """Return a database whose tables an older program made."""
    if request.param == "sqlite":
        return Database(f"sqlite:///{older}/var/preload.db")
    database = Database(emptied(request.getfixturevalue("postgresql")))
    with database.connect() as connection, writing(connection):
        connection.execute(text((older / "postgresql.sql").read_text()))
        connection.execute(text("INSERT INTO alembic_version VALUES ('0017')"))
    return database


def tables_of(connection: Connection) -> dict[str, object]:
    """Describe every table: columns in any order, keys, indexes. Defaults are left out: no insert needs them."""
    inspector = inspect(connection)

    def described(table: str) -> dict[str, object]:
        return {
            "columns": {
                column["name"]: (str(column["type"]), column["nullable"]) for column in inspector.get_columns(table)
            },
            "primary key": inspector.get_pk_constraint(table),
            "foreign keys": sorted(
                (key["constrained_columns"], key["referred_table"], key["referred_columns"])
                for key in inspector.get_foreign_keys(table)
            ),
            "unique": sorted(map(str, inspector.get_unique_constraints(table))),
            "indexes": {
                index["name"]: (
                    index["column_names"],
                    index["unique"],
                    sorted((option, str(value)) for option, value in index.get("dialect_options", {}).items()),
                )
                for index in inspector.get_indexes(table)
            },
            "options": sorted(inspector.get_table_options(table).items()),
        }

    return {table: described(table) for table in inspector.get_table_names()}


def opened(database: Database) -> dict[str, object]:
    database.migrate()
    database.migrate()  # a second start finds nothing to do
    with database.connect() as connection, reading(connection):
        tables = tables_of(connection)
    database.close()
    return tables


def test_older_tables_are_those_of_a_new_database(older_database: Database, tmp_path: Path) -> None:
    upgraded = opened(older_database)
    url = older_database.engine.url.render_as_string(hide_password=False)
    new = Database(emptied(url) if "postgresql" in url else f"sqlite:///{tmp_path}/new.db")
    assert upgraded == opened(new)
    assert upgraded.keys() == Base.metadata.tables.keys()


def test_what_sqlite_knows_beyond_columns_is_the_same(older: Path, tmp_path: Path) -> None:
    """Whether a table has rows' own numbers, and whether these are given twice."""

    def kinds(path: Path) -> list[object]:
        with closing(sqlite3.connect(path)) as connection:
            return connection.execute(
                "SELECT t.name, wr, strict, sql LIKE '%AUTOINCREMENT%' "
                "FROM pragma_table_list t LEFT JOIN sqlite_master m ON m.name = t.name ORDER BY t.name"
            ).fetchall()

    opened(Database(f"sqlite:///{older}/var/preload.db"))
    opened(Database(f"sqlite:///{tmp_path}/new.db"))
    assert kinds(older / "var" / "preload.db") == kinds(tmp_path / "new.db")


#: A gate shows the limits of today: that of a frequency's uncertainty, 0.5 Hz once, is 0.3 % of the frequency. A
#: line through a step was called a rate, and the sessions of a projection measurements.
SAID_OTHERWISE = ("/gates/3/upper: 0.5 is 0.53", "/history/trend_line: ", "/projection/n_measurements: ")


def test_older_folder_says_what_it_said(older: Path) -> None:
    answers = json.loads((older / "answers.json").read_text())
    with running_service(older / "var") as api:
        for path, expected in answers.items():
            answer = api.http.get(path)
            is_json = "json" in answer.headers["content-type"]
            said = answer.json() if is_json else hashlib.sha256(answer.content).hexdigest()
            # evidence is computed anew, by a fit that reaches a tenth of the frequency where it was 20 Hz
            # the same, and charts are folded anew, whose sums may round otherwise
            within = 1e-3 if path.endswith("/evidence") else 1e-12
            # settings that are new come with their defaults
            other = differences(expected, said, path, within)
            assert [each for each in other if not any(known in each for known in SAID_OTHERWISE)] == []
        assert answers["/v1/alarms/1"]["status"] == "acknowledged"


def test_friction_that_an_older_program_counted_against_the_position_is_positive(older: Path) -> None:
    file = older / "var" / "preload.db"
    with closing(sqlite3.connect(file)) as connection:
        connection.execute(
            "UPDATE trend_points SET drag_torque_nm = CASE measurement_id % 2 WHEN 0 THEN -0.2 ELSE 0.2 END"
        )
        connection.commit()
    opened(Database(f"sqlite:///{file}"))
    with closing(sqlite3.connect(file)) as connection:
        found = connection.execute("SELECT drag_torque_nm FROM trend_points GROUP BY drag_torque_nm").fetchall()
    assert found == [(0.2,)]


def test_lost_motion_of_an_older_program_goes_on_beside_other_quantities(older_database: Database) -> None:
    """As version 0031 had it: a key without the quantity, and columns called after lost motion."""
    new = opened(older_database)
    was = {"value": "reversal_value_um", "n_repeats": "n_reversals"} | {
        name: f"{name}_um" for name in ("standard_uncertainty", "interval_lower", "interval_upper")
    }
    older = MetaData(naming_convention=Base.metadata.naming_convention)
    for table in (READINGS, CHARTS):
        held = [
            Column(
                was.get(column.name, column.name), column.type, primary_key=column.primary_key, nullable=column.nullable
            )
            for column in table.c
            if column.name not in {"quantity", "unit", "speed_mm_per_s"}
        ]
        Table(table.name, older, *held, sqlite_with_rowid=False)
    reading_then = {
        "axis_number": 1, "at": START, "name": "slow", "position_mm": 400.0, "reversal_value_um": 7.5,
        "standard_uncertainty_um": 0.02, "interval_lower_um": 7.4, "interval_upper_um": 7.6, "n_reversals": 9,
        "state": "normal", "found_in_order": False,
    }  # fmt: skip
    with older_database.connect() as connection, writing(connection):
        for table in (READINGS, CHARTS):
            table.drop(connection)
        older.create_all(connection)
        connection.execute(older.tables["lost_motion"].insert(), reading_then)
        connection.execute(
            older.tables["lost_motion_charts"].insert(), {"axis_number": 1, "state": {}, "place_mm": 400.0}
        )
        connection.execute(text("UPDATE alembic_version SET version_num = '0031'"))
    assert opened(older_database) == new
    with older_database.connect() as connection, reading(connection):
        (found,) = readings_of(connection, 1, LOST_MOTION, Span())
        assert read_chart(connection, 1, LOST_MOTION) == ReadingChart(1, LOST_MOTION, {}, 400.0)
    older_database.close()
    assert (found.at, found.value, found.unit, found.n_repeats, found.state) == (START, 7.5, "µm", 9, "normal")


@pytest.mark.parametrize("version", ["0001", "0016"])
def test_still_older_folder_says_what_to_do_and_is_left_alone(older: Path, version: str) -> None:
    file = older / "var" / "preload.db"
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", [version])
        connection.commit()
        before = list(connection.iterdump())
    what_to_do = f"of version {version}.*from 0017: run `preload user list` of commit 7bd100f"
    with pytest.raises(DataFolderError, match=what_to_do), running_service(older / "var"):
        pass
    with closing(sqlite3.connect(file)) as connection:
        assert list(connection.iterdump()) == before


def test_steps_lead_to_the_newest_version(older_database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that a database has not had yet, each once."""
    changes = ["CREATE TABLE tools (id INTEGER)", "ALTER TABLE tools ADD COLUMN a INTEGER", "DROP TABLE tools"]
    steps = [
        (f"{18 + i:04d}", lambda connection, change=change: connection.execute(text(change)))
        for i, change in enumerate(changes)
    ]
    for n_steps, columns in ((2, ["id", "a"]), (3, None)):
        monkeypatch.setattr(schema, "STEPS", steps[:n_steps])
        monkeypatch.setattr(schema, "VERSION", steps[n_steps - 1][0])
        tables = opened(older_database)
        assert (list(tables["tools"]["columns"]) if "tools" in tables else None) == columns
        with older_database.connect() as connection, reading(connection):
            assert connection.execute(text("SELECT version_num FROM alembic_version")).scalars().all() == [
                steps[n_steps - 1][0]
            ]
    older_database.close()
