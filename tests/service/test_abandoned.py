"""Readers who ask for much and leave delay no window; whatever is computed, the service stops when it is told to."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest

from monitor_core.recording import Window
from tests.conftest import free_port
from tests.service.conftest import START, Api, ServerProcess, servers, simulated_measurement

#: A service in which one answer never comes, and which then never comes to an end of itself.
STUCK = """
import time
from service.api import calibrating
from service.cli.main import main
from service.jobs import JobRunner
calibrating.axis_proposal = lambda _: time.sleep(1e6)
JobRunner.close = lambda _: time.sleep(1e6)
main()
"""
N_READERS, N_WINDOWS = 40, 100
#: What is asked for: as many modes as there can be, of another screw each time.
LONGEST = {"screw_diameter_mm": 100, "screw_lead_mm": 0.1, "moved_mass_kg": 1e6}


@pytest.fixture
def stuck_server(tmp_path: Path) -> Iterator[Callable[..., ServerProcess]]:
    def launch(words: list[str], environment: dict[str, str], log: Path) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-c", STUCK, "serve", *words]
        with log.open("wb") as output:
            return subprocess.Popen(command, stdout=output, stderr=output, env=os.environ | environment)

    yield from servers(tmp_path, launch)


def readers_who_leave(url: str, after_s: float) -> list[threading.Thread]:
    def ask(number: int) -> None:
        with suppress(httpx.TransportError):
            httpx.get(
                f"{url}/v1/drive-model",
                params=LONGEST | {"screw_length_mm": 19_000 + number},
                timeout=after_s,
                trust_env=False,
            )

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(N_READERS)]
    for thread in threads:
        thread.start()
    return threads


def seconds_of_windows(api: Api, windows: Iterator[Window]) -> float:
    """Return how long the slowest of a hundred windows but one takes to be stored."""
    took = []
    for _ in range(N_WINDOWS):
        window, began = next(windows), time.perf_counter()
        assert api.post("axis", [window]).status_code == 201
        took.append(time.perf_counter() - began)
    return sorted(took)[-2]


def seconds_to_stop(server: ServerProcess) -> float:
    began = time.perf_counter()
    os.kill(server.process.pid or 0, signal.SIGTERM)
    server.process.wait()
    return time.perf_counter() - began


@pytest.mark.release
def test_forty_who_leave_delay_no_window_and_no_stop(
    tmp_path: Path, start_server: Callable[..., ServerProcess]
) -> None:
    server = start_server(tmp_path / "var", free_port())
    server.wait_until_up()
    rng = np.random.default_rng(1)
    days = (START + timedelta(days=day) for day in range(60))
    windows = (window for day in days for window in simulated_measurement(rng, f"{day}", started_at=day, n_windows=4))
    with httpx.Client(base_url=server.url, timeout=60.0, trust_env=False) as http:
        api = Api(http, tmp_path)
        api.register("axis", windows_per_measurement=4)
        api.calibrate("axis")
        idle = seconds_of_windows(api, windows)
        leaving = readers_who_leave(server.url, after_s=4.0)
        assert seconds_of_windows(api, windows) <= 2.0 * idle
        for thread in leaving:
            thread.join()
        staying = readers_who_leave(server.url, after_s=20.0)
        time.sleep(0.5)
        assert seconds_to_stop(server) <= 10.0
    for thread in staying:
        thread.join()


@pytest.mark.release
def test_what_never_ends_ends_with_the_service(tmp_path: Path, stuck_server: Callable[..., ServerProcess]) -> None:
    server = stuck_server(tmp_path / "var", free_port())
    server.wait_until_up()
    waiting = readers_who_leave(server.url, after_s=20.0)
    time.sleep(0.5)
    assert server.is_up()
    assert seconds_to_stop(server) <= 10.0
    assert "in get_drive_model" in server.log.read_text()  # what did not end is named
    for thread in waiting:
        thread.join()
