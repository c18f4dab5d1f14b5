"""The history of an axis that a rule has something to let go of: old and young, calibrated, pinned, alarmed."""

import hashlib
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.recording import Window
from service.clock import now
from service.operations.monitoring.intake import batch
from service.store.waveforms import WaveformPlace, WaveformStore
from tests.service.conftest import START, Api, simulated_measurement

N_WINDOWS = 6
N_DAYS, LOSS_AFTER_DAYS = 24, 18
#: Days after START of what is kept whatever its age.
PINNED_DAY, PINNED_SPAN, CALIBRATION_DAY = 2, (5, 7), 4
RULE = {"keep_raw_days": 30, "keep_before_alarm_days": 2, "keep_after_alarm_days": 1}


@contextmanager
def arriving_at(moment: datetime) -> Iterator[None]:
    """Let windows arrive at some moment."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(batch, "now", lambda: moment)
        yield


def day(number: float) -> datetime:
    return START + timedelta(days=number)


def measurement(name: str, at: datetime, *, preload: float = 300.0, set_preload: float | None = None) -> list[Window]:
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4])
    return simulated_measurement(
        np.random.default_rng(seed), name, preload=preload, started_at=at, n_windows=N_WINDOWS, set_preload=set_preload
    )


@dataclass(frozen=True)
class History:
    """What was posted: old measurements of the axis by name, and a young one."""

    old: dict[str, list[Window]]
    young: list[Window]
    pinned: int  # number of the measurement that is pinned

    @property
    def kept(self) -> set[str]:
        """Names of the old measurements that are kept whatever happens, but for those around alarms."""
        in_span = {f"day-{number:02d}-{part}" for number in range(*PINNED_SPAN) for part in "ab"}
        return {f"day-{PINNED_DAY:02d}-a", "set", *in_span}


def lived(api: Api, axis: str = "axis") -> History:
    """Post two measurements a day in the past, of which some are kept, and one of today; the preload is lost."""
    api.register(axis, windows_per_measurement=N_WINDOWS)
    api.calibrate(axis)
    old = {}
    for number in range(N_DAYS):
        for part, hour in (("a", 0), ("b", 4)):
            at = day(number + hour / 24)
            name = f"day-{number:02d}-{part}"
            old[name] = measurement(name, at, preload=300.0 if number < LOSS_AFTER_DAYS else 200.0)
        if number == CALIBRATION_DAY:
            old["set"] = measurement("set", day(number + 0.3), set_preload=300.0)
    for windows in old.values():
        with arriving_at(windows[-1].started_at):
            api.accept(axis, windows)
    young = measurement("young", now() - timedelta(hours=1))
    api.accept(axis, young)
    number = number_of(api, axis, f"day-{PINNED_DAY:02d}-a")
    pin = api.http.post(f"/v1/axes/{axis}/pins", json={"measurement": number, "reason": "reference"})
    assert pin.status_code == 201, pin.text
    start, end = (day(number).replace(hour=0) for number in PINNED_SPAN)
    span = {"from": start.isoformat(), "to": end.isoformat(), "reason": "acceptance test"}
    assert api.http.post(f"/v1/axes/{axis}/pins", json=span).status_code == 201
    return History(old, young, number)


def number_of(api: Api, axis: str, name: str) -> int:
    (number,) = (point["measurement_id"] for point in api.trend(axis, limit=10_000) if point["measurement"] == name)
    return int(number)


def row_counts(data_dir: Path) -> dict[str, int]:
    """Count the rows of what must never lose one."""
    tables = ("axes", "measurements", "measurement_documents", "windows", "trend_points", "trend_rollups", "alarms")
    with closing(sqlite3.connect(data_dir / "preload.db")) as connection:
        return {name: connection.execute(f"SELECT count(*) FROM {name}").fetchone()[0] for name in tables}  # noqa: S608


def stored_names(data_dir: Path) -> dict[str, int]:
    """Read every window that has a waveform, checked by its hash; count them by measurement."""
    query = (
        "SELECT m.name, w.file_path, w.offset_in_file, w.index_in_frame, w.content_sha256 "
        "FROM windows w JOIN measurements m ON m.id = w.measurement_id WHERE w.file_path <> ''"
    )
    with closing(sqlite3.connect(data_dir / "preload.db")) as connection:
        rows = connection.execute(query).fetchall()
    store = WaveformStore(data_dir)
    store.read(WaveformPlace(*row[1:]) for row in rows)
    store.close()
    names = [row[0] for row in rows]
    return {name: names.count(name) for name in dict.fromkeys(names)}


def files_without_rows(data_dir: Path) -> set[str]:
    """Return the waveform files that no window names: room that is lost."""
    with closing(sqlite3.connect(data_dir / "preload.db")) as connection:
        named = {path for (path,) in connection.execute("SELECT DISTINCT file_path FROM windows")}
    return {str(path.relative_to(data_dir)) for path in (data_dir / "raw").rglob("*") if path.is_file()} - named
