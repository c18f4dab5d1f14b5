"""The schema: migrations up and down with data in it, equal to the tables, on SQLite and on PostgreSQL."""

from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select, text, update

from service.errors import StorageError
from service.operations.monitoring.extremes import extremes
from service.store import axes, intake
from service.store.database import Database, reading, writing
from service.store.intake import MeasurementRecord
from service.store.tables import AxisRow, Base, MeasurementRow, WindowRow
from service.store.trend.points import Span, TrendPoint, add_point
from service.store.trend.rollups import DAY, HOUR, begin_of, leave_out_set_preloads, rollups, sum_up
from tests.conftest import canary
from tests.service.conftest import START, Api, emptied, running_service, simulated_measurement
from tests.service.test_lost_motion import HEALTHY, alarms_of, history, send, told

LATER, LAST = START + HOUR, START + timedelta(days=99)


@pytest.fixture(params=canary(["sqlite", "postgresql"]))
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/preload.db"
    return emptied(request.getfixturevalue("postgresql"))


def test_answers_of_one_moment_know_nothing_of_what_is_written_meanwhile(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'preload.db'}")
    database.migrate()

    def n_axes() -> int:
        with database.read() as session:
            return len(axes.names(session))

    with database.at_one_moment():
        before = n_axes()
        with database.write() as session:
            axis = axes.new_axis(session, "axis", START)
            axis.name, axis.configuration, axis.detector_design = "axis", {}, {}
            session.add(axis)
        assert n_axes() == before == 0
    assert n_axes() == 1


def fill(api: Api) -> None:
    """Put a row into nearly every table."""
    api.register("axis", windows_per_measurement=8)
    api.calibrate("axis")
    api.accept("axis", simulated_measurement(np.random.default_rng(1), "m", n_windows=8))


def test_a_connection_to_a_file_is_used_again_unless_it_failed(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'preload.db'}")
    database.migrate()
    kept = list[object]()  # so that no new one has the identity of an old one

    def opened() -> set[int]:
        with database.connect() as connection, database.connect() as beside, reading(connection), reading(beside):
            drivers = [used.connection.driver_connection for used in (connection, beside)]
        kept.extend(drivers)
        return set(map(id, drivers))

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
        called = [intake.measurements_called(connection, "axis", name, START, LATER) for name in ("m", "open", "new")]
        contents = intake.contents_at(connection, axis, starts | {LATER - timedelta(seconds=0.5)})
    with database.read() as session:
        row = session.get_one(AxisRow, "axis")
        assert all(getattr(axis, name) == getattr(row, name) for name in ("id", "configuration", "revision"))
        stored = {window.started_at: window.content_sha256 for window in session.scalars(select(WindowRow))}
        assert {start: sha256 for start, (sha256, _) in contents.items()} == {start: stored[start] for start in starts}
        assert axis.newest_window_at == max(stored)
        measurements = {each.name: each for of_name in called for each in of_name}
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
            send(api, "axis", history(1, grows_from=HEALTHY, days=HEALTHY + 16))
            evidence = [alarm["evidence"] for alarm in alarms_of(api, "axis")]
            points.append((api.trend("axis"), told(api, "axis"), evidence, api.axis("axis")["lost_motion"]))
    assert points[0][0][0]["preload_n"] is not None
    assert len(points[0][2]) == 1
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
            moments = [point.at for point in drawn]
            assert moments == [point.at for point in within if point.at in moments]
            judged = sorted(point.preload_n for point in within if point.preload_n is not None)
            shown = [point.preload_n for point in drawn if point.preload_n is not None]
            assert (min(shown), max(shown)) == (judged[0], judged[-1]) if judged else not shown
    database.close()


@pytest.mark.parametrize("resolution", [2, 10, 40])
def test_readings_set_on_purpose_hide_none_of_those_that_are_monitored(tmp_path: Path, resolution: int) -> None:
    """From hours and days in which a calibration set lower and higher preloads than the axis had of its own."""
    rng, begin = np.random.default_rng(resolution), START.replace(hour=3)
    set_to = [(100.0, 600.0)[i % 2] if 100 <= i < 200 and i % 3 else None for i in range(400)]
    points = [
        TrendPoint(
            1, begin + i * timedelta(minutes=10), i + 1, f"m{i}", 100.0, set_preload, None, None, None, None, None,
            set_preload or float(rng.normal(300.0, 10.0)), None, None, None, None, None, 1, None, "normal", None,
        )
        for i, set_preload in enumerate(set_to)
    ]  # fmt: skip
    database = Database(f"sqlite:///{tmp_path}/preload.db")
    database.migrate()
    with database.connect() as connection, writing(connection):
        for point in points:
            add_point(connection, point)
        sum_up(connection, 1, [point.at for point in points])
    for span in (Span(), Span(points[90].at, points[390].at), Span(points[110].at, points[190].at)):
        with database.connect() as connection, reading(connection):
            drawn = extremes(connection, 1, span, resolution)
        own = [p for p in points if p.set_preload_n is None and (span.start or p.at) <= p.at < (span.end or LAST)]
        moments = [point.at for point in drawn]
        assert len(drawn) <= resolution
        assert moments == [point.at for point in own if point.at in moments]
        preloads, shown = [p.preload_n for p in own], [p.preload_n for p in drawn]
        assert (min(shown), max(shown)) == (min(preloads), max(preloads))
    with database.connect() as connection, writing(connection):  # as an older program had summed them up
        summed_up = [rollups(connection, 1, unit, Span()) for unit in (HOUR, DAY)]
        held = Base.metadata.tables["trend_rollups"]
        begins = {begin_of(p.at, unit) for p in points if p.set_preload_n is not None for unit in (HOUR, DAY)}
        connection.execute(update(held).where(held.c.starts_at.in_(begins)).values(lowest_n=100.0, highest_n=600.0))
        leave_out_set_preloads(connection)
        assert [rollups(connection, 1, unit, Span()) for unit in (HOUR, DAY)] == summed_up
    database.close()
