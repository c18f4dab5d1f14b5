"""Two and four services on one PostgreSQL: nothing is lost, doubled or out of order, and nothing is done twice."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import bindparam, select, text, update

from monitor_core.recording import Window
from service import jobs as job_module
from service.clock import now
from service.errors import BusyError, DataFolderError, StorageError
from service.jobs import JobCancelledError, JobHandle, JobRunner
from service.observability import Metrics
from service.operations.access.people import People
from service.operations.monitoring.alarms import bring_back_ended
from service.operations.monitoring.intake.batch import Batch
from service.operations.notices import dispatcher as dispatching
from service.operations.notices.dispatcher import Dispatcher
from service.store import database as database_module, intake, notices
from service.store.axes import new_axis
from service.store.database import Database, writing
from service.store.schema import VERSION
from service.store.tables import AlarmEventRow, AlarmRow, NoticeRow
from service.store.waveforms import WaveformPlace
from tests.service.arrivals import AXIS, history
from tests.service.brokers import wait_until
from tests.service.conftest import assert_problem, emptied, running_service, simulated_measurement
from tests.service.several import SentAwayForGoodError, prepare, said, send, services

N_SENDERS = 6


@pytest.fixture
def url(postgresql: str) -> str:
    return emptied(postgresql)


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    return history(5)


@pytest.fixture(scope="module")
def of_one(postgresql: str, windows: list[Window], tmp_path_factory: pytest.TempPathFactory) -> object:
    """Return what one service says that one sender sends everything to, in order."""
    url = emptied(postgresql)
    with services(url, tmp_path_factory.mktemp("one"), 1) as apis:
        prepare(apis[0])
        send(apis, windows, 1)
        return said(apis[0], url)


def from_many(url: str, folder: Path, windows: list[Window], n_services: int) -> tuple[list[int], object]:
    with services(url, folder, n_services) as apis:
        prepare(apis[0])
        statuses = send(apis, windows, N_SENDERS)
        return statuses, said(apis[-1], url)


@pytest.mark.parametrize("n_services", [2, pytest.param(4, marks=pytest.mark.release)])
def test_services_say_what_one_says_and_send_nobody_away(
    of_one: object, url: str, windows: list[Window], tmp_path: Path, n_services: int
) -> None:
    statuses, found = from_many(url, tmp_path, windows, n_services)
    assert found == of_one
    assert set(statuses) == {201}


def without_locks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_module, "lock_axis", lambda *_: None)
    monkeypatch.setattr(database_module, "lock_free_axes", lambda _, axis_ids: list(axis_ids))


@pytest.mark.release
def test_without_the_lock_senders_are_sent_away(
    url: str, windows: list[Window], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What keeps the order is the lock; the revisions of rows only notice that it was broken."""
    without_locks(monkeypatch)
    statuses, _ = from_many(url, tmp_path, windows, 2)
    assert 503 in statuses


@pytest.mark.release
def test_without_the_lock_and_revisions_something_else_is_said(
    of_one: object, url: str, windows: list[Window], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_locks(monkeypatch)

    def believed(record: intake.AxisRecord | intake.MeasurementRecord, _: int) -> None:
        record.revision += 1

    monkeypatch.setattr(intake, "_expect_one", believed)
    for name, table in (("_CHANGE_AXIS", intake._AXES), ("_CHANGE_MEASUREMENT", intake._MEASUREMENTS)):
        monkeypatch.setattr(intake, name, update(table).where(table.c.id == bindparam("_id")))
    sync, both = Batch.sync, threading.Barrier(2)

    def sync_together(batch: Batch) -> list[WaveformPlace]:
        try:  # both have read, neither has written
            both.wait(timeout=0.5)
        except threading.BrokenBarrierError:
            both.reset()
        return sync(batch)

    monkeypatch.setattr(Batch, "sync", sync_together)
    found = of_one
    for attempt in range(6):  # charts are folded again from what is stored, which now and then mends all of it
        if found == of_one:
            with suppress(SentAwayForGoodError):  # what is stored contradicts itself so much that nothing is said
                _, found = from_many(emptied(url), tmp_path / str(attempt), windows, 2)
    assert found != of_one


def at_once(*calls: object) -> list[object]:
    """Make calls at one moment, and return what each returned or raised."""
    go = threading.Barrier(len(calls))

    def made(call: object) -> object:
        go.wait()
        try:
            return call()  # type: ignore[operator]
        except Exception as error:  # noqa: BLE001 - whatever it is, it is returned
            return error

    with ThreadPoolExecutor(len(calls)) as pool:
        return list(pool.map(made, calls))


@pytest.mark.release
def test_an_alarm_is_acknowledged_once(url: str, windows: list[Window], tmp_path: Path) -> None:
    with services(url, tmp_path, 2) as apis:
        prepare(apis[0])
        send(apis, windows, 2)
        (alarm,) = apis[1].http.get("/v1/alarms").json()["alarms"]
        path = f"/v1/alarms/{alarm['id']}/acknowledge"
        answers = at_once(*(lambda api=api: api.http.post(path, json={"comment": "seen"}) for api in apis * 4))
        assert sorted(answer.status_code for answer in answers) == [200] + [409] * 7  # type: ignore[attr-defined]
        (alarm,) = apis[0].http.get("/v1/alarms").json()["alarms"]
        assert [event["new_status"] for event in alarm["events"]].count("acknowledged") == 1


def test_axis_that_another_service_holds_for_too_long_is_503(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database_module, "_SESSION", "SET lock_timeout = 300")
    windows = simulated_measurement(np.random.default_rng(1), "m", n_windows=2)
    with services(url, tmp_path, 1) as (api,):
        prepare(api)
        api.register("free")
        other = Database(url)
        with other.connect() as connection, other.at_axes(connection, [AXIS], wait=True):
            problem = assert_problem(api.post(AXIS, windows), 503, "busy")
            assert "another service has been at work" in problem["detail"]
            assert api.accept("free", windows)["accepted"] == 2
        assert api.accept(AXIS, windows)["accepted"] == 2
        other.close()


# jobs


@pytest.fixture
def databases(url: str) -> Iterator[list[Database]]:
    """Open one database twice, with an axis."""
    opened = [Database(url) for _ in range(2)]
    for database in opened:
        database.migrate()
    with opened[0].write() as session:
        axis = new_axis(session, AXIS, now())
        axis.name, axis.configuration, axis.detector_design = AXIS, {}, {}
        session.add(axis)
    yield opened
    for database in opened:
        database.close()


def wait_for(condition: object, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_each_job_is_run_once_and_by_either(databases: list[Database], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_module, "POLL_S", 0.02)
    ran: list[tuple[int, object]] = []

    def work_of(number: int) -> dict[str, job_module.Work]:
        def work(job: JobHandle) -> None:
            ran.append((number, job.arguments["number"]))
            time.sleep(0.02)

        return {"count": work}

    runners = [JobRunner(database, work_of(number), 100) for number, database in enumerate(databases)]
    for runner in runners:
        runner.resume()
    submitted = [runners[0].submit("count", AXIS, {"number": number}).id for number in range(30)]
    wait_for(lambda: all(runners[1].get(job_id).status == "done" for job_id in submitted))
    for runner in runners:
        runner.close()
    assert sorted(number for _, number in ran) == list(range(30))  # type: ignore[type-var]
    assert {runner for runner, _ in ran} == {0, 1}


def test_job_of_a_dead_service_goes_on_elsewhere_and_the_dead_one_may_not_report(
    databases: list[Database], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job_module, "POLL_S", 0.02)
    monkeypatch.setattr(job_module, "LEASE", timedelta(seconds=1.0))
    reported, go_on, refused = threading.Event(), threading.Event(), []

    def hanging(job: JobHandle) -> None:
        job.report(1, 2, {"by": "first"})
        reported.set()
        assert go_on.wait(20.0)
        try:
            job.report(2, 2, {"by": "first"})
        except JobCancelledError:
            refused.append(True)
            raise

    monkeypatch.setattr(JobRunner, "_renew", lambda _: None)  # as if its machine stood still
    first = JobRunner(databases[0], {"count": hanging}, 100)
    monkeypatch.undo()
    monkeypatch.setattr(job_module, "POLL_S", 0.02)
    monkeypatch.setattr(job_module, "LEASE", timedelta(seconds=1.0))
    begun_at = []

    def work(job: JobHandle) -> None:
        begun_at.append(job.done)
        time.sleep(2.0)  # longer than a lease: it is renewed
        job.report(2, 2, {"by": "second"})

    job_id = first.submit("count", AXIS, {}).id
    assert reported.wait(20.0)
    second = JobRunner(databases[1], {"count": work}, 100)
    second.resume()
    wait_for(lambda: begun_at)
    go_on.set()
    wait_for(lambda: refused)
    wait_for(lambda: second.get(job_id).status == "done")
    row = first.get(job_id)
    assert (row.done, row.result, begun_at) == (2, {"by": "second"}, [1])
    first.close()
    second.close()


def test_job_is_cancelled_through_another_service(databases: list[Database]) -> None:
    began, stopped = threading.Event(), threading.Event()

    def work(job: JobHandle) -> None:
        began.set()
        try:
            job.sleep(60.0)
        except JobCancelledError:
            stopped.set()
            raise

    runners = [JobRunner(databases[0], {"wait": work}, 100), JobRunner(databases[1], {}, 100)]
    job_id = runners[0].submit("wait", AXIS, {}).id
    assert began.wait(10.0)
    runners[1].cancel(job_id)
    assert stopped.wait(10.0)
    assert runners[0].get(job_id).status == "cancelled"
    for runner in runners:
        runner.close()


def test_job_of_a_service_that_stops_in_good_order_is_taken_up_at_once(
    databases: list[Database], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job_module, "POLL_S", 0.02)
    began = threading.Event()

    def slow(job: JobHandle) -> None:
        began.set()
        job.sleep(60.0)

    first = JobRunner(databases[0], {"wait": slow}, 100)
    second = JobRunner(databases[1], {"wait": lambda job: job.report(1, 1, {})}, 100)
    job_id = first.submit("wait", AXIS, {}).id
    assert began.wait(10.0)
    first.close()
    stopped = time.monotonic()
    second.resume()
    wait_for(lambda: second.get(job_id).status == "done")
    assert time.monotonic() - stopped < job_module.LEASE.total_seconds() / 2
    second.close()


# notices


class _Receiver:
    """Takes what it is told, and is slow at it."""

    name = "desk"

    def __init__(self) -> None:
        self.told: list[int] = []

    def send(self, notice: NoticeRow) -> None:
        time.sleep(0.01)
        self.told.append(notice.id)


def test_a_notice_is_told_by_one_service(databases: list[Database], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatching, "POLL_S", 0.01)
    receiver = _Receiver()
    dispatchers = [Dispatcher(database, [receiver], Metrics()) for database in databases]
    at_once(*(dispatcher.start for dispatcher in dispatchers))
    for number in range(30):
        with databases[number % 2].write() as session:
            notices.add_notice(session, now(), "test", "axes/axis", {"number": number})
    wait_for(lambda: len(receiver.told) >= 30)
    for dispatcher in dispatchers:
        dispatcher.close(5.0)
    with databases[0].read() as session:
        assert receiver.told == list(session.scalars(select(NoticeRow.id).order_by(NoticeRow.id)))


def test_receiver_of_a_dead_service_is_told_by_another(databases: list[Database]) -> None:
    receiver = _Receiver()
    with databases[0].write() as session:
        notices.receiver(session, receiver.name, now())
        notices.add_notice(session, now(), "test", "axes/axis", {})
        assert notices.take_receiver(session, receiver.name, "the dead one", timedelta(seconds=0.5)) is not None
    made = Dispatcher(databases[1], [receiver], Metrics())
    assert not made.tell_next(receiver)
    time.sleep(0.6)
    assert made.tell_next(receiver)
    assert len(receiver.told) == 1


# versions


def test_service_of_an_older_version_stops_writing_when_the_schema_is_newer(url: str, tmp_path: Path) -> None:
    windows = simulated_measurement(np.random.default_rng(1), "m", n_windows=2)
    with services(url, tmp_path, 1) as (api,):
        prepare(api)
        newer = Database(url)
        with newer.connect() as connection, writing(connection):
            connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
        changed = {"name": "changed", "configuration": {}}
        for answer in (
            api.post(AXIS, windows),
            api.http.get("/readyz"),
            api.http.put(f"/v1/axes/{AXIS}", json=changed),
        ):
            problem = assert_problem(answer, 503, "storage-failed")
            assert "the schema of the database is of version 9999 now" in problem["detail"]
        with newer.read() as session:
            assert session.scalar(text("SELECT count(*) FROM windows")) == 0
        with (
            pytest.raises(DataFolderError, match="version 9999, and this program knows those to"),
            running_service(tmp_path, database_url=url),
        ):
            pass
        with newer.connect() as connection, writing(connection):
            connection.execute(text("UPDATE alembic_version SET version_num = :now"), {"now": VERSION})
        newer.close()
        assert api.accept(AXIS, windows)["accepted"] == 2


def test_services_that_start_together_migrate_once(url: str, tmp_path: Path) -> None:
    def start() -> object:
        with running_service(tmp_path, database_url=url) as api:
            return api.http.get("/readyz").status_code

    assert at_once(start, start, start) == [200, 200, 200]


def test_nothing_is_written_while_another_service_migrates(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_module, "_SESSION", "SET lock_timeout = 300")
    old, new = Database(url), Database(url)
    old.migrate()
    with new.connect() as connection, writing(connection):
        database_module.keep_others_out(connection)
        with pytest.raises(BusyError, match="another service"), old.write():
            pass
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(StorageError, match="version 9999 now"), old.write():
        pass
    old.close()
    new.close()


# alarms


@pytest.mark.release
def test_alarms_whose_shelf_has_ended_are_brought_back_once(url: str, windows: list[Window], tmp_path: Path) -> None:
    """Each service looks for them, and four more at the same time."""
    with services(url, tmp_path, 2) as apis:
        prepare(apis[0])
        send(apis, windows, 2)
        measurement = apis[0].trend(AXIS)[0]["measurement_id"]
        database = Database(url)
        with database.write() as session:
            rows = [
                AlarmRow(
                    axis_id=AXIS, measurement_id=measurement, kind="preload-loss", raised_at=now(), status="active",
                    epoch=0, measured_at=now(), evidence={}, shelved_until=now(),
                    explanation={"examined": False, "reason": "no-drive-model", "sentence": "none", "recent": None},
                )
                for _ in range(20)
            ]  # fmt: skip
            session.add_all(rows)
            session.flush()
            alarms = [row.id for row in rows]
        at_once(*(partial(bring_back_ended, database) for _ in range(4)))

        def events() -> list[AlarmEventRow]:
            with database.read() as session:
                return list(session.scalars(select(AlarmEventRow).where(AlarmEventRow.alarm_id.in_(alarms))))

        wait_until(lambda: len(events()) >= len(alarms), what="what a service is at work at itself")
        found = events()
        database.close()
    assert sorted(event.alarm_id for event in found) == alarms
    assert {event.kind for event in found} == {"back"}


# people


@pytest.mark.release
def test_who_logs_in_at_one_service_is_known_to_the_other(url: str, tmp_path: Path) -> None:
    database = Database(url)
    database.migrate()
    People(database, "test").add_user("anna", "administrator", "a long enough password")
    database.close()
    with services(url, tmp_path, 2) as apis:
        assert_problem(apis[1].http.get("/v1/axes"), 401, "unauthenticated")
        time.sleep(0.25)
        form = {"name": "anna", "password": "a long enough password", "next": "/"}
        answer = apis[0].http.post("/login", data=form)
        cookie = {"cookie": answer.headers["set-cookie"].partition(";")[0]}
        assert apis[1].http.get("/v1/axes", headers=cookie).status_code == 200
