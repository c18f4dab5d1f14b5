"""Replay of a recorded session as a job: progress, cancel, resume after a stop, failure."""

import time
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from tests.service.conftest import START, Api, assert_problem, running_service, simulated_measurement

N_MEASUREMENTS, N_WINDOWS = 6, 8


@pytest.fixture(scope="module")
def replay_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a folder with one session, a minute from measurement to measurement, and one file that is none."""
    folder = tmp_path_factory.mktemp("sessions")
    rng = np.random.default_rng(1)
    windows = [
        window
        for i in range(N_MEASUREMENTS)
        for window in simulated_measurement(
            rng, f"m{i}", n_windows=N_WINDOWS, started_at=START + timedelta(minutes=i), set_preload=300.0
        )
    ]
    write_session(folder / "short.session.h5", Session("axis", tuple(windows)))
    (folder / "broken.session.h5").write_bytes(b"this is not HDF5")
    return folder


@pytest.fixture
def replaying(tmp_path: Path, replay_dir: Path) -> Iterator[Api]:
    with running_service(tmp_path / "var", replay_dir=replay_dir) as api:
        api.register("axis", windows_per_measurement=N_WINDOWS)
        yield api


def start(api: Api, session: str, speed: float | None = None) -> dict[str, Any]:
    answer = api.http.post("/v1/axes/axis/replays", json={"session": session, "speed": speed})
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    return job


def wait_for(api: Api, job_id: str, *statuses: str, done: int = 0, timeout_s: float = 60.0) -> dict[str, Any]:
    deadline = time.monotonic() + timeout_s
    while True:
        job = api.http.get(f"/v1/jobs/{job_id}").json()
        if job["status"] in statuses and job["done"] >= done:
            return job
        assert time.monotonic() < deadline, job
        time.sleep(0.02)


def test_replay_with_progress_and_once_more(replaying: Api) -> None:
    assert replaying.http.get("/v1/sessions").json() == {"sessions": ["broken", "short"]}
    total = N_MEASUREMENTS * N_WINDOWS
    job = wait_for(replaying, start(replaying, "short")["id"], "done")
    assert (job["done"], job["total"]) == (total, total)
    assert job["result"] == {"windows_posted": total, "windows_refused": 0, "windows_already_there": 0}
    trend = replaying.trend("axis")
    assert [point["measurement"] for point in trend] == [f"m{i}" for i in range(N_MEASUREMENTS)]
    again = wait_for(replaying, start(replaying, "short")["id"], "done")
    assert again["result"] == {"windows_posted": 0, "windows_refused": 0, "windows_already_there": total}
    assert replaying.trend("axis") == trend
    jobs = replaying.http.get("/v1/jobs", params={"axis": "axis"}).json()["jobs"]
    assert [item["id"] for item in jobs] == [again["id"], job["id"]]


def test_replayed_and_posted_windows_are_the_same_windows(replaying: Api) -> None:
    """The client sends millimetres, the job reads the file: neither makes another window of it."""
    rng = np.random.default_rng(1)
    replaying.accept("axis", simulated_measurement(rng, "m0", n_windows=N_WINDOWS, set_preload=300.0))
    job = wait_for(replaying, start(replaying, "short")["id"], "done")
    assert job["result"]["windows_already_there"] == N_WINDOWS


def test_pages_show_how_far_a_replay_at_work_is(replaying: Api) -> None:
    """What it reports are counts, without the sentence that an analysis has."""
    job_id = start(replaying, "short", speed=1.0)["id"]
    job = wait_for(replaying, job_id, "running", done=N_WINDOWS)
    assert "progress" not in job["result"]
    for path in ("/axes/axis", f"/jobs/{job_id}", "/system"):
        page = replaying.http.get(path)
        assert page.status_code == 200, path
        assert f"{N_WINDOWS} of {N_MEASUREMENTS * N_WINDOWS}" in page.text, path
    replaying.http.post(f"/v1/jobs/{job_id}/cancel")


@pytest.mark.release
def test_waiting_replay_is_cancelled_soon(replaying: Api) -> None:
    job_id = start(replaying, "short", speed=1.0)["id"]  # in real time: the second measurement comes in a minute
    wait_for(replaying, job_id, "running", done=N_WINDOWS)
    queued = start(replaying, "short")["id"]
    assert replaying.http.post(f"/v1/jobs/{queued}/cancel").json()["status"] == "cancelled"
    assert replaying.http.post(f"/v1/jobs/{job_id}/cancel").json()["status"] == "cancelled"
    # the thread is free again: another job gets its turn
    wait_for(replaying, start(replaying, "short")["id"], "done")
    job = replaying.http.get(f"/v1/jobs/{job_id}").json()
    assert (job["status"], job["done"]) == ("cancelled", N_WINDOWS)
    assert replaying.http.get(f"/v1/jobs/{queued}").json()["done"] == 0
    assert replaying.http.post(f"/v1/jobs/{job_id}/cancel").json() == job  # once more changes nothing


@pytest.mark.release
def test_stop_interrupts_a_replay_and_the_next_start_resumes_it(tmp_path: Path, replay_dir: Path) -> None:
    with running_service(tmp_path, replay_dir=replay_dir) as api:
        api.register("axis", windows_per_measurement=N_WINDOWS)
        job_id = start(api, "short", speed=60.0)["id"]  # a measurement a second
        wait_for(api, job_id, "running", done=N_WINDOWS)
        stopped = time.monotonic()
    assert time.monotonic() - stopped < 5.0
    with running_service(tmp_path, replay_dir=replay_dir) as api:
        job = wait_for(api, job_id, "done")
        total = N_MEASUREMENTS * N_WINDOWS
        assert (job["done"], job["total"]) == (total, total)
        assert job["result"] == {"windows_posted": total, "windows_refused": 0, "windows_already_there": 0}
        assert len(api.trend("axis")) == N_MEASUREMENTS


def test_file_that_is_no_session_fails_its_job_with_a_sentence(replaying: Api) -> None:
    job = wait_for(replaying, start(replaying, "broken")["id"], "failed")
    assert "broken.session.h5" in job["error"]
    assert (job["done"], job["result"]) == (0, None)
    wait_for(replaying, start(replaying, "short")["id"], "done")


def test_replay_into_an_unknown_axis_is_refused(replaying: Api) -> None:
    answer = replaying.http.post("/v1/axes/nobody/replays", json={"session": "short"})
    assert_problem(answer, 404, "unknown-resource")
    assert replaying.http.get("/v1/jobs").json()["jobs"] == []
