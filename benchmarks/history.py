"""What requests cost after years: growth with the history of an axis, a long trend, a large fleet.

``python -m benchmarks.history growth``: every route on an axis of 10³ and of 10⁶ stored measurements, side by side.
``python -m benchmarks.history trend [--millions 50]``: 1000 points of a trend, over spans of every length, from a
database of so many rows (axes of a million each). ``python -m benchmarks.history fleet``: 1000 axes with a measurement
and a learnt baseline. ``python -m benchmarks.history tables``: a million measurements as CSV and as Parquet, with the
processor time and the memory of the service.
"""

import argparse
import json
import os
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from datetime import timedelta
from pathlib import Path

import httpx
import numpy as np

from benchmarks.hostile_connections import service
from monitor_core.pipeline import AxisState
from monitor_core.trend import DetectorSettings, DetectorState, Observation, design_detector, step
from service.operations.monitoring.intake.chart_state import dump_state
from tests.service.conftest import START, Api, running_service, simulated_measurement
from tests.service.long_history import lengthen

EVERY = timedelta(minutes=1)
REPEATED = 60


def seconds(call: Callable[[int], object], number: int) -> float:
    """Return how long a call takes."""
    began = time.perf_counter()
    call(number)
    return time.perf_counter() - began


@contextmanager
def axis_with_history(folder: Path, n_measurements: int) -> Iterator[Api]:
    """Serve an axis with so many measurements, a minute apart."""
    with running_service(folder) as api:
        api.register("axis", windows_per_measurement=2, minimum_averages=2)
        api.calibrate("axis")
        api.accept("axis", simulated_measurement(np.random.default_rng(1), "first", n_windows=2))
    lengthen(folder, "axis", n_measurements, every=EVERY, windows_each=2)
    with running_service(folder) as api:
        yield api


def get(api: Api, path: str, **query: object) -> Callable[[int], object]:
    """Return a call that gets a page."""

    def call(_: int) -> None:
        answer = api.http.get(path, params=query)  # type: ignore[arg-type]
        assert answer.status_code == 200, answer.text

    return call


def requests(api: Api, n_measurements: int) -> dict[str, Callable[[int], object]]:
    """Return the requests by name; each is told how often it was made before."""
    rng = np.random.default_rng(2)
    trend = "/v1/axes/axis/trend"
    middle = api.http.get(trend, params={"from": (START - n_measurements * EVERY / 2).isoformat(), "limit": 1}).json()

    def post(name: str, first_hour: float, n_windows: int, n_requests: int) -> Callable[[int], object]:
        prepared = [
            simulated_measurement(
                rng, f"{name}{i}", n_windows=n_windows, started_at=START + timedelta(hours=first_hour + i)
            )
            for i in range(REPEATED + 5)
        ]

        def call(i: int) -> None:
            for k in range(n_requests):
                share = n_windows // n_requests
                api.accept("axis", prepared[i][k * share : (k + 1) * share])

        return call

    return {
        "POST one window": post("open", 1.0, 1, 1),
        "POST, judged": post("judged", 1.2, 2, 1),
        "POST one by one, judged": post("singly", 1.4, 2, 2),
        "fleet": get(api, "/v1/axes"),
        "fleet page": get(api, "/"),
        "axis": get(api, "/v1/axes/axis"),
        "axis page": get(api, "/axes/axis"),
        "trend, first page": get(api, trend, limit=1000),
        "trend, newest first": get(api, trend, limit=1000, order="newest-first"),
        "trend, from the middle": get(api, trend, limit=400, cursor=middle["next_cursor"]),
        "trend, last 500 minutes": get(api, trend, **{"from": (START - 500 * EVERY).isoformat()}),
        "trend, all in 1000 points": get(api, trend, resolution=1000),
        "calibrations": get(api, "/v1/axes/axis/calibrations"),
        "alarms": get(api, "/v1/alarms", axis="axis"),
        "a measurement": get(api, "/v1/axes/axis/measurements/1"),
        "metrics": get(api, "/metrics"),
    }


def growth() -> None:
    """Time every request on a short and on a long history, in turns."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        sizes = (10**3, 10**6)
        apis = [stack.enter_context(axis_with_history(Path(folder) / str(n), n)) for n in sizes]
        calls = [requests(api, n) for api, n in zip(apis, sizes, strict=True)]
        print(f"{'request':28} {'10³, ms':>8} {'10⁶, ms':>8} {'ratio':>6}")
        for name in calls[0]:
            for i in range(5):
                for call in calls:
                    call[name](i)
            taken = [[seconds(call[name], i) for call in calls] for i in range(5, REPEATED + 5)]
            short, long = 1e3 * np.median(taken, axis=0)
            print(f"{name:28} {short:8.2f} {long:8.2f} {long / short:6.2f}", flush=True)


def trend(millions: int) -> None:
    """Time 1000 points of a trend over spans of every length."""
    rng = np.random.default_rng(3)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with running_service(folder) as api:
            for i in range(millions):
                api.register(f"axis{i}")
        lengthen(folder, "axis0", 10**6, every=EVERY)
        with closing(sqlite3.connect(folder / "preload.db")) as database:
            for table in ("trend_points", "trend_rollups"):
                columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")][1:]
                copied = ", ".join(columns)
                for number in range(2, millions + 1):
                    database.execute(
                        f"INSERT INTO {table} (axis_number, {copied}) SELECT ?, {copied} FROM {table} "  # noqa: S608
                        "WHERE axis_number = 1",
                        [number],
                    )
                    database.commit()
            (n_rows,) = database.execute("SELECT COUNT(*) FROM trend_points").fetchone()
        size = (folder / "preload.db").stat().st_size / 2**30
        taken = []
        with (
            service(folder) as (port, _),
            httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as http,
        ):
            api = Api(http, folder)
            for _ in range(500):
                first, last = np.sort(rng.uniform(0.0, 1e6, 2))
                query = {
                    "resolution": 1000,
                    "from": (START - (1e6 - first) * EVERY).isoformat(),
                    "to": (START - (1e6 - last) * EVERY).isoformat(),
                }
                path = f"/v1/axes/axis{rng.integers(millions)}/trend"
                taken.append(seconds(get(api, path, **query), 0))
        p50, p99 = 1e3 * np.percentile(taken, [50, 99])
        print(f"{n_rows:,} rows ({size:.1f} GiB): 1000 points of any span p50 {p50:.1f} ms, p99 {p99:.1f} ms")


def learnt_state() -> str:
    """Return the state of an axis that was measured eight times a day for 60 days."""
    rng = np.random.default_rng(5)
    design = design_detector(DetectorSettings(measurements_per_year=8 * 365.0))
    state = DetectorState()
    for day in range(60):
        for hour in range(8):
            at = START - timedelta(days=60 - day, hours=-hour)
            value = 1.0 + 1e-3 * rng.standard_normal()
            state = step(state, Observation(at, value, 1e-3, temperature=20.0 + rng.standard_normal()), design)
    return json.dumps(dump_state(AxisState(state)))


def fleet() -> None:
    """Time the fleet and its page with 1000 axes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with served(folder) as api:
            (window,) = simulated_measurement(np.random.default_rng(4), "m", n_windows=1)
            for i in range(1000):
                api.register(f"axis{i}")
                api.accept(f"axis{i}", [window], complete=True)
        with closing(sqlite3.connect(folder / "preload.db")) as database, database:
            database.execute("UPDATE axes SET monitor_state = ?, revision = revision + 1", [learnt_state()])
        with served(folder) as api:
            for path in ("/v1/axes", "/", "/metrics"):
                taken = [seconds(get(api, path), i) for i in range(200)]
                p50, p99 = 1e3 * np.percentile(taken[5:], [50, 99])
                print(f"1000 axes, GET {path:9} p50 {p50:.0f} ms, p99 {p99:.0f} ms")


def tables() -> None:
    """Read a whole trend as a table."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        with axis_with_history(folder, 10**6):
            pass
        port, process = stack.enter_context(service(folder))
        http = stack.enter_context(httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=600.0, trust_env=False))
        for kind, query in (
            ("json", {"limit": 10_000}),
            ("csv", {"format": "csv"}),
            ("parquet", {"format": "parquet"}),
        ):
            before, n_bytes = spent(process.pid), 0
            with http.stream("GET", "/v1/axes/axis/trend", params=query) as answer:  # type: ignore[arg-type]
                assert answer.status_code == 200
                for part in answer.iter_raw():
                    n_bytes += len(part)
            seconds_taken, peak_mib = (
                round(after - spent_before, 1)
                for after, spent_before in zip(spent(process.pid), (before[0], 0.0), strict=True)
            )
            what = "a page of 10,000 rows" if kind == "json" else "a million rows"
            print(
                f"{kind:8} {what}: {n_bytes / 1e6:.1f} MB sent, {seconds_taken} s of processor time, "
                f"peak of the service so far {peak_mib} MiB (before {before[1]:.1f})"
            )


def spent(pid: int) -> tuple[float, float]:
    """Return the processor time of a process, and the largest memory that it has had [s, MiB]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    peak = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), int(peak) / 1024


@contextmanager
def served(folder: Path) -> Iterator[Api]:
    """Serve a folder in a process of its own."""
    with (
        service(folder) as (port, _),
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as http,
    ):
        yield Api(http, folder)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("growth", "trend", "fleet", "tables"))
    parser.add_argument("--millions", type=int, default=50)
    options = parser.parse_args()
    if options.what == "trend":
        trend(options.millions)
    else:
        {"growth": growth, "fleet": fleet, "tables": tables}[options.what]()


if __name__ == "__main__":
    main()
