"""A plant: 1000 axes, each measured once a minute, after so many days of it.

``python -m benchmarks.many_axes [--axes 1000] [--days 30] [--minutes 5] [--senders 4] [--readers 0]`` writes the days
into the database as the service would have left them, then serves the same axes at the same rate in real time: a
measurement of two windows in one request. Reports p50 and p99 of the answers, errors, and memory by minute. With
readers, each goes round pages and answers of one axis after another, and one more asks for what is dear and leaves.
"""

import argparse
import sqlite3
import tempfile
import threading
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from datetime import timedelta
from itertools import cycle
from pathlib import Path

import httpx
import msgpack
import numpy as np

from benchmarks.hostile_connections import service
from service.api.http.body import MSGPACK_TYPE
from service.cli.remote.client import window_document
from tests.service.conftest import CONFIGURATION, START, readings, simulated_measurement
from tests.service.long_history import lengthen

#: What a reader goes round.
READ = ("/axes/{}", "/v1/axes/{}/trend?form=columns", "/v1/axes/{}/calibration-plan", "/v1/axes", "/", "/metrics")
#: A drive model with as many modes as there can be, of another screw each time.
DEAR = "/v1/drive-model?screw_diameter_mm=100&screw_lead_mm=0.1&moved_mass_kg=1e6&screw_length_mm={}"
#: Columns that differ from axis to axis; all others are copied.
COPIED = {
    "measurements": {"id": "id + :shift", "axis_id": ":axis"},
    "measurement_documents": {"measurement_id": "measurement_id + :shift"},
    "windows": {"id": "NULL", "axis_id": ":axis", "measurement_id": "measurement_id + :shift"},
    "trend_points": {"axis_number": ":number", "measurement_id": "measurement_id + :shift"},
    "trend_rollups": {"axis_number": ":number"},
}
WHERE = {
    "measurements": "axis_id = 'axis0'",
    "measurement_documents": "measurement_id <= :n",
    "windows": "axis_id = 'axis0'",
    "trend_points": "axis_number = 1",
    "trend_rollups": "axis_number = 1",
}


def register(port: int, n_axes: int) -> None:
    """Register and calibrate the axes."""
    configuration = CONFIGURATION | {
        "windows_per_measurement": 2,
        "minimum_averages": 2,
        "measurements_per_year": 525600,
    }
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=60.0) as http:
        for i in range(n_axes):
            http.put(f"/v1/axes/axis{i}", json={"name": f"axis{i}", "configuration": configuration}).raise_for_status()
            answer = http.post(f"/v1/axes/axis{i}/calibrations", json={"readings": readings()}).raise_for_status()
            path = f"/v1/axes/axis{i}/calibrations/{answer.json()['id']}/activate"
            http.post(path, json={"reason": "benchmark"}).raise_for_status()


def copy_to_all(file: Path, n_axes: int, n_measurements: int) -> int:
    """Give all axes the history of the first one; return the rows of the trend."""
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA synchronous = OFF")
        database.execute("PRAGMA cache_size = -1000000")
        rows = dict(database.execute("SELECT number, id FROM axes"))
        for number, axis in sorted(rows.items())[1:n_axes]:
            values = {"axis": axis, "number": number, "shift": (number - 1) * n_measurements, "n": n_measurements}
            for table, changed in COPIED.items():
                columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
                selected = ", ".join(changed.get(column, column) for column in columns)
                database.execute(f"INSERT INTO {table} SELECT {selected} FROM {table} WHERE {WHERE[table]}", values)  # noqa: S608 - our own names
            database.execute(
                "UPDATE axes SET (last_measured_at, last_measurement_id) = (SELECT last_measured_at, "
                "last_measurement_id + :shift FROM axes WHERE number = 1) WHERE id = :axis",
                values,
            )
            database.commit()
        return int(database.execute("SELECT COUNT(*) FROM trend_points").fetchone()[0])


@dataclass
class Reader:
    """Reads until it is told to stop: one answer after another, or what is dear, leaving after a second."""

    port: int
    axes: int
    leaves: bool = False
    stop: threading.Event = field(default_factory=threading.Event)
    answers: Counter[str] = field(default_factory=Counter)

    def run(self) -> None:
        """Read."""
        paths = (path.format(f"axis{i}") for i in cycle(range(self.axes)) for path in READ)
        dear = (DEAR.format(10_000 + n) for n in cycle(range(9_000)))
        patience = 1.0 if self.leaves else 60.0
        with httpx.Client(base_url=f"http://127.0.0.1:{self.port}", trust_env=False, timeout=patience) as http:
            while not self.stop.wait(4.0 if self.leaves else 1.0):
                try:
                    status = str(http.get(next(dear if self.leaves else paths)).status_code)
                except httpx.TransportError as error:
                    status = type(error).__name__
                self.answers[f"{'leaving' if self.leaves else 'reader'} {status}"] += 1


@dataclass
class Sender:
    """Posts a measurement of each of its axes every minute, spread over the minute."""

    port: int
    bodies: list[bytes]  # by minute
    axes: range
    seconds: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def run(self) -> None:
        """Post everything, each at its time."""
        began, step = time.monotonic(), 60.0 / len(self.axes)
        # no connection waits for its next request longer than the service keeps it
        once = httpx.Limits(max_keepalive_connections=0)
        with httpx.Client(base_url=f"http://127.0.0.1:{self.port}", trust_env=False, timeout=60.0, limits=once) as http:
            for k in range(len(self.bodies) * len(self.axes)):
                time.sleep(max(0.0, began + k * step - time.monotonic()))
                minute, i = divmod(k, len(self.axes))
                path = f"/v1/axes/axis{self.axes[i]}/windows"
                asked = time.perf_counter()
                answer = http.post(path, content=self.bodies[minute], headers={"Content-Type": MSGPACK_TYPE})
                self.seconds.append(time.perf_counter() - asked)
                if answer.status_code != 201 or not answer.json()["measurements"][0]["preload_n"]:
                    self.errors.append(answer.text[:300])


def main() -> None:
    """Fill, serve, report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axes", type=int, default=1000)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--minutes", type=int, default=5)
    parser.add_argument("--senders", type=int, default=4)
    parser.add_argument("--readers", type=int, default=0)
    options = parser.parse_args()
    rng, n_measurements = np.random.default_rng(1), options.days * 1440
    bodies = [
        msgpack.packb(
            {
                "windows": [
                    window_document(window)
                    for window in simulated_measurement(
                        rng, f"m{i}", n_windows=2, started_at=START + timedelta(minutes=i + 1)
                    )
                ]
            }
        )
        for i in range(options.minutes)
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with service(folder) as (port, _):
            register(port, options.axes)
        began = time.monotonic()
        lengthen(folder, "axis0", n_measurements, every=timedelta(minutes=1), windows_each=1)
        n_rows = copy_to_all(folder / "preload.db", options.axes, n_measurements)
        size = (folder / "preload.db").stat().st_size / 2**30
        print(f"{n_rows:,} measurements of {options.axes} axes, {size:.1f} GiB, in {time.monotonic() - began:.0f} s")
        with service(folder) as (port, process):
            httpx.get(f"http://127.0.0.1:{port}/v1/axes", timeout=60.0, trust_env=False).raise_for_status()
            used, memory = process.cpu_times(), [process.memory_info().rss]
            share = options.axes // options.senders
            senders = [Sender(port, bodies, range(i * share, (i + 1) * share)) for i in range(options.senders)]
            readers = [Reader(port, options.axes) for _ in range(options.readers)]
            readers += [Reader(port, options.axes, leaves=True)] if readers else []
            threads = [threading.Thread(target=each.run) for each in (*senders, *readers)]
            for thread in threads:
                thread.start()
            for _ in range(options.minutes):
                time.sleep(60.0)
                memory.append(process.memory_info().rss)
            for reader in readers:
                reader.stop.set()
            for thread in threads:
                thread.join()
            now = process.cpu_times()
        seconds = [second for sender in senders for second in sender.seconds]
        errors = [error for sender in senders for error in sender.errors]
        cores = (now.user + now.system - used.user - used.system) / options.minutes / 60
        p50, p99 = 1e3 * np.percentile(seconds, [50, 99])
        print(
            f"{len(seconds)} measurements: p50 {p50:.1f} ms, p99 {p99:.1f} ms, {len(errors)} errors; {cores:.2f} cores"
        )
        print(f"memory by minute, MiB: {[round(m / 2**20) for m in memory]}")
        print(dict(sum((reader.answers for reader in readers), Counter[str]())))
        for line in errors[:3]:
            print(line)


if __name__ == "__main__":
    main()
