"""No route costs more the longer an axis has been watched: in steps of the database's virtual machine, and in bytes."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import Engine, create_engine, event, insert, select

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from service.clock import text_of
from service.store import alarms
from service.store.database import Database
from service.store.tables import AlarmRow, MeasurementRow
from service.store.trend.lost_motion import (
    CHARTS,
    LOST_MOTION,
    READINGS,
    ChartedReading,
    ReadingChart,
    newest_readings,
    save_chart,
    save_readings,
)
from service.web.pages import PAGES
from tests.service.conftest import START, Api, running_service, simulated_measurement
from tests.service.long_history import lengthen

#: The short history fills every list that has an end, with one in fifty made for a calibration. What is drawn is
#: remembered; the first look at a year reads a summary of each of its days.
SHORT, LONG, LONGEST = 3_200, 12_800, 1_000_000
#: Of an index that is one level deeper, and of pages that split; not of rows that are passed one by one.
MOST_GROWTH, MOST_MORE = 1.2, 60
EVERY = timedelta(minutes=20)


#: Draws all that there is, from a summary of each day: a thousandth of what passing its measurements would take.
DRAWN_BY_DAY, STEPS_A_DAY = "/axes/{axis}/long-run", 40
#: What a job has written once as a file is sent as it is.
FILES = {"/v1/axes/{axis}/discrepancies/{job}/report"}
#: Threads that answer requests, the one that takes windows, and that of a test.
ANSWERING = ("AnyIO worker thread", "ingest", "MainThread")


class Steps:
    """Counts the steps of SQLite's virtual machine that answers take: not what is looked after.

    Each of them: of twenty at a time a statement counts from where it ended the time before on this connection, so that
    an answer of eight short statements took 60 steps or 200.
    """

    def __init__(self) -> None:
        self.counted = 0

    def watch(self, connection: object, _record: object) -> None:
        connection.set_progress_handler(self._count, 1)

    def _count(self) -> int:
        self.counted += threading.current_thread().name.startswith(ANSWERING)
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


def identities(api: Api) -> dict[str, str]:
    """Return what stands in the place of each parameter of a path, all of one axis; what there was none of is made."""
    session = api.data_dir.parent / "small.session.h5"
    windows = simulated_measurement(
        np.random.default_rng(3), "uploaded", n_windows=2, started_at=START + timedelta(days=1)
    )
    write_session(session, Session("axis", tuple(windows)))
    with session.open("rb") as file:
        api.http.post("/v1/axes/axis/recordings", files={"file": file}).raise_for_status()
    while (upload := api.http.get("/v1/jobs").json()["jobs"][0])["status"] in ("queued", "running"):
        time.sleep(0.02)
    database = Database(f"sqlite:///{api.data_dir}/preload.db")
    with database.write() as orm:
        alarm = AlarmRow(
            axis_id="axis", measurement_id=1, kind="preload-loss", raised_at=START, measured_at=START, epoch=1,
            status="active",
            explanation={"examined": False, "reason": "no-drive-model", "sentence": "none", "recent": None},
            evidence={
                "at": text_of(START), "onset": text_of(START), "preload_n": 290.0, "interval": [280.0, 300.0],
                "preload_loss_n": 10.0, "baseline_preload_n": 300.0, "sentence": "a sentence", "check_next": "a check",
            },
        )  # fmt: skip
        orm.add(alarm)
        orm.flush()
        number = alarm.id
    database.close()
    return {
        "axis": "axis", "measurement": "1", "calibration": "1", "alarm": str(number), "job": upload["id"],
        "recording": str(upload["arguments"]["recording"]),
    }  # fmt: skip


def every_get(api: Api) -> list[str]:
    """Return the path of everything that can be read: of the API's own description, and of the pages."""
    described = api.http.get("/openapi.json").raise_for_status().json()["paths"]
    pages = {route.path for router in PAGES for route in router.routes if "GET" in getattr(route, "methods", ())}
    return sorted({path for path, methods in described.items() if "get" in methods} | pages)


def costs(folder: Path, n_measurements: int) -> dict[str, tuple[int, int]]:
    """Return the steps that each request takes on an axis with such a history, and the size of its answer [bytes]."""
    rng, told = np.random.default_rng(2), {}
    with service(folder, n_measurements) as (api, steps):

        def measure(name: str, path: str, **query: object) -> None:
            taken = []
            for _ in range(5):  # what is read once is remembered; after a commit of the service's own, anew
                steps.counted = 0
                answer = api.http.get(path, params=query)
                assert answer.status_code == 200, (path, answer.text)
                taken.append(steps.counted)
                if taken[1:] == taken[:1]:
                    break  # nothing was remembered, and nothing came between
            told[name] = min(taken[1:]), len(answer.content)

        def post(name: str, measurement: str, hours: float, n_windows: int) -> None:
            windows = simulated_measurement(
                rng, measurement, n_windows=n_windows, started_at=START + timedelta(hours=hours)
            )
            steps.counted = 0
            api.accept("axis", windows)
            told[name] = steps.counted, 0

        post("post: not yet complete", "a", 1.0, 1)
        post("post: judged", "b", 2.0, 2)
        post("post: late", "c", 0.5, 2)
        own = identities(api)
        for path in every_get(api):
            if path not in FILES:
                measure(path, path.format(**own))  # a KeyError: nobody has said yet what the new parameter stands for
        trend = "/v1/axes/axis/trend"
        measure("trend: columns", trend, form="columns")
        measure("trend: newest first", trend, limit=100, order="newest-first")
        middle = (START - EVERY * (n_measurements // 2)).isoformat()
        cursor = api.http.get(trend, params={"from": middle, "limit": 100}).json()["next_cursor"]
        assert cursor is not None
        measure("trend: from the middle", trend, limit=100, cursor=cursor)
        measure("trend: a day", trend, **{"from": (START - timedelta(days=2)).isoformat(), "limit": 48})
    return told


@pytest.mark.release
@pytest.mark.parametrize(("short", "long"), [(SHORT, LONG), (SHORT, LONGEST)])
def test_cost_does_not_grow_with_the_history(tmp_path: Path, short: int, long: int) -> None:
    few, many = costs(tmp_path / "short", short), costs(tmp_path / "long", long)
    assert few.keys() == many.keys()
    days = (long - short) * EVERY // timedelta(days=1)
    grown = {
        name: (few[name], many[name])
        for name in few
        for allowed in [MOST_MORE + (STEPS_A_DAY * days if name == DRAWN_BY_DAY else 0)]
        if any(more > MOST_GROWTH * less + allowed for less, more in zip(few[name], many[name], strict=True))
    }
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


def test_newest_lost_motion_is_found_without_passing_the_older() -> None:
    engine, found = create_engine("sqlite://"), []
    READINGS.metadata.create_all(engine, tables=[READINGS, CHARTS])
    reading = ChartedReading(1, LOST_MOTION, START, "m", 400.0, 3.5, 0.02, 3.4, 3.6, "µm", None, None, 9, None)
    with engine.connect() as connection:
        steps = Steps()
        steps.watch(connection.connection.dbapi_connection, None)
        for axis in (1, 2):
            save_chart(connection, ReadingChart(axis, LOST_MOTION, {}, 400.0))
        for days in (range(10), range(10, 1000)):
            for axis in (1, 2):
                rows = [replace(reading, axis_number=axis, at=START + timedelta(days=day)) for day in days]
                connection.execute(insert(READINGS), [asdict(row) for row in rows])
            aside = replace(rows[-1], uncharted="other-place")
            save_readings(connection, 2, [aside])
            steps.counted = 0
            newest = newest_readings(connection)
            found.append(steps.counted)
            assert newest == {
                1: (replace(aside, axis_number=1, uncharted=None), aside.at),
                2: (aside, aside.at - timedelta(days=1)),
            }
    engine.dispose()
    assert found[1] <= MOST_GROWTH * found[0] + MOST_MORE, found
