"""What requests cost after years: growth with the history of an axis, a long trend, a large fleet.

``python -m benchmarks.history growth``: every route on an axis of 10³ and of 10⁶ stored measurements, side by side.
``python -m benchmarks.history trend [--millions 50]``: 1000 points of a trend, over spans of every length, from a
database of so many rows (axes of a million each). ``python -m benchmarks.history fleet``: 1000 axes with a measurement
and a learnt baseline. ``python -m benchmarks.history tables``: a million measurements as CSV and as Parquet, with the
processor time and the memory of the service.
``python -m benchmarks.history cost [--earlier FOLDER]``: the processor time of answers on a year of minutes, beside
SQLite with json alone, and an earlier program in a folder. Trend and fleet take ``--database-url`` of an empty
database on PostgreSQL in place of SQLite.
"""

import argparse
import json
import os
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from sqlalchemy import func, select, text, update

from benchmarks.hostile_connections import service
from benchmarks.processes import processor_time_s
from monitor_core.axis_state import AxisState
from monitor_core.trend import DetectorSettings, DetectorState, Observation, design_detector, step
from service.json_types import JsonObject
from service.operations.monitoring.intake.chart_state import dump_state
from service.settings import Settings
from service.store.database import Database, writing
from service.store.tables import AxisRow, Base
from tests.service.conftest import START, Api, running_service, simulated_measurement
from tests.service.long_history import lengthen

EVERY = timedelta(minutes=1)
REPEATED = 60
TREND = [Base.metadata.tables[name] for name in ("trend_points", "trend_rollups")]


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


def trend(millions: int, each: int) -> None:
    """Time 1000 points of a trend over spans of every length."""
    rng = np.random.default_rng(3)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with running_service(folder) as api:
            for i in range(millions):
                api.register(f"axis{i}")
        with closing(Database(Settings(data_dir=folder).resolved_database_url())) as database:
            if database.file is None:
                copy_history(folder / "source", database, each)
            else:
                lengthen(folder, "axis0", each, every=EVERY)
            n_rows, size = repeat_history(database, millions)
        taken = []
        with (
            service(folder) as (port, _),
            httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as http,
        ):
            api = Api(http, folder)
            for _ in range(500):
                first, last = np.sort(rng.uniform(0.0, each, 2))
                query = {
                    "resolution": 1000,
                    "from": (START - (each - first) * EVERY).isoformat(),
                    "to": (START - (each - last) * EVERY).isoformat(),
                }
                path = f"/v1/axes/axis{rng.integers(millions)}/trend"
                taken.append(seconds(get(api, path, **query), 0))
        p50, p99 = 1e3 * np.percentile(taken, [50, 99])
        print(f"{n_rows:,} rows ({size:.1f} GiB): 1000 points of any span p50 {p50:.1f} ms, p99 {p99:.1f} ms")


def copy_history(folder: Path, database: Database, n_measurements: int) -> None:
    """Write the trend of one axis into a database on a server: that of an embedded one, made for the purpose."""
    with running_service(folder, database_url=None) as api:
        api.register("axis0")
    lengthen(folder, "axis0", n_measurements, every=EVERY)
    with (
        closing(sqlite3.connect(folder / "preload.db")) as source,
        database.connect() as connection,
        writing(connection),
    ):
        driver: Any = connection.connection.driver_connection
        for table in TREND:
            columns = ", ".join(column.name for column in table.columns)
            with driver.cursor().copy(f"COPY {table.name} ({columns}) FROM STDIN") as rows:
                for row in source.execute(f"SELECT {columns} FROM {table.name}"):  # noqa: S608
                    rows.write_row(row)


def repeat_history(database: Database, n_axes: int) -> tuple[int, float]:
    """Give all axes the trend of the first one; return how many points there are, and the size of it all [GiB]."""
    for table in TREND:
        columns = ", ".join(column.name for column in table.columns if column.name != "axis_number")
        for number in range(2, n_axes + 1):
            with database.write() as session:
                session.execute(
                    text(
                        f"INSERT INTO {table.name} (axis_number, {columns}) SELECT :number, {columns} "  # noqa: S608
                        f"FROM {table.name} WHERE axis_number = 1"
                    ),
                    {"number": number},
                )
    if database.file is None:  # as the server does by itself after some time
        with database.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            connection.execute(text("VACUUM ANALYZE"))
    with database.read() as session:
        n_rows = session.scalar(select(func.count()).select_from(TREND[0])) or 0
        if database.file is not None:
            return n_rows, database.file.path.stat().st_size / 2**30
        return n_rows, (session.scalar(text("SELECT pg_database_size(current_database())")) or 0) / 2**30


def cost(earlier: Path | None, n_measurements: int) -> None:
    """Print what answers cost the processor, beside SQLite with json alone, and beside an earlier program."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with axis_with_history(folder / "now", n_measurements):
            pass
        as_measured(folder / "now")
        copies = {"this program": (Path.cwd(), folder / "now")}
        if earlier is not None:  # it reads no documents of later ones, nor needs any for a trend
            shutil.copytree(folder / "now", folder / "before")
            with closing(sqlite3.connect(folder / "before" / "preload.db")) as database, database:
                database.execute("UPDATE alembic_version SET version_num = '0017'")
            copies["earlier program"] = (earlier, folder / "before")
        print(f"{'':42} {'CPU, ms':>8} {'kB':>7}")
        for program, (source, data) in copies.items():
            for path in COSTS if program == "this program" else COSTS[1:]:
                spent_ms, n_bytes = asked_of(source, data, path)
                print(f"{program + ': ' + path.rpartition('/')[2]:42} {spent_ms:8.1f} {n_bytes / 1e3:7.1f}", flush=True)
        spent_ms, n_bytes = bare(folder / "now" / "preload.db")
        print(f"{'SQLite with json alone: 1000 points':42} {spent_ms:8.1f} {n_bytes / 1e3:7.1f}")


COSTS = (
    "/v1/axes/axis/trend?limit=1000&form=columns",
    "/v1/axes/axis/trend?limit=1000",
    "/v1/axes/axis/calibration-plan",
    "/axes/axis/calibrate",
    "/axes/axis",
)
ASKED = 60


def as_measured(folder: Path) -> None:
    """Give the numbers of a history all their digits, and a scatter that the axis has learnt."""
    rng = np.random.default_rng(6)
    with closing(sqlite3.connect(folder / "preload.db")) as database, database:
        database.create_function("noise", 0, rng.standard_normal)
        database.execute(
            "UPDATE trend_points SET frequency_hz = 180 + 0.2 * noise(), drag_torque_nm = 0.3 + 0.01 * noise(), "
            "preload_n = preload_n + noise(), interval_lower_n = interval_lower_n - 3 + 0.5 * noise(), "
            "interval_upper_n = interval_upper_n + 3 + 0.5 * noise(), feature_s2 = 3.2e-6 + 1e-8 * noise(), "
            "feature_scatter_s2 = 5e-8, learnt_scatter_s2 = 6e-8 + 1e-10 * noise(), calibration_id = 1"
        )


def asked_of(source: Path, data: Path, path: str) -> tuple[float, int]:
    """Return what an answer of the program in a folder takes of the processor [ms], and its size, not compressed."""
    with (
        service(data, source) as (port, process),
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as http,
    ):
        plain = {"accept-encoding": "identity"}
        for _ in range(10):
            answer = http.get(path, headers=plain).raise_for_status()
        before = processor_time_s(process.pid)
        for _ in range(ASKED):
            http.get(path, headers=plain).raise_for_status()
        return 1e3 * (processor_time_s(process.pid) - before) / ASKED, len(answer.content)


def bare(path: Path) -> tuple[float, int]:
    """Return the same for 1000 points of the trend, read by sqlite3 and written by json [ms, bytes]."""
    names = (
        "measurement_id", "name", "at", "position_mm", "refusal_reason", "frequency_hz", "preload_n",
        "interval_lower_n", "interval_upper_n", "drag_torque_nm", "state", "uncharted", "calibration_id", "doubt",
    )  # fmt: skip
    query = f"SELECT {', '.join(names)} FROM trend_points WHERE axis_number = 1 ORDER BY at LIMIT 1000"  # noqa: S608
    with closing(sqlite3.connect(path)) as database:
        began = time.process_time()
        for _ in range(ASKED):
            text = json.dumps([dict(zip(names, row, strict=True)) for row in database.execute(query)])
        return 1e3 * (time.process_time() - began) / ASKED, len(text)


def learnt_state() -> JsonObject:
    """Return the state of an axis that was measured eight times a day for 60 days."""
    rng = np.random.default_rng(5)
    design = design_detector(DetectorSettings(measurements_per_year=8 * 365.0))
    state = DetectorState()
    for day in range(60):
        for hour in range(8):
            at = START - timedelta(days=60 - day, hours=-hour)
            value = 1.0 + 1e-3 * rng.standard_normal()
            state = step(state, Observation(at, value, 1e-3, temperature=20.0 + rng.standard_normal()), design)
    return dump_state(AxisState(state))


def fleet() -> None:
    """Time the fleet and its page with 1000 axes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with served(folder) as api:
            (window,) = simulated_measurement(np.random.default_rng(4), "m", n_windows=1)
            for i in range(1000):
                api.register(f"axis{i}")
                api.accept(f"axis{i}", [window], complete=True)
        with (
            closing(Database(Settings(data_dir=folder).resolved_database_url())) as database,
            database.write() as session,
        ):
            revision = AxisRow.revision + 1
            session.execute(update(AxisRow).values(monitor_state=learnt_state(), revision=revision))
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
    """Return the processor time of a process and its own, and the largest memory that it has had [s, MiB]."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    peak = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return processor_time_s(pid), int(peak) / 1024


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
    parser.add_argument("what", choices=("growth", "trend", "fleet", "tables", "cost"))
    parser.add_argument("--earlier", type=Path, help="folder of an earlier program, for cost")
    parser.add_argument("--measurements", type=int, default=525_600, help="of the axis, for cost")
    parser.add_argument("--millions", type=int, default=50, help="number of axes")
    parser.add_argument("--each", type=int, default=10**6, help="measurements of an axis")
    parser.add_argument("--database-url", help="of an empty database on PostgreSQL, for trend and fleet")
    options = parser.parse_args()
    if options.database_url is not None:
        os.environ["PRELOAD_DATABASE_URL"] = options.database_url  # for the services that are started, too
    if options.what == "cost":
        cost(options.earlier, options.measurements)
    elif options.what == "trend":
        trend(options.millions, options.each)
    else:
        {"growth": growth, "fleet": fleet, "tables": tables}[options.what]()


if __name__ == "__main__":
    main()
