"""The schema: migrations up and down with data in it, equal to the tables, on SQLite and on PostgreSQL."""

import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import JSON, Connection, MetaData, inspect, select, text
from sqlalchemy.orm import Session as DatabaseSession

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from service.documents.measurement import with_trend
from service.errors import DataFolderError, StorageError
from service.operations.monitoring.trend import extremes
from service.store import intake
from service.store.database import Database, alembic_config, reading, writing
from service.store.intake import MeasurementRecord
from service.store.tables import AxisRow, Base, MeasurementDocumentRow, MeasurementRow, WindowRow
from service.store.trend.points import Span, TrendPoint, add_point, point_of
from service.store.trend.rollups import sum_up
from tests.service.conftest import START, Api, emptied, running_service, simulated_measurement
from tests.service.test_jobs import wait_for

HOUR = timedelta(hours=1)
LATER = START + HOUR


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


def test_a_connection_to_a_file_is_used_again_unless_it_failed(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'preload.db'}")
    database.migrate()
    kept = list[Connection]()  # so that no new one has the identity of an old one

    def opened() -> set[int]:
        with database.connect() as connection, database.connect() as beside, reading(connection), reading(beside):
            found = (connection, beside)
        kept.extend(found)
        return set(map(id, found))

    def failing() -> None:
        with database.connect() as connection, reading(connection):
            connection.execute(text("SELECT * FROM missing"))

    def given_up() -> None:
        with database.connect() as connection, writing(connection):
            connection.execute(text("DELETE FROM alembic_version"))
            raise LookupError

    first = opened()
    assert len(first) == 2
    assert opened() == first
    with pytest.raises(StorageError, match="no such table"):
        failing()
    assert len(opened() & first) == 1  # the other one is new
    with pytest.raises(LookupError):
        given_up()
    with database.connect() as connection, reading(connection):
        assert connection.execute(text("SELECT count(*) FROM alembic_version")).scalar() == 1
    database.close()
    assert not list(tmp_path.glob("*-wal")), "a connection is still open"


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


def test_downgrade_that_would_lose_something_is_refused_and_changes_nothing(database_url: str, tmp_path: Path) -> None:
    with running_service(tmp_path / "var", database_url=database_url) as api:
        fill(api)
    database = Database(database_url)

    def content() -> list[object]:
        with database.connect() as connection, reading(connection):
            names = sorted(inspect(connection).get_table_names())
            return [(name, connection.execute(text(f"SELECT * FROM {name}")).all()) for name in names]  # noqa: S608

    before = content()
    with pytest.raises(DataFolderError, match="every axis"), database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "0004")
    assert content() == before
    database.close()


def test_downgrade_keeps_uploaded_recordings(database_url: str, tmp_path: Path) -> None:
    """With a recording 0009 is not left; without one it is, and comes back."""
    session = Session("axis", tuple(simulated_measurement(np.random.default_rng(1), "m", n_windows=8)))
    write_session(tmp_path / "m.session.h5", session)
    with running_service(tmp_path / "var", database_url=database_url) as api:
        api.register("axis", windows_per_measurement=8)
        with (tmp_path / "m.session.h5").open("rb") as file:
            job = api.http.post("/v1/axes/axis/recordings", files={"file": file}).json()
        wait_for(api, job["id"], "done")
        assert len(api.trend("axis")) == 1
    database = Database(database_url)
    with pytest.raises(DataFolderError, match="recordings"), database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "0008")
    database.close()
    with running_service(tmp_path / "var", database_url=database_url) as api:
        number = job["arguments"]["recording"]
        assert api.http.delete(f"/v1/axes/axis/recordings/{number}").json()["windows_stay"] == 8
    database = Database(database_url)
    with database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "0008")
        assert "recordings" not in inspect(connection).get_table_names()
    database.migrate()
    database.close()
    with running_service(tmp_path / "var", database_url=database_url) as api:
        assert api.http.get("/v1/axes/axis/recordings").json()["recordings"] == []


def test_jobs_that_recordings_name_pass_0012_both_ways(database_url: str, tmp_path: Path) -> None:
    """Their table is made anew on SQLite while rows refer to it; a pin is not left behind."""
    session = Session("axis", tuple(simulated_measurement(np.random.default_rng(1), "m", n_windows=8)))
    write_session(tmp_path / "m.session.h5", session)
    with running_service(tmp_path / "var", database_url=database_url) as api:
        api.register("axis", windows_per_measurement=8)
        with (tmp_path / "m.session.h5").open("rb") as file:
            job = api.http.post("/v1/axes/axis/recordings", files={"file": file}).json()
        wait_for(api, job["id"], "done")
        expected = [api.http.get(path).json() for path in ("/v1/jobs", "/v1/axes/axis/recordings")], answers(api)
        pin = api.http.post("/v1/axes/axis/pins", json={"measurement": 1, "reason": "test"}).json()["id"]
    database = Database(database_url)
    with pytest.raises(DataFolderError, match="pins"), database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "0011")
    with running_service(tmp_path / "var", database_url=database_url) as api:
        assert api.http.delete(f"/v1/axes/axis/pins/{pin}").status_code == 200
    with database.connect() as connection, writing(connection):
        command.downgrade(alembic_config(connection), "0011")
    database.migrate()
    database.close()
    with running_service(tmp_path / "var", database_url=database_url) as api:
        found = [api.http.get(path).json() for path in ("/v1/jobs", "/v1/axes/axis/recordings")], answers(api)
        assert found == expected


def test_database_of_an_older_version_says_what_it_said(database_url: str, tmp_path: Path) -> None:
    """Everything that was stored before 0005, put down as it was then, is answered with as it is now."""
    with running_service(tmp_path / "var") as api:
        fill(api)
        windows = simulated_measurement(np.random.default_rng(2), "refused", n_windows=4, started_at=LATER)
        api.accept("axis", windows, complete=True)
        api.accept(
            "axis", simulated_measurement(np.random.default_rng(3), "open", n_windows=3, started_at=LATER + HOUR)
        )
        expected = answers(api)
    database, old = Database(f"sqlite:///{tmp_path}/var/preload.db"), Database(database_url)
    with old.connect() as connection, writing(connection):
        command.upgrade(alembic_config(connection), "0004")
    with database.read() as session, old.connect() as connection, writing(connection):
        put_down_as_before_0005(session, connection)
    database.close()
    old.migrate()
    with old.connect() as connection, reading(connection):
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
    old.close()
    with running_service(tmp_path / "var", database_url=database_url) as api:
        found = answers(api)
        assert found["trend"] == expected["trend"]
        assert found == expected
        api.accept(
            "axis", simulated_measurement(np.random.default_rng(4), "next", n_windows=8, started_at=LATER + 3 * HOUR)
        )
        assert api.trend("axis")[-1]["state"] == "learning"


def answers(api: Api) -> dict[str, object]:
    trend = api.trend("axis")
    return {
        "axis": api.axis("axis"),
        "trend": trend,
        "days": api.trend("axis", resolution=2),
        "measurements": [
            api.http.get(f"/v1/axes/axis/measurements/{point['measurement_id']}").json() for point in trend
        ],
    }


def put_down_as_before_0005(session: DatabaseSession, connection: Connection) -> None:
    """Copy a database into the tables of version 0004."""
    tables = MetaData()
    tables.reflect(connection)
    for name in ("axes", "calibrations", "calibration_activations", "measurements", "windows", "alarms"):
        rows = [dict(row._mapping) for row in session.connection().execute(select(Base.metadata.tables[name]))]
        if name == "measurements":
            rows = [row | said_of(session, row["id"], row["started_at"]) for row in rows]
        for row in rows:
            known = {column: value for column, value in row.items() if column in tables.tables[name].c}
            plain = {
                column: json.dumps(value) if isinstance(value, dict) else
                value.replace(tzinfo=None) if isinstance(value, datetime) else value
                for column, value in known.items()
            }  # fmt: skip
            kinds = tables.tables[name].c
            plain = {
                column: json.loads(value) if isinstance(kinds[column].type, JSON) and isinstance(value, str) else value
                for column, value in plain.items()
            }
            connection.execute(tables.tables[name].insert(), plain)
        if rows and connection.dialect.name == "postgresql" and name != "axes":
            connection.execute(text(f"SELECT setval(pg_get_serial_sequence('{name}', 'id'), {len(rows)})"))


def said_of(session: DatabaseSession, measurement_id: int, started_at: datetime) -> dict[str, object]:
    document = session.get(MeasurementDocumentRow, measurement_id)
    point = point_of(session.connection(), 1, started_at, measurement_id)
    if document is None or point is None:
        return dict.fromkeys(("outcome", "response", "monitor_state"))
    said = {name: getattr(point, name) for name in TrendPoint.__slots__}
    outcome = {name: value for name, value in with_trend(document.outcome, point).items() if "charted" not in name}
    return said | {"outcome": outcome, "response": document.response, "monitor_state": point.state}


@pytest.mark.release
def test_prepared_statements_read_what_mapped_rows_hold(database_url: str, tmp_path: Path) -> None:
    with running_service(tmp_path / "var", database_url=database_url) as api:
        fill(api)
        windows = simulated_measurement(np.random.default_rng(2), "open", n_windows=3, started_at=LATER)
        api.accept("axis", windows)
    starts = {window.started_at for window in windows[1:]}
    database = Database(database_url)
    with database.connect() as connection, reading(connection):
        axis = intake.read_axis(connection, "axis")
        measurements = intake.read_measurements(connection, "axis", {"m", "open", "new"})
        contents = intake.contents_at(connection, axis, starts | {LATER - timedelta(seconds=0.5)})
    with database.read() as session:
        row = session.get_one(AxisRow, "axis")
        assert all(getattr(axis, name) == getattr(row, name) for name in ("id", "configuration", "revision"))
        stored = {window.started_at: window.content_sha256 for window in session.scalars(select(WindowRow))}
        assert contents == {start: stored[start] for start in starts}
        assert axis.newest_window_at == max(stored)
        assert measurements.keys() == {"m", "open"}
        for row in session.scalars(select(MeasurementRow)):
            read = measurements[row.name]
            assert all(getattr(read, name) == getattr(row, name) for name in MeasurementRecord.__slots__)
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


def test_a_server_shows_that_another_service_has_written(postgresql: str) -> None:
    url = emptied(postgresql)
    database, other_service = Database(url), Database(url)
    database.migrate()
    before = database.revision()
    assert database.revision() == before
    with other_service.write() as session:
        session.execute(text("INSERT INTO notices (at, kind, subject, content) VALUES (now(), 'test', 'test', '{}')"))
    assert database.revision() != before
    database.close()
    other_service.close()


@pytest.mark.parametrize("resolution", [2, 10, 40])
def test_a_trend_that_is_drawn_coarsely_keeps_its_extremes(database_url: str, resolution: int) -> None:
    """From points, hours and days, with every fifth refused: what is kept is as stored, in order, low and high."""
    rng, begin = np.random.default_rng(resolution), START.replace(hour=3)
    points = [
        TrendPoint(
            1, begin + i * timedelta(minutes=10), i + 1, f"m{i}", 100.0, None, None, None,
            "low-coherence" if refused else None, None, None, None if refused else float(rng.normal(300.0, 10.0)),
            None, None, None, None, None, 1, None, "normal", None,
        )
        for i in range(400)
        for refused in [i % 5 == 4]
    ]  # fmt: skip
    database = Database(database_url)
    database.migrate()
    with database.connect() as connection, writing(connection):
        for point in points:
            add_point(connection, point)
        sum_up(connection, 1, [point.at for point in points])
    spans = [Span(), *(Span(points[i].at, points[j].at) for i, j in np.sort(rng.integers(0, 400, (10, 2))))]
    with database.connect() as connection, reading(connection):
        for span in spans:
            within = [p for p in points if (span.start or p.at) <= p.at and (span.end is None or p.at < span.end)]
            drawn = extremes(connection, 1, span, resolution)
            assert len(drawn) <= resolution
            assert drawn == [point for point in within if point in drawn]
            judged = sorted(point.preload_n for point in within if point.preload_n is not None)
            shown = [point.preload_n for point in drawn if point.preload_n is not None]
            assert (min(shown), max(shown)) == (judged[0], judged[-1]) if judged else not shown
    database.close()
