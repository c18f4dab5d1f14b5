"""One thread for the mathematics, in whatever is loaded: every copy of BLAS and OpenMP, in every process."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from service.blas_threads import VARIABLES, compute_in_one_thread
from service.operations.own_process import Progress, Report, in_own_process

#: What an operator's shell may say: more threads than one.
ELSEWHERE = os.environ | dict.fromkeys(VARIABLES, "2")


def pools() -> list[tuple[str, int]]:
    """Load what computes, as late as a command does, and tell which copies have how many threads."""
    import numpy as np
    import scipy.linalg

    scipy.linalg.cho_factor(np.eye(200) @ np.eye(200))
    return [(Path(pool["filepath"]).name, pool["num_threads"]) for pool in threadpool_info()]


def pools_for_a_report(report: Report) -> list[tuple[str, int]]:
    report(Progress(1))
    return pools()


def pools_in_own_process() -> list[tuple[str, int]]:
    return in_own_process(pools_for_a_report, lambda _: None, Progress(0))


def pools_in_a_pool() -> list[tuple[str, int]]:
    with ProcessPoolExecutor(1) as pool:
        return pool.submit(pools).result()


def pools_in_a_job() -> list[tuple[str, int]]:
    """Ask in the thread that works on the jobs of a service."""
    import tempfile

    from service.clock import now
    from service.jobs import JobHandle, JobRunner
    from service.store.axes import new_axis
    from service.store.database import Database

    found: list[tuple[str, int]] = []

    def work(_: JobHandle) -> None:
        found.extend(pools())

    with tempfile.TemporaryDirectory() as folder:
        database = Database(f"sqlite:///{folder}/preload.db")
        database.migrate()
        with database.write() as session:
            axis = new_axis(session, "axis", now())
            axis.name, axis.configuration, axis.detector_design = "axis", {}, {}
            session.add(axis)
        runner = JobRunner(database, {"ask": work}, 1)
        runner.submit("ask", "axis", {})
        while runner.list("axis", 1)[0].status in ("queued", "running"):
            time.sleep(0.02)
        runner.close()
        database.close()
    return found


def assert_one_thread(found: list[tuple[str, int]]) -> None:
    assert len(found) >= 2, found  # numpy and scipy bring a copy each
    assert all(threads == 1 for _, threads in found), found


def in_the_command_line(ask: str, before: str = "") -> list[tuple[str, int]]:
    """Run a question where a command would stand, in a fresh process as ``preload`` is started."""
    program = f"""
import json, sys
{before}
from service.cli import main
from tests.service import test_blas_threads
main.preload.main = lambda **_: print(json.dumps(test_blas_threads.{ask}()))
main.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", program], env=ELSEWHERE, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return [(name, threads) for name, threads in json.loads(done.stdout)]


#: Not by canary(): whose module limits the threads, which the last test must not.
RELEASE = pytest.mark.release


@pytest.mark.parametrize(
    "before", ["import scipy.linalg", pytest.param("import numpy", marks=RELEASE), pytest.param("", marks=RELEASE)]
)
def test_the_command_line_computes_in_one_thread(before: str) -> None:
    assert_one_thread(in_the_command_line("pools", before))


@pytest.mark.parametrize(
    "ask",
    [
        "pools_in_own_process",
        pytest.param("pools_in_a_pool", marks=RELEASE),
        pytest.param("pools_in_a_job", marks=RELEASE),
    ],
)
def test_what_the_command_line_starts_computes_in_one_thread(ask: str) -> None:
    assert_one_thread(in_the_command_line(ask))


@pytest.mark.parametrize("ask", [pools, pools_in_own_process, pools_in_a_pool, pools_in_a_job])
def test_limit_holds_where_the_tests_run(ask: Callable[[], list[tuple[str, int]]]) -> None:
    compute_in_one_thread()
    assert_one_thread(ask())


def test_more_threads_would_be_seen() -> None:
    """Without the limit the environment's two threads show: the tests above can fail."""
    program = "import json; from tests.service.test_blas_threads import pools; print(json.dumps(pools()))"
    done = subprocess.run(
        [sys.executable, "-c", program], env=ELSEWHERE, capture_output=True, text=True, check=True, timeout=60
    )
    if os.cpu_count() == 1:
        pytest.skip("one core has one thread")
    assert any(threads == 2 for _, threads in json.loads(done.stdout))
