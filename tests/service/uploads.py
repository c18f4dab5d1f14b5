"""Recordings to send over HTTP, and what is asked of a service that takes them."""

import io
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from monitor_core.recording import Session, Window
from monitor_core.recordings.session_hdf5 import write_session
from tests.service.conftest import N_WINDOWS, START, Api, simulated_measurement
from tests.service.test_jobs import wait_for

N_MEASUREMENTS = 4
MIB = 2**20

MAP = """axis_id = "axis"
[excitation]
channel = "torque"
quantity = "torque"
source = "sensor"
unit = "N.m"
[response]
channel = "acc"
unit = "m/s2"
[window]
sample_rate_hz = 1024
started_at = 2026-03-02T06:00:00Z
position_mm = 500.0
position_span_mm = 0.0
temperature_c = 21.5
payload_kg = 0.0
windows_in = "rows"
window_interval_s = 2.0
"""


def recorded(seed: int = 1, n_measurements: int = N_MEASUREMENTS, **fields: Any) -> list[Window]:
    rng = np.random.default_rng(seed)
    return [
        window
        for i in range(n_measurements)
        for window in simulated_measurement(
            rng, f"m{i}", n_windows=N_WINDOWS, started_at=START + timedelta(hours=i), **fields
        )
    ]


def session_bytes(folder: Path, windows: list[Window], axis: str = "axis") -> bytes:
    write_session(folder / "written.session.h5", Session(axis, tuple(windows)))
    return (folder / "written.session.h5").read_bytes()


def raw_bytes(seed: int = 3) -> bytes:
    """Return a file of one measurement, written by NumPy."""
    windows = simulated_measurement(np.random.default_rng(seed), "x", n_windows=N_WINDOWS)
    file = io.BytesIO()
    np.savez(file, torque=np.stack([w.excitation for w in windows]), acc=np.stack([w.response for w in windows]))
    return file.getvalue()


def upload(api: Api, *files: tuple[str, bytes], channel_map: str | None = None, axis: str = "axis") -> httpx.Response:
    parts: list[tuple[str, Any]] = [("file", (name, content)) for name, content in files]
    if channel_map is not None:
        parts.append(("map", ("mill.map.toml", channel_map)))
    return api.http.post(f"/v1/axes/{axis}/recordings", files=parts)


def uploaded(api: Api, *files: tuple[str, bytes], **options: Any) -> dict[str, Any]:
    """Upload, wait for the end of the job, and return the recording."""
    answer = upload(api, *files, **options)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert job["kind"] == "import"
    assert wait_for(api, job["id"], "done", "failed")["status"] == "done", job
    return get(api, job["arguments"]["recording"], axis=options.get("axis", "axis"))


def get(api: Api, number: int, axis: str = "axis") -> dict[str, Any]:
    answer = api.http.get(f"/v1/axes/{axis}/recordings/{number}")
    assert answer.status_code == 200, answer.text
    return answer.json()


def left_over(api: Api) -> list[Path]:
    return sorted((api.data_dir / "recordings").glob("*"))


def stored_windows(api: Api) -> list[Path]:
    return sorted((api.data_dir / "raw").rglob("*.zst"))


def assert_nothing_is_kept(api: Api, axis: str = "axis") -> None:
    assert left_over(api) == []
    assert stored_windows(api) == []
    assert api.http.get(f"/v1/axes/{axis}/recordings").json() == {"recordings": [], "next_cursor": None}
    assert api.http.get("/v1/jobs").json()["jobs"] == []
