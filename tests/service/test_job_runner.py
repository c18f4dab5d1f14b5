"""The runner of jobs: kinds beside each other, a bounded queue, and what is tried again when the store refuses."""

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from service import jobs as module
from service.clock import now
from service.errors import BusyError, StorageError
from service.jobs import JobHandle, JobRunner, Work
from service.store import database as database_module
from service.store.axes import new_axis
from service.store.database import Database
from service.store.tables import JobRow
from tests.service.conftest import START, assert_problem, running_service, simulated_measurement

Runners = Callable[..., JobRunner]


@pytest.fixture
def database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Database]:
    """Open a database with one axis, which waits for a lock no longer than 50 ms."""
    monkeypatch.setattr(database_module, "PATIENCE_MS", 50)
    opened = Database(f"sqlite:///{tmp_path}/preload.db")
    opened.migrate()
    with opened.write() as session:
        axis = new_axis(session, "axis", now())
        axis.name, axis.configuration, axis.detector_design = "axis", {}, {}
        session.add(axis)
    yield opened
    opened.close()


@pytest.fixture
def runners(database: Database) -> Iterator[Runners]:
    """Make runners that are closed after the test."""
    made = []

    def make(work: dict[str, Work], most_waiting: int = 100) -> JobRunner:
        made.append(JobRunner(database, work, most_waiting))
        return made[-1]

    yield make
    for runner in made:
        runner.close()


def ended(runner: JobRunner, job_id: str, timeout_s: float = 20.0) -> JobRow:
    deadline = time.monotonic() + timeout_s
    while (row := runner.get(job_id)).status in ("queued", "running"):
        assert time.monotonic() < deadline, row.status
        time.sleep(0.01)
    return row


def test_a_kind_does_not_wait_for_another_and_waits_for_its_own(runners: Runners) -> None:
    may_end, order = threading.Event(), []

    def replay(job: JobHandle) -> None:
        assert may_end.wait(20.0)
        order.append(job.arguments["number"])

    runner = runners({"replay": replay, "alarm-explanation": lambda job: job.report(1, 1, {})})
    replays = [runner.submit("replay", "axis", {"number": number}).id for number in (1, 2)]
    explanation = runner.submit("alarm-explanation", "axis", {}).id
    assert ended(runner, explanation).status == "done"
    assert {runner.get(job_id).done for job_id in replays} == {0}
    may_end.set()
    assert [ended(runner, job_id).status for job_id in replays] == ["done", "done"]
    assert order == [1, 2]


def test_more_jobs_than_may_wait_are_refused_and_not_stored(runners: Runners) -> None:
    may_end = threading.Event()
    runner = runners({"replay": lambda _: may_end.wait(20.0), "other": lambda _: None}, 2)
    taken = [runner.submit("replay", "axis", {}).id for _ in range(2)]
    with pytest.raises(BusyError, match="2 jobs of kind replay are not done yet"):
        runner.submit("replay", "axis", {})
    assert ended(runner, runner.submit("other", "axis", {}).id).status == "done"  # another kind has room
    assert len(runner.list("axis", 50)) == 3
    may_end.set()
    for job_id in taken:
        ended(runner, job_id)
    assert ended(runner, runner.submit("replay", "axis", {}).id).status == "done"


def test_full_queue_is_503_over_http(tmp_path: Path) -> None:
    windows = [
        window
        for i in range(2)
        for window in simulated_measurement(
            np.random.default_rng(i), f"m{i}", n_windows=8, started_at=START + timedelta(hours=i)
        )
    ]
    write_session(tmp_path / "slow.session.h5", Session("axis", tuple(windows)))
    with running_service(tmp_path / "var", replay_dir=tmp_path, max_waiting_jobs=1) as api:
        api.register("axis")
        slow = {"session": "slow", "speed": 1.0}
        assert api.http.post("/v1/axes/axis/replays", json=slow).status_code == 202
        answer = api.http.post("/v1/axes/axis/replays", json=slow)
        assert_problem(answer, 503, "busy")
        assert answer.headers["retry-after"] == "1"


@pytest.mark.parametrize("refusal", [BusyError("busy"), StorageError("full")])
def test_refused_work_goes_on_from_its_last_report(
    runners: Runners, monkeypatch: pytest.MonkeyPatch, refusal: Exception
) -> None:
    monkeypatch.setattr(module, "PAUSES_S", (0.01,) * 5)
    begun_at = []

    def work(job: JobHandle) -> None:
        begun_at.append(job.done)
        for done in range(job.done + 1, 4):
            job.report(done, 3, {"counted": done})
            if len(begun_at) < 3:
                raise refusal

    row = ended(runner := runners({"count": work}), runner.submit("count", "axis", {}).id)
    assert (row.status, row.done, row.result, row.error) == ("done", 3, {"counted": 3}, None)
    assert begun_at == [0, 1, 2]


def test_a_locked_database_holds_a_job_up_and_loses_nothing_of_it(
    runners: Runners, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither its work nor its end is done twice."""
    monkeypatch.setattr(module, "PAUSES_S", (0.02,) * 200)
    steps, go_on = [], threading.Semaphore(0)

    def work(job: JobHandle) -> None:
        for done in (1, 2):
            assert go_on.acquire(timeout=20.0)
            steps.append(done)
            job.report(done, 2, {})

    runner = runners({"count": work})
    job_id = runner.submit("count", "axis", {}).id
    assert database.file is not None
    for done in (1, 2):
        while runner.get(job_id).status == "queued" or runner.get(job_id).done < done - 1:
            time.sleep(0.01)
        with closing(sqlite3.connect(database.file.path)) as holder:
            holder.execute("BEGIN IMMEDIATE")
            go_on.release()
            time.sleep(0.3)
            assert (runner.get(job_id).status, runner.get(job_id).done) == ("running", done - 1)
    assert (ended(runner, job_id).status, steps) == ("done", [1, 2])


def test_what_is_refused_for_too_long_fails_with_the_sentence(
    runners: Runners, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PAUSES_S", (0.01, 0.01))
    tries = []

    def work(_: JobHandle) -> None:
        tries.append(1)
        raise StorageError("the disk is full")

    row = ended(runner := runners({"write": work}), runner.submit("write", "axis", {}).id)
    assert (row.status, row.error) == ("failed", "StorageError: the disk is full")
    assert len(tries) == 3


def test_a_fault_is_not_tried_again(runners: Runners) -> None:
    tries = []

    def work(_: JobHandle) -> None:
        tries.append(1)
        raise ZeroDivisionError("division by zero")

    row = ended(runner := runners({"divide": work}), runner.submit("divide", "axis", {}).id)
    assert (row.status, row.error, len(tries)) == ("failed", "ZeroDivisionError: division by zero", 1)


def test_stop_while_a_job_waits_to_try_again_is_soon_and_the_next_start_goes_on(runners: Runners) -> None:
    tried = threading.Event()

    def refused(job: JobHandle) -> None:
        job.report(1, 2, {})
        tried.set()
        raise StorageError("the disk is full")

    runner = runners({"write": refused})
    job_id = runner.submit("write", "axis", {}).id
    assert tried.wait(60.0)
    stopped = time.monotonic()
    runner.close()
    assert time.monotonic() - stopped < 10.0
    assert (runner.get(job_id).status, runner.get(job_id).done) == ("running", 1)
    found = []
    runner = runners({"write": lambda job: found.append(job.done)})
    runner.resume()
    assert ended(runner, job_id).status == "done"
    assert found == [1]
