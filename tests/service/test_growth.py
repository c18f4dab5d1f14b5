"""No route costs more the longer an axis has been watched: counted in steps of the database's virtual machine."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import Engine, event, insert, select

from service.store import alarms
from service.store.database import Database
from service.store.tables import AlarmRow, MeasurementRow
from tests.service.conftest import START, Api, running_service, simulated_measurement
from tests.service.long_history import lengthen

SHORT, LONG = 200, 10_000
#: Of an index that is one level deeper, and of pages that split; not of rows that are passed one by one.
MOST_GROWTH, MOST_MORE = 1.3, 60
EVERY = timedelta(minutes=30)


class Steps:
    """Counts the steps of SQLite's virtual machine, twenty at a time."""

    def __init__(self) -> None:
        self.counted = 0

    def watch(self, connection: object, _record: object) -> None:
        connection.set_progress_handler(self._count, 20)

    def _count(self) -> int:
        self.counted += 20
        return 0


@contextmanager
def service(folder: Path, n_measurements: int) -> Iterator[tuple[Api, Steps]]:
    with running_service(folder) as api:
        api.register("axis", windows_per_measurement=2, minimum_averages=2)
        api.calibrate("axis")
        api.accept("axis", simulated_measurement(np.random.default_rng(1), "first", n_windows=2))
    lengthen(api.data_dir, "axis", n_measurements, every=EVERY, windows_each=3)
    steps = Steps()
    event.listen(Engine, "connect", steps.watch)
    try:
        with running_service(folder) as api:
            yield api, steps
    finally:
        event.remove(Engine, "connect", steps.watch)


def costs(folder: Path, n_measurements: int) -> dict[str, int]:
    """Return the steps that each request takes on an axis with such a history."""
    rng, found = np.random.default_rng(2), {}
    with service(folder, n_measurements) as (api, steps):

        def measure(name: str, path: str, **query: object) -> None:
            steps.counted = 0
            assert api.http.get(path, params=query).status_code == 200, path
            found[name] = steps.counted

        def post(name: str, measurement: str, hours: float, n_windows: int) -> None:
            windows = simulated_measurement(
                rng, measurement, n_windows=n_windows, started_at=START + timedelta(hours=hours)
            )
            steps.counted = 0
            api.accept("axis", windows)
            found[name] = steps.counted

        post("post: not yet complete", "a", 1.0, 1)
        post("post: judged", "b", 2.0, 2)
        post("post: late", "c", 0.5, 2)
        measure("fleet", "/v1/axes")
        measure("axis", "/v1/axes/axis")
        measure("axis page", "/axes/axis")
        measure("fleet page", "/")
        trend = "/v1/axes/axis/trend"
        measure("trend: first page", trend, limit=100)
        measure("trend: newest first", trend, limit=100, order="newest-first")
        cursor = api.http.get(trend, params={"limit": n_measurements // 2}).json()["next_cursor"]
        measure("trend: from the middle", trend, limit=100, cursor=cursor)
        measure("trend: a day", trend, **{"from": (START - timedelta(days=2)).isoformat(), "limit": 48})
        measure("calibrations", "/v1/axes/axis/calibrations")
        measure("alarms", "/v1/alarms", axis="axis")
        measure("one measurement", "/v1/axes/axis/measurements/1")
        measure("metrics", "/metrics")
        measure("ready", "/readyz")
    return found


@pytest.mark.release
def test_cost_does_not_grow_with_the_history(tmp_path: Path) -> None:
    short, long = costs(tmp_path / "short", SHORT), costs(tmp_path / "long", LONG)
    grown = {name: (short[name], long[name]) for name in short if long[name] > MOST_GROWTH * short[name] + MOST_MORE}
    assert not grown


def test_steps_are_counted(tmp_path: Path) -> None:
    with service(tmp_path, 50) as (api, steps):
        before = steps.counted
        api.trend("axis")
        assert steps.counted > before


def test_open_alarms_are_found_without_passing_the_cleared(tmp_path: Path) -> None:
    with running_service(tmp_path) as api:
        api.register("axis", windows_per_measurement=2, minimum_averages=2)
        api.calibrate("axis")
        api.accept("axis", simulated_measurement(np.random.default_rng(1), "first", n_windows=2))
    steps, found = Steps(), []
    event.listen(Engine, "connect", steps.watch)
    try:
        database = Database(f"sqlite:///{api.data_dir}/preload.db")
        for n_cleared in (10, 5000):
            with database.write() as session:
                measurement = session.scalars(select(MeasurementRow.id)).first()
                cleared = {"axis_id": "axis", "measurement_id": measurement, "kind": "preload-loss", "epoch": 1}
                cleared |= {"raised_at": START, "measured_at": START, "status": "cleared"}
                cleared |= {"evidence": {}, "explanation": {}, "shelved_until": START}
                session.execute(insert(AlarmRow), [cleared] * n_cleared)
            found.append({})
            for look in (alarms.list_open, alarms.open_by_axis, alarms.ends_of_shelves):
                with database.read() as session:
                    steps.counted = 0
                    assert not look(session)
                    found[-1][look.__name__] = steps.counted
            with database.read() as session:
                steps.counted = 0
                assert not alarms.has_ended_shelves(session, START)
                found[-1]["has_ended_shelves"] = steps.counted
        database.close()
    finally:
        event.remove(Engine, "connect", steps.watch)
    few, many = found
    assert all(many[name] <= MOST_GROWTH * few[name] + MOST_MORE for name in few), found
