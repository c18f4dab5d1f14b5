"""Ingest over loopback against the bare core: windows of 2 × 20 000 float32 samples, on disk before acknowledged.

``python -m benchmarks.ingest``: both sides in one run on the same machine, in turns, so that what else the machine does
hits both. A turn is several measurements in a row, as an axis sends them: the first after another program had the
processor finds its caches cold. The sender is not what is timed: it writes requests encoded beforehand to a socket. The
bare core gates and judges the same windows in this process (``check_window``, ``judge_measurement``).

Each axis has a history (``--history 10000`` measurements). Then eight senders post one by one, each to an axis of its
own, and sixteen beside one.

One by one, what a request costs whatever is done with it weighs most. So two services are timed as well that do less
(``benchmarks.least_service``): one does nothing but receive, store and acknowledge, and leaves the rest for the core,
one after the other; one gates, judges, hashes, compresses and commits besides, and does nothing else. What that one
reaches is what a service of this framework in one process can reach here.
"""

import argparse
import base64
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import scipy.signal

from benchmarks.processes import processor_time_s
from monitor_core.pipeline import check_window, judge_measurement
from monitor_core.preload import Calibration, ModalReading, Weighting, calibrate
from monitor_core.recording import Conditions, ExcitationSource, Rejection, Window
from monitor_core.recordings.calibration_file import calibration_document
from service.api.http.body import JSON_TYPE, MSGPACK_TYPE
from service.blas_threads import compute_in_one_thread
from service.cli.remote.client import window_document
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings
from tests.service.conftest import START
from tests.service.long_history import lengthen

SAMPLE_RATE, N_SAMPLES, N_WINDOWS = 4000.0, 20_000, 20  # five seconds each
IN_A_ROW = 4  # measurements of a turn
CONFIGURATION = {"search_band_hz": [140, 230], "windows_per_measurement": N_WINDOWS, "silent_after_hours": 1e6}
#: Nguyen et al. (2018), Table 3: the axis that is simulated.
K = (-4872e-8, 5561e-8, 2097e-8, 1228e-8)


def frequency(preload: float, position: float) -> float:
    """Eq. (8) of Nguyen et al. (2018) [Hz]."""
    return float((K[0] * position**2 + K[1] * position + K[2] * preload ** (-1 / 3) + K[3]) ** -0.5)


def calibration() -> Calibration:
    """Calibrate the simulated axis on a table with 0.1 Hz of scatter."""
    rng = np.random.default_rng(1)
    readings = [
        ModalReading(frequency(preload, x) + rng.normal(0.0, 0.1), Conditions(x, 0.0, None, preload))
        for x in (0.3, 0.4, 0.5, 0.6, 0.7)
        for preload in (100.0, 200.0, 300.0, 400.0)
    ]
    return calibrate(readings, weighting=Weighting.NONE, excitation_source=ExcitationSource.SENSOR)


def measurement(rng: np.random.Generator) -> list[Window]:
    """Simulate five seconds of torque pulses on one degree of freedom, twenty times."""
    omega = 2.0 * np.pi * frequency(300.0, 0.5)
    b, a = scipy.signal.bilinear([1.0, 0.0, 0.0], [1.0, 0.03 * omega, omega**2], SAMPLE_RATE)
    windows = []
    for i in range(N_WINDOWS):
        torque = np.zeros(N_SAMPLES)
        torque[rng.integers(500, N_SAMPLES - 6000, 12)] = rng.normal(0.0, 40.0, 12)
        torque += rng.normal(0.0, 0.02, N_SAMPLES)
        response = scipy.signal.lfilter(b, a, torque) + rng.normal(0.0, 0.01, N_SAMPLES)
        windows.append(
            Window(
                excitation=torque.astype(np.float32),
                response=response.astype(np.float32),
                sample_rate=SAMPLE_RATE,
                started_at=START + timedelta(seconds=6 * i),
                conditions=Conditions(0.5, 0.0),
                measurement="m",
            )
        )
    return windows


def renamed(windows: list[Window], number: int) -> list[Window]:
    """Return the same samples as another measurement, an hour after the one before."""
    return [
        replace(window, measurement=f"m{number:06d}", started_at=window.started_at + timedelta(hours=number))
        for window in windows
    ]


def judge_bare(windows: list[Window], configuration: AxisConfiguration, in_force: Calibration) -> None:
    """Do what has to be done without a service."""
    settings = core_settings(configuration)
    accepted = [w for w in windows if not isinstance(check_window(w, settings, in_force), Rejection)]
    assert judge_measurement(accepted, settings, in_force).refusal is None


def core_rate(measurements: list[list[Window]], configuration: AxisConfiguration, in_force: Calibration) -> float:
    """Return windows per second of the bare core."""
    started = time.perf_counter()
    for windows in measurements:
        judge_bare(windows, configuration, in_force)
    return len(measurements) * N_WINDOWS / (time.perf_counter() - started)


@dataclass(frozen=True)
class Way:
    """One way to send a measurement."""

    name: str
    content_type: str
    encode: Callable[[Any], bytes]
    windows_per_request: int

    def requests(self, axis: str, windows: list[Window]) -> list[bytes]:
        """Return the requests, headers and all."""
        documents = [window_document(window) for window in windows]
        size = self.windows_per_request
        bodies = [self.encode({"windows": documents[i : i + size]}) for i in range(0, len(documents), size)]
        return [
            f"POST /v1/axes/{axis}/windows HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: {self.content_type}\r\n"
            f"Content-Length: {len(body)}\r\n\r\n".encode()
            + body
            for body in bodies
        ]


def json_with(samples: Callable[[bytes], Any]) -> Callable[[Any], bytes]:
    """Return an encoder that turns raw samples into something that JSON can hold."""
    return lambda document: json.dumps(document, default=samples).encode()


WAYS = (
    Way("msgpack, measurement a request", MSGPACK_TYPE, msgpack.packb, N_WINDOWS),
    Way("JSON base64, measurement a request", JSON_TYPE, json_with(lambda b: base64.b64encode(b).decode()), N_WINDOWS),
    Way(
        "JSON lists, measurement a request", JSON_TYPE, json_with(lambda b: np.frombuffer(b, "<f4").tolist()), N_WINDOWS
    ),
    Way("msgpack, one by one", MSGPACK_TYPE, msgpack.packb, 1),
    Way("JSON base64, one by one", JSON_TYPE, json_with(lambda b: base64.b64encode(b).decode()), 1),
)


class Service:
    """``preload serve`` in a process of its own, and one connection to it."""

    def __init__(self, process: subprocess.Popen[bytes], port: int) -> None:
        self._process, self._port = process, port
        self._url = f"http://127.0.0.1:{port}"
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=120)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def another(self) -> "Service":
        """Return another connection to the same service."""
        return Service(self._process, self._port)

    def send(self, request: bytes) -> bytes:
        """Send a request to the windows of an axis and return the answer; anything but success ends the benchmark."""
        self._socket.sendall(request)
        head, _, content = self._receive(lambda received: b"\r\n\r\n" in received).partition(b"\r\n\r\n")
        (length,) = re.findall(rb"content-length: (\d+)", head)
        content += self._receive(lambda received: len(content) + len(received) >= int(length))
        assert head.startswith(b"HTTP/1.1 201"), content
        return content

    def _receive(self, enough: Callable[[bytes], bool]) -> bytes:
        received = b""
        while not enough(received):
            chunk = self._socket.recv(65536)
            if not chunk:
                raise ConnectionError("the service closed the connection")
            received += chunk
        return received

    def prepare(self, axis: str, document: dict[str, Any]) -> None:
        """Register an axis and put a calibration in force."""
        with httpx.Client(base_url=f"{self._url}/v1/axes", timeout=120) as client:
            client.put(axis, json={"name": axis, "configuration": CONFIGURATION}).raise_for_status()
            stored = client.post(f"{axis}/calibrations", json={"document": document}).raise_for_status().json()
            activation = f"{axis}/calibrations/{stored['id']}/activate"
            client.post(activation, json={"reason": "benchmark"}).raise_for_status()

    def rss_mib(self) -> float:
        """Return the memory that the process holds."""
        pages = int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def processor_time_s(self) -> float:
        """Return the processor time that the process has used, and those that it started, in steps of 10 ms."""
        return processor_time_s(self._process.pid)


#: Of each way, of each of many senders, and one for the memory.
AXES = [*(f"axis-{i}" for i in range(len(WAYS))), *(f"sender-{i}" for i in range(16)), "memory"]
OUR_SERVICE, LEAST_SERVICE = ("service.cli.main", "serve"), ("benchmarks.least_service",)


@contextmanager
def running(folder: Path, module: str, *arguments: str) -> Iterator[Service]:
    """Start a service on a folder and wait until it answers."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", module, *arguments, "--data-dir", str(folder), "--port", str(port)]
    process = subprocess.Popen(command, env=os.environ | {"PRELOAD_LOG_LEVEL": "WARNING"})
    try:
        while process.poll() is None:
            try:
                socket.create_connection(("127.0.0.1", port)).close()
                break
            except OSError:
                time.sleep(0.05)
        yield Service(process, port)
    finally:
        process.terminate()
        process.wait(30)


def axes_with_history(folder: Path, n_measurements: int, axes: Sequence[str]) -> None:
    """Register axes and give each so many measurements."""
    document = calibration_document(calibration())
    with running(folder, *OUR_SERVICE) as service:
        for axis in axes:
            service.prepare(axis, document)
    for axis in axes:
        lengthen(folder, axis, n_measurements, every=timedelta(minutes=30), windows_each=N_WINDOWS)


def compare(service: Service, turns: int) -> dict[str, tuple[list[float], list[float]]]:
    """Return windows per second of each way and, turn by turn, of the bare core right before it."""
    rng = np.random.default_rng(2)
    samples = [measurement(rng) for _ in range(3)]
    in_force = calibration()
    configuration = AxisConfiguration.model_validate(CONFIGURATION)
    rates: dict[str, tuple[list[float], list[float]]] = {way.name: ([], []) for way in WAYS}
    for turn in range(turns):
        numbers = range(turn * IN_A_ROW, (turn + 1) * IN_A_ROW)
        measurements = [renamed(samples[number % len(samples)], number) for number in numbers]
        for number, way in enumerate(WAYS):
            requests = [way.requests(f"axis-{number}", windows) for windows in measurements]
            of_way, of_core = rates[way.name]
            of_core.append(core_rate(measurements, configuration, in_force))
            started = time.perf_counter()
            answers = [[service.send(request) for request in of_one] for of_one in requests]
            of_way.append(IN_A_ROW * N_WINDOWS / (time.perf_counter() - started))
            for of_one in answers:
                documents = [json.loads(answer) for answer in of_one]
                assert sum(document["accepted"] for document in documents) == N_WINDOWS
                assert documents[-1]["measurements"][0]["preload_n"] is not None
    return {name: (of_way[1:], of_core[1:]) for name, (of_way, of_core) in rates.items()}  # the first warms up


def from_many(service: Service, n_senders: int, numbers: range, samples: list[Window]) -> float:
    """Return windows per second that so many senders get in, one by one, each to an axis of its own."""
    one_by_one = next(way for way in WAYS if way.windows_per_request == 1)
    connections = [service.another() for _ in range(n_senders)]
    requests = [
        [
            request
            for number in numbers[::n_senders]
            for request in one_by_one.requests(f"sender-{i}", renamed(samples, number))
        ]
        for i in range(n_senders)
    ]

    def send(i: int) -> None:
        for request in requests[i]:
            connections[i].send(request)

    threads = [threading.Thread(target=send, args=(i,)) for i in range(n_senders)]
    started = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(map(len, requests)) / (time.perf_counter() - started)


def compare_senders(service: Service, turns: int) -> None:
    """Print what eight senders get in against the bare core, and sixteen against one."""
    samples = measurement(np.random.default_rng(4))
    configuration, in_force = AxisConfiguration.model_validate(CONFIGURATION), calibration()
    against_core, against_one = [], []
    for turn in range(turns):
        first = 1000 + 64 * turn
        core = core_rate([samples] * IN_A_ROW, configuration, in_force)
        from_one = from_many(service, 1, range(first, first + 8), samples)
        eight = from_many(service, 8, range(first + 8, first + 24), samples)
        sixteen = from_many(service, 16, range(first + 24, first + 56), samples)
        against_core.append(eight / core)
        against_one.append(sixteen / from_one)
    for name, ratios in (("eight senders / bare core", against_core), ("sixteen senders / one", against_one)):
        tenth, middle = np.quantile(ratios[1:], [0.1, 0.5])
        print(f"one by one, {name}: median {middle:.3f}, nine of ten at least {tenth:.3f}")


def highest_ratio(turns: int) -> list[tuple[float, float, float]]:
    """Return, turn by turn, milliseconds a window of the bare core and of the least service, and the ratio of both."""
    samples = [measurement(np.random.default_rng(2))]
    configuration, in_force = AxisConfiguration.model_validate(CONFIGURATION), calibration()
    one_by_one = next(way for way in WAYS if way.windows_per_request == 1)
    figures = []
    with tempfile.TemporaryDirectory() as folder, running(Path(folder), *LEAST_SERVICE) as service:
        for turn in range(turns):
            measurements = [renamed(samples[0], turn * IN_A_ROW + number) for number in range(IN_A_ROW)]
            requests = [request for windows in measurements for request in one_by_one.requests("axis", windows)]
            of_core = 1e3 / core_rate(measurements, configuration, in_force)
            started = time.perf_counter()
            for request in requests:
                service.send(request)
            of_least = 1e3 * (time.perf_counter() - started) / len(requests)
            figures.append((of_core, of_least, of_core / (of_core + of_least)))
    return figures[1:]  # the first warms up


def least_judging(turns: int) -> dict[str, list[float]]:
    """Return the ratios of a service that does only what an answer needs to the bare core, turn by turn."""
    samples = measurement(np.random.default_rng(4))
    configuration, in_force = AxisConfiguration.model_validate(CONFIGURATION), calibration()
    whole = next(way for way in WAYS if way.windows_per_request == N_WINDOWS)
    ratios: dict[str, list[float]] = {"measurement a request": [], "one by one": [], "one by one, eight senders": []}
    with tempfile.TemporaryDirectory() as folder, running(Path(folder), *LEAST_SERVICE, "--judging") as service:
        for turn in range(turns):
            first = 1000 + 64 * turn
            core = core_rate([samples] * IN_A_ROW, configuration, in_force)
            requests = [
                request for i in range(IN_A_ROW) for request in whole.requests("axis", renamed(samples, first + i))
            ]
            started = time.perf_counter()
            for request in requests:
                service.send(request)
            ratios["measurement a request"].append(len(requests) * N_WINDOWS / (time.perf_counter() - started) / core)
            ratios["one by one"].append(from_many(service, 1, range(first, first + 8), samples) / core)
            eight = from_many(service, 8, range(first + 8, first + 24), samples)
            ratios["one by one, eight senders"].append(eight / core)
    return {name: of_way[1:] for name, of_way in ratios.items()}


def memory(service: Service, n_windows: int) -> list[tuple[int, float]]:
    """Return the memory of the service while it takes windows: (windows so far, MiB)."""
    windows = measurement(np.random.default_rng(3))
    way, figures = WAYS[0], []
    for number in range(n_windows // N_WINDOWS):
        (request,) = way.requests("memory", renamed(windows, number))
        service.send(request)
        if number % 10 == 9:
            figures.append(((number + 1) * N_WINDOWS, service.rss_mib()))
    return figures


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=16, help=f"turns of {IN_A_ROW} measurements by each way")
    parser.add_argument("--memory-windows", type=int, default=10_000)
    parser.add_argument("--history", type=int, default=10_000, help="measurements that each axis has before")
    options = parser.parse_args()
    compute_in_one_thread()  # as the service does
    with tempfile.TemporaryDirectory() as folder:
        axes_with_history(Path(folder), options.history, AXES)
        report(Path(folder), options.turns, options.memory_windows)
    core, least, ratio = np.array(highest_ratio(options.turns)).T
    low, middle, high = np.quantile(ratio, [0.25, 0.5, 0.75])
    print(
        f"one by one, a service that only receives and stores takes {np.median(least):.2f} ms a window, the bare core "
        f"{np.median(core):.2f} ms: one after the other the ratio would be {middle:.3f} ({low:.3f}–{high:.3f})"
    )
    for name, ratios in least_judging(options.turns).items():
        tenth, middle = np.quantile(ratios, [0.1, 0.5])
        print(f"a service that only does what an answer needs, {name}: {middle:.3f}, nine of ten at least {tenth:.3f}")


def report(folder: Path, turns: int, memory_windows: int) -> None:
    """Print the figures of our service on axes with a history."""
    with running(folder, *OUR_SERVICE) as service:
        print(f"{'windows of 2 × 20 000 float32':36} windows/s   bare core   ratio: median   quartiles   nine of ten")
        for name, (of_way, of_core) in compare(service, turns).items():
            tenth, low, middle, high = np.quantile(np.divide(of_way, of_core), [0.1, 0.25, 0.5, 0.75])
            figures = f"{np.median(of_way):9.0f}   {np.median(of_core):9.0f}   {middle:13.3f}"
            print(f"{name:36} {figures}   {low:.3f}–{high:.3f}   ≥ {tenth:.3f}")
        compare_senders(service, turns)
        if memory_windows:
            count, rss = np.array(memory(service.another(), memory_windows)).T
            settled = count > count[-1] / 4  # pools and caches have filled by then
            slope = float(np.polyfit(count[settled], rss[settled], 1)[0])
            print(
                f"memory: {rss[0]:.0f} MiB after {count[0]:.0f} windows, {rss[-1]:.0f} MiB after {count[-1]:.0f}; "
                f"{1000 * slope:+.2f} MiB per 1000 windows over the last three quarters"
            )


if __name__ == "__main__":
    main()
