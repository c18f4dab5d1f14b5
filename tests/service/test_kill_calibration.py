"""kill -9 in the middle of a fit: the job is found again and ends, and the axis has one calibration of it."""

import shutil
import sqlite3
import time
import uuid
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import event

from service.jobs import JobRunner
from service.operations.calibrating.fit_job import KIND, CalibrationJobs
from service.store.database import Database
from service.store.tables import JobRow
from service.store.waveforms import WaveformStore
from tests.conftest import free_port
from tests.service.conftest import CONFIGURATION, START, Api, ServerProcess, running_service
from tests.service.killed_steps import Steps, count
from tests.service.test_calibrating import SETTINGS, measure
from tests.service.test_jobs import wait_for
from tests.service.test_kill import errors_in_logs

#: Kills of the service, each when the fit has read so many measurements more.
N_KILLS, MORE = 3, 3
N_TRIALS = 6
#: Steps at which the fit alone is killed: some anywhere, and each of the last, where its calibration is stored.
N_ANYWHERE, AT_THE_END = 6, 12


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a data folder with an axis that is ready to be calibrated."""
    folder = tmp_path_factory.mktemp("prepared") / "var"
    with running_service(folder) as api:
        api.register("axis", **CONFIGURATION | {"windows_per_measurement": 4})
        measure(api)
    return folder


def fit_until(data_dir: Path, step: int, counted: Any) -> None:
    """Fit in this process, and kill it before or after a call that reaches the database."""
    database, waveforms = Database(f"sqlite:///{data_dir}/preload.db"), WaveformStore(data_dir)
    work: dict[str, Any] = {}

    def reached(*_: Any) -> None:
        count(counted, step)

    for moment in ("before_cursor_execute", "after_cursor_execute", "commit"):
        event.listen(database.engine, moment, reached)
    runner = JobRunner(database, work, 1)
    fits = CalibrationJobs(database, waveforms, runner)
    work[KIND] = fits.run
    runner.resume()
    while left(data_dir)[0][0] in ("queued", "running"):
        time.sleep(0.01)
    runner.close()


def queued(data_dir: Path, prepared: Path) -> str:
    """Copy the prepared folder, with a fit that was asked for and not begun; return the number of its job."""
    shutil.copytree(prepared, data_dir)
    job = str(uuid.uuid4())
    database = Database(f"sqlite:///{data_dir}/preload.db")
    with database.write() as session:
        session.add(
            JobRow(
                id=job, kind=KIND, axis_id="axis", arguments={"comment": "guided"}, status="queued", done=0,
                total=None, result=None, error=None, created_at=START, updated_at=START,
            )
        )  # fmt: skip
    database.close()
    return job


def left(data_dir: Path) -> tuple[tuple[str, str | None], list[str]]:
    """Return how the job stands and what became of it, and every calibration of the axis."""
    with closing(sqlite3.connect(data_dir / "preload.db")) as database:
        (job,) = database.execute("SELECT status, json_extract(result, '$.calibration') FROM jobs").fetchall()
        return job, [document for (document,) in database.execute("SELECT document FROM calibrations")]


@pytest.mark.release
def test_a_fit_that_is_killed_at_any_step_gives_one_calibration(prepared: Path, tmp_path: Path) -> None:
    """Neither none nor, where the kill falls between the calibration and the word of it, two."""
    queued(tmp_path / "calm", prepared)
    was_killed, n_steps = Steps(fit_until, tmp_path / "calm").until(-1)
    assert not was_killed
    _, (expected,) = left(tmp_path / "calm")
    anywhere = np.random.default_rng().integers(1, n_steps - AT_THE_END, N_ANYWHERE)
    n_kills = 0
    for step in (*anywhere, *range(n_steps - AT_THE_END, n_steps)):
        data_dir = tmp_path / f"step-{step}"
        queued(data_dir, prepared)
        was_killed, _ = Steps(fit_until, data_dir).until(int(step))
        n_kills += was_killed
        (status, number), calibrations = left(data_dir)
        assert status != "failed"
        assert len(calibrations) == (number is not None), step  # both are stored, or neither
        Steps(fit_until, data_dir).until(-1)
        assert left(data_dir) == (("done", 1), [expected])
        shutil.rmtree(data_dir)
    assert n_kills > N_ANYWHERE + AT_THE_END // 2


def n_killed(prepared: Path, data_dir: Path, fork_server: Callable[..., ServerProcess]) -> int:
    """Kill a service again and again while it fits, and return how often that was in its middle; then it ends."""
    port, n_kills = free_port(), 0
    job = queued(data_dir, prepared)
    server = fork_server(data_dir, port)
    server.wait_until_up()
    with httpx.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
        api = Api(http, data_dir)
        for kill in range(N_KILLS):
            found = wait_for(api, job, "queued", "running", "done", done=MORE * kill)
            server.process.kill()
            server.process.wait()
            (status, number), calibrations = left(data_dir)
            assert status in {"queued", "running", "done"}, found
            assert len(calibrations) == (number is not None)  # both are stored, or neither
            n_kills += (status, calibrations) == ("running", [])
            server = fork_server(data_dir, port)
            server.wait_until_up()
        (found,) = http.get("/v1/jobs", params={"axis": "axis"}).json()["jobs"]
        assert found["id"] == job
        ended = wait_for(api, job, "done", "failed")
        assert (ended["status"], ended["done"], ended["total"]) == ("done", len(SETTINGS) + 1, len(SETTINGS) + 1)
        (calibration,) = http.get("/v1/axes/axis/calibrations").json()["calibrations"]
        assert (calibration["id"], calibration["comment"]) == (ended["result"]["calibration"], "guided")
    return n_kills


@pytest.mark.release
def test_a_service_that_is_killed_goes_on_with_its_fit(
    prepared: Path, tmp_path: Path, fork_server: Callable[..., ServerProcess]
) -> None:
    """The job is found by its axis again, and ends. On a busy machine a fit may have ended before it can be killed."""
    trials = (n_killed(prepared, tmp_path / f"trial-{trial}", fork_server) for trial in range(N_TRIALS))
    assert any(n_kills == N_KILLS for n_kills in trials)
    assert errors_in_logs(tmp_path) == []
