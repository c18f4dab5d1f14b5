"""Disk, database or mathematics fail while windows are taken: nothing acknowledged is missing or half stored."""

import errno
import os
import sqlite3
import threading
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from sqlalchemy.engine.default import DefaultDialect
from sqlalchemy.exc import OperationalError

from service.operations.monitoring import trend
from service.operations.monitoring.intake import batch
from service.store import database, intake
from tests.service.conftest import START, Api, assert_problem, simulated_measurement
from tests.service.test_ingest import stored_frames


def failing_once(
    real: Callable[..., object], error: Exception, *, afterwards: bool = False, thread: str = ""
) -> Callable[..., object]:
    """Fail at the first call, before or after the real thing was done; where a thread is named, at its first one.

    A service that has just started writes something of its own, too.
    """
    calls = []

    def fail(*args: object, **kwargs: object) -> object:
        if thread and threading.current_thread().name != thread:
            return real(*args, **kwargs)
        calls.append(args)
        if len(calls) > 1:
            return real(*args, **kwargs)
        if afterwards:
            real(*args, **kwargs)
        raise error

    return fail


def test_full_disk_stores_nothing(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    api.register("axis")
    windows = simulated_measurement(np.random.default_rng(1), "m")
    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", failing_once(os.fsync, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
        answer = api.post("axis", windows)
    problem = assert_problem(answer, 503, "storage-failed")
    assert "No space left" in problem["detail"]
    assert answer.headers["retry-after"] == "1"
    assert stored_frames(api.data_dir) == []
    assert api.accept("axis", windows)["accepted"] == 15


def test_database_failure_stores_nothing(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    api.register("axis")
    windows = simulated_measurement(np.random.default_rng(2), "m")
    error = OperationalError("INSERT", {}, Exception("disk I/O error"))
    with monkeypatch.context() as broken:
        broken.setattr(intake, "add_windows", failing_once(intake.add_windows, error))
        problem = assert_problem(api.post("axis", windows), 503, "storage-failed")
    assert "disk I/O error" in problem["detail"]
    assert stored_frames(api.data_dir) == []
    assert api.trend("axis") == []
    assert api.accept("axis", windows)["accepted"] == 15


def test_locked_database_asks_to_send_again(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    api.register("axis")
    windows = simulated_measurement(np.random.default_rng(2), "m")
    with monkeypatch.context() as broken:
        error = sqlite3.OperationalError("database is locked")  # of the driver, as it comes from BEGIN IMMEDIATE
        broken.setattr(database, "_begin", failing_once(database._begin, error, thread="ingest"))
        problem = assert_problem(api.post("axis", windows), 503, "storage-failed")
    assert "database is locked" in problem["detail"]
    assert stored_frames(api.data_dir) == []
    assert api.accept("axis", windows)["accepted"] == 15


@pytest.mark.parametrize("committed", [False, True])
def test_failure_at_the_commit_leaves_rows_with_their_waveforms(
    api: Api, monkeypatch: pytest.MonkeyPatch, committed: bool
) -> None:
    """Whether the commit happened is not known then: the file stays, and sending again puts everything right."""
    api.register("axis")
    windows = simulated_measurement(np.random.default_rng(3), "m")
    error = OperationalError("COMMIT", {}, Exception("server closed the connection"))
    with monkeypatch.context() as broken:
        failing = failing_once(DefaultDialect.do_commit, error, afterwards=committed, thread="ingest")
        broken.setattr(DefaultDialect, "do_commit", failing)
        assert_problem(api.post("axis", windows), 503, "storage-failed")
    answer = api.accept("axis", windows)
    assert answer["already_there" if committed else "accepted"] == 15
    (outcome,) = answer["measurements"]
    assert (outcome["refused"], outcome["coherence"] > 0.5) == (False, True)  # judged: its waveforms were all there
    assert len(stored_frames(api.data_dir)) == (1 if committed else 2)


def test_change_by_another_process_meanwhile_is_not_overwritten(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """The windows were judged by what is no more: nothing of them is stored, and sending again judges them anew."""
    api.register("axis")
    windows = simulated_measurement(np.random.default_rng(4), "m")
    real = batch.judge

    def judge_while_another_process_activates(*args: Any) -> Any:
        with sqlite3.connect(api.data_dir / "preload.db") as connection:
            connection.execute("UPDATE axes SET name = 'changed', revision = revision + 1")
        connection.close()
        return real(*args)

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(batch, "judge", judge_while_another_process_activates)
        assert_problem(api.post("axis", windows), 503, "busy")
    assert stored_frames(api.data_dir) == []
    assert api.trend("axis") == []
    assert api.axis("axis")["name"] == "changed"
    assert api.accept("axis", windows)["accepted"] == 15


def test_measurement_that_breaks_the_mathematics_does_not_block_its_axis(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    api.register("axis")
    api.calibrate("axis")
    rng = np.random.default_rng(5)
    with monkeypatch.context() as broken:
        broken.setattr(
            "service.operations.monitoring.intake.judge.judge_measurement",
            failing_once(lambda: None, ZeroDivisionError("by zero")),
        )
        (outcome,) = api.accept("axis", simulated_measurement(rng, "m1"))["measurements"]
    assert (outcome["reason"], outcome["detail"]) == ("fit-failed", "the computation failed: by zero")
    (outcome,) = api.accept("axis", simulated_measurement(rng, "m2", started_at=START + timedelta(hours=8)))[
        "measurements"
    ]
    assert outcome["preload_n"] is not None


def test_bug_in_a_route_is_a_problem_without_internals(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    api.register("axis")
    broken = failing_once(trend.state_now, RuntimeError("secret path"))
    monkeypatch.setattr(trend, "state_now", broken)
    answer = api.http.get("/v1/axes/axis", headers={"x-request-id": "request-7"})
    problem = assert_problem(answer, 500, "internal-error")
    assert problem["request_id"] == "request-7"
    assert "secret" not in answer.text
    metrics = api.http.get("/metrics").text
    assert 'preload_request_seconds_count{method="GET",route="/v1/axes/{axis}",status="500"} 1.0' in metrics
