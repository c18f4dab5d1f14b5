"""kill -9 again and again, under load and while the service starts; nothing acknowledged may be lost.

``python -m benchmarks.kills [--kills 200]``: eight senders post measurements of four axes, two to an axis, half of each
measurement from either. What is acknowledged goes to a plain file at once. A third of the kills falls into the start.
In the end the database and every waveform are held against that file, and trend and alarms against those of a service
that took the same measurements in calm.
"""

import argparse
import hashlib
import json
import os
import random
import sqlite3
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np

from monitor_core.recording import Window
from service.api.http.body import MSGPACK_TYPE
from service.cli.remote.client import window_document
from service.store.waveforms import WaveformPlace, WaveformStore
from service.store.window_format import content_sha256
from tests.conftest import free_port
from tests.service.conftest import (
    START,
    Api,
    ForkedServer,
    ServerProcess,
    running_service,
    simulated_measurement,
)

N_AXES, N_WINDOWS = 4, 10
N_SIMULATED = 40


@dataclass(frozen=True)
class Supply:
    """Measurements without end: the same samples again and again, an hour after each other, weaker towards the end."""

    simulated: list[list[Window]]

    def windows(self, number: int) -> list[Window]:
        """Return the windows of a measurement."""
        return [
            replace(window, measurement=f"m{number:05d}", started_at=START + timedelta(hours=number, seconds=2 * i))
            for i, window in enumerate(self.simulated[number % N_SIMULATED])
        ]


@dataclass
class Sender:
    """Posts its half of each measurement until it is acknowledged, and notes that in the ledger."""

    url: str
    axis: str
    half: int
    supply: Supply
    ledger: Path
    number: int = 0  # of the measurement under way
    last: int | None = None  # to be posted

    def run(self) -> None:
        """Post until the last measurement is acknowledged."""
        with self.ledger.open("a") as ledger, httpx.Client(base_url=self.url, timeout=30.0, trust_env=False) as http:
            while self.last is None or self.number <= self.last:
                windows = self.supply.windows(self.number)[self.half :: 2]
                body = msgpack.packb({"windows": [window_document(window) for window in windows]})
                while not self._acknowledged(http, body):
                    time.sleep(0.02)
                for window in windows:
                    ledger.write(f"{self.axis} {window.started_at.isoformat()} {content_sha256(window)}\n")
                ledger.flush()
                os.fsync(ledger.fileno())
                self.number += 1

    def _acknowledged(self, http: httpx.Client, body: bytes) -> bool:
        try:
            answer = http.post(f"/v1/axes/{self.axis}/windows", content=body, headers={"Content-Type": MSGPACK_TYPE})
        except httpx.TransportError:
            return False
        if answer.status_code >= 500:
            return False
        answer.raise_for_status()
        return True


def prepare(http: httpx.Client, data_dir: Path) -> None:
    """Register and calibrate the axes."""
    api = Api(http, data_dir)
    for i in range(N_AXES):
        api.register(f"axis{i}", windows_per_measurement=N_WINDOWS)
        api.calibrate(f"axis{i}")


def judged(http: httpx.Client, axis: str) -> str:
    """Return a hash of all that is said about an axis, without the numbers of rows."""
    said: list[Any] = []
    query: dict[str, Any] = {"limit": 10_000}
    while True:
        page = http.get(f"/v1/axes/{axis}/trend", params=query).raise_for_status().json()
        said += [{**point, "measurement_id": None, "calibration": None} for point in page["points"]]
        if page["next_cursor"] is None:
            break
        query["cursor"] = page["next_cursor"]
    alarms = http.get("/v1/alarms", params={"axis": axis, "limit": 200}).raise_for_status().json()["alarms"]
    return hashlib.sha256(json.dumps([said, [alarm["evidence"] for alarm in alarms]]).encode()).hexdigest()


def kill_while_it_works(start: Callable[[], ServerProcess], server: ServerProcess, n_kills: int) -> ServerProcess:
    """Kill at random moments, every third time while the service starts."""
    for number in range(n_kills):
        if number % 3 == 2:
            time.sleep(random.uniform(0.0, 0.6))  # noqa: S311 - a start takes about as long
        else:
            server.wait_until_up()
            time.sleep(random.uniform(0.0, 0.5))  # noqa: S311
        server.process.kill()
        server.process.wait()
        server = start()
        if number % 20 == 19:
            print(f"{number + 1} kills", flush=True)
    server.wait_until_up()
    return server


def compare(data_dir: Path, ledger: list[str]) -> dict[str, int]:
    """Hold the database and the waveforms against what was acknowledged."""
    with closing(sqlite3.connect(data_dir / "preload.db")) as database:
        rows = database.execute(
            "SELECT axis_id, started_at, content_sha256, file_path, offset_in_file, index_in_frame FROM windows"
        ).fetchall()
    stored = [f"{axis} {at.replace(' ', 'T').removesuffix('.000000')}+00:00 {sha}" for axis, at, sha, *_ in rows]
    store, damaged = WaveformStore(data_dir), 0
    for _, _, sha, path, offset, index in rows:
        try:
            store.read([WaveformPlace(path, offset, index, sha)])
        except Exception:  # noqa: BLE001 - whatever it is, it is counted
            damaged += 1
    store.close()
    return {
        "acknowledged": len(ledger),
        "lost": len(set(ledger) - set(stored)),
        "doubled": len(stored) - len(set(stored)),
        "stored that nobody was told of": len(set(stored) - set(ledger)),
        "waveforms damaged": damaged,
    }


def main() -> None:
    """Kill, compare, report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    n_kills = parser.parse_args().kills
    rng = np.random.default_rng(1)
    supply = Supply(
        [
            simulated_measurement(rng, "m", preload=300.0 - 2.0 * i, position_mm=500.0, n_windows=N_WINDOWS)
            for i in range(N_SIMULATED)
        ]
    )
    with tempfile.TemporaryDirectory() as name:
        folder, port, started = Path(name), free_port(), 0

        def start() -> ServerProcess:
            nonlocal started
            started += 1
            log = folder / f"server-{started}.log"
            words = ["--data-dir", str(folder / "var"), "--port", str(port)]
            return ServerProcess(ForkedServer(words, {}, log), f"http://127.0.0.1:{port}", log)

        server = start()
        server.wait_until_up()
        with httpx.Client(base_url=server.url, timeout=60.0, trust_env=False) as http:
            prepare(http, folder / "var")
        senders = [
            Sender(server.url, f"axis{i}", half, supply, folder / f"ledger-{i}-{half}")
            for i in range(N_AXES)
            for half in (0, 1)
        ]
        threads = [threading.Thread(target=sender.run, daemon=True) for sender in senders]
        for thread in threads:
            thread.start()
        server = kill_while_it_works(start, server, n_kills)
        last = max(sender.number for sender in senders)
        for sender in senders:
            sender.last = last
        for thread in threads:
            thread.join()
        with httpx.Client(base_url=server.url, timeout=60.0, trust_env=False) as http:
            after_kills = [judged(http, f"axis{i}") for i in range(N_AXES)]
        server.process.terminate()
        server.process.wait()
        ledger = [line for sender in senders for line in sender.ledger.read_text().splitlines()]
        found = compare(folder / "var", ledger)
        with running_service(folder / "calm") as api:
            prepare(api.http, folder / "calm")
            for number in range(last + 1):
                api.accept("axis0", supply.windows(number))
            calm = judged(api.http, "axis0")
        found["axes that say something else than in calm"] = sum(said != calm for said in after_kills)
    print(f"{n_kills} kills, {last + 1} measurements of {N_AXES} axes:")
    for what, count in found.items():
        print(f"  {what}: {count}")


if __name__ == "__main__":
    main()
