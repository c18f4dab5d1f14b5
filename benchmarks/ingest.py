"""Ingest over loopback against the bare core: windows of 2 × 20 000 float32 samples, on disk before acknowledged.

``python -m benchmarks.ingest``: both sides in one run on the same machine, in turns, so that what else the machine does
hits both. The bare core gates and judges the same windows in this process (``check_window``, ``judge_measurement``).
"""

import argparse
import base64
import http.client
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import scipy.signal
from threadpoolctl import threadpool_limits

from monitor_core.pipeline import check_window, judge_measurement
from monitor_core.preload import Calibration, ModalReading, Weighting, calibrate
from monitor_core.recording import Conditions, ExcitationSource, Rejection, Window
from monitor_core.recordings.calibration_file import calibration_document
from service.api.body import JSON_TYPE, MSGPACK_TYPE
from service.cli.client import window_document
from service.operations.settings_of_axis import AxisConfiguration, core_settings

SAMPLE_RATE, N_SAMPLES, N_WINDOWS = 4000.0, 20_000, 20  # five seconds each
START = datetime(2026, 1, 1, tzinfo=UTC)
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


@dataclass(frozen=True)
class Way:
    """One way to send a measurement: its requests, encoded beforehand (the sender is not what is timed)."""

    name: str
    content_type: str
    encode: Callable[[Any], bytes]
    windows_per_request: int

    def requests(self, windows: list[Window]) -> list[bytes]:
        """Return the bodies."""
        documents = [window_document(window) for window in windows]
        size = self.windows_per_request
        return [self.encode({"windows": documents[i : i + size]}) for i in range(0, len(documents), size)]


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
        self._pid = process.pid
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)

    def ask(self, method: str, path: str, body: bytes, content_type: str = JSON_TYPE) -> Any:
        """Send a request; anything but success ends the benchmark."""
        self._connection.request(method, path, body, {"Content-Type": content_type})
        answer = self._connection.getresponse()
        content = answer.read()
        assert answer.status in (200, 201), content
        return json.loads(content)

    def prepare(self, axis: str, document: dict[str, Any]) -> None:
        """Register an axis and put a calibration in force."""
        self.ask("PUT", f"/v1/axes/{axis}", json.dumps({"name": axis, "configuration": CONFIGURATION}).encode())
        stored = self.ask("POST", f"/v1/axes/{axis}/calibrations", json.dumps({"document": document}).encode())
        self.ask("POST", f"/v1/axes/{axis}/calibrations/{stored['id']}/activate", b'{"reason": "benchmark"}')

    def rss_mib(self) -> float:
        """Return the memory that the process holds."""
        pages = int(Path(f"/proc/{self._pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


@contextmanager
def running_service() -> Iterator[Service]:
    """Start a service on an empty folder and wait until it answers."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory(prefix="preload-benchmark-") as folder:
        command = [sys.executable, "-m", "service.cli.main", "serve", "--data-dir", folder, "--port", str(port)]
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


def compare(service: Service, rounds: int) -> dict[str, list[float]]:
    """Return windows per second of the bare core and of each way, round by round, in turns."""
    rng = np.random.default_rng(2)
    samples = [measurement(rng) for _ in range(3)]
    in_force = calibration()
    configuration = AxisConfiguration.model_validate(CONFIGURATION)
    rates: dict[str, list[float]] = {"bare core": [], **{way.name: [] for way in WAYS}}
    for number in range(len(WAYS)):
        service.prepare(f"axis-{number}", calibration_document(in_force))
    for turn in range(rounds):
        windows = renamed(samples[turn % len(samples)], turn)
        started = time.perf_counter()
        judge_bare(windows, configuration, in_force)
        rates["bare core"].append(N_WINDOWS / (time.perf_counter() - started))
        for number, way in enumerate(WAYS):
            requests = way.requests(windows)
            started = time.perf_counter()
            answers = [service.ask("POST", f"/v1/axes/axis-{number}/windows", r, way.content_type) for r in requests]
            rates[way.name].append(N_WINDOWS / (time.perf_counter() - started))
            assert sum(answer["accepted"] for answer in answers) == N_WINDOWS
            assert answers[-1]["measurements"][0]["preload_n"] is not None
    return {name: values[1:] for name, values in rates.items()}  # the first round warms up


def memory(service: Service, n_windows: int) -> list[tuple[int, float]]:
    """Return the memory of the service while it takes windows: (windows so far, MiB)."""
    windows = measurement(np.random.default_rng(3))
    service.prepare("memory", calibration_document(calibration()))
    way, figures = WAYS[0], []
    for number in range(n_windows // N_WINDOWS):
        (request,) = way.requests(renamed(windows, number))
        service.ask("POST", "/v1/axes/memory/windows", request, way.content_type)
        if number % 10 == 9:
            figures.append(((number + 1) * N_WINDOWS, service.rss_mib()))
    return figures


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=12, help="measurements of 20 windows by each way")
    parser.add_argument("--memory-windows", type=int, default=10_000)
    options = parser.parse_args()
    threadpool_limits(limits=1)  # as the service does
    with running_service() as service:
        rates = compare(service, options.rounds)
        bare = rates["bare core"]
        print(f"{'windows of 2 × 20 000 float32':36} windows/s   of the bare core: median   best round")
        for name, values in rates.items():
            ratios = np.median(values) / np.median(bare), max(values) / max(bare)
            print(f"{name:36} {np.median(values):9.0f}   {ratios[0]:24.2f}   {ratios[1]:10.2f}")
        if options.memory_windows:
            count, rss = np.array(memory(service, options.memory_windows)).T
            settled = count > count[-1] / 4  # pools and caches have filled by then
            slope = float(np.polyfit(count[settled], rss[settled], 1)[0])
            print(
                f"memory: {rss[0]:.0f} MiB after {count[0]:.0f} windows, {rss[-1]:.0f} MiB after {count[-1]:.0f}; "
                f"{1000 * slope:+.2f} MiB per 1000 windows over the last three quarters"
            )


if __name__ == "__main__":
    main()
