"""kill -9 at any moment: no acknowledged window is lost, none is stored twice, and the trend is that of calm."""

import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest

from monitor_core.recording import Session, Window
from monitor_core.recordings.session_hdf5 import write_session
from service.api.http.body import MSGPACK_TYPE
from service.cli.remote.client import window_document
from service.store.waveforms import WaveformPlace, WaveformStore
from tests.conftest import canary, free_port
from tests.service.conftest import START, Api, ServerProcess, running_service, simulated_measurement
from tests.service.test_ingest import stored_frames

N_WINDOWS = 10
#: Half a measurement a request: the process dies while measurements are open, complete, and being judged.
PART = N_WINDOWS // 2
#: Between two kills fewer parts than this are acknowledged.
MOST_PARTS = 9
#: The job replays all measurements, each taken eight hours after the one before, in about so many seconds.
REPLAY_S = 3.6


def recorded_session(n_measurements: int) -> list[list[Window]]:
    """Return the measurements of an axis that loses preload towards the end."""
    rng = np.random.default_rng(1)
    return [
        simulated_measurement(
            rng,
            f"m{i:03d}",
            preload=300.0 if i < 2 * n_measurements // 3 else 220.0,
            position_mm=(400.0, 500.0, 600.0)[i % 3],
            started_at=START + timedelta(hours=8 * i),
            n_windows=N_WINDOWS,
        )
        for i in range(n_measurements)
    ]


def prepare(api: Api, axis: str) -> None:
    api.register(axis, windows_per_measurement=N_WINDOWS)
    api.calibrate(axis)


def judged(api: Api, axis: str) -> list[dict[str, Any]]:
    """Return what was said about the axis, without the numbers of rows."""
    points = [{**point, "measurement_id": None, "calibration": None} for point in api.trend(axis, limit=10_000)]
    alarms = api.http.get("/v1/alarms", params={"axis": axis}).json()["alarms"]
    return [*points, *(alarm["evidence"] for alarm in alarms)]


@dataclass
class Poster:
    """Posts part after part until each is acknowledged, whatever happens to the service meanwhile."""

    url: str
    parts: list[list[Window]]
    acknowledged: set[str] = field(default_factory=set)
    unexpected: list[str] = field(default_factory=list)
    may_go_on: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        with httpx.Client(base_url=self.url, timeout=30.0, trust_env=False) as http:
            for part in self.parts:
                self.may_go_on.wait()
                body = msgpack.packb({"windows": [window_document(window) for window in part]})
                while not self._is_acknowledged(http, body):
                    time.sleep(0.02)
                self.acknowledged |= {window.started_at.isoformat() for window in part}

    def _is_acknowledged(self, http: httpx.Client, body: bytes) -> bool:
        try:
            answer = http.post("/v1/axes/posted/windows", content=body, headers={"content-type": MSGPACK_TYPE})
        except httpx.TransportError:
            return False
        if answer.status_code not in (200, 201):
            self.unexpected.append(answer.text)
        return answer.is_success


def stored_windows(data_dir: Path, axis: str) -> list[str]:
    """Read the starts of the stored windows beside the service, as another program would."""
    with sqlite3.connect(f"file:{data_dir / 'preload.db'}?mode=ro", uri=True) as connection:
        rows = connection.execute("SELECT started_at FROM windows WHERE axis_id = ? ORDER BY started_at", (axis,))
        starts = [f"{started_at.replace(' ', 'T').removesuffix('.000000')}+00:00" for (started_at,) in rows]
    connection.close()
    return starts


def assert_waveforms_are_whole(data_dir: Path) -> int:
    """Read every frame that a row names, and check each window; return how many frames no row names."""
    with sqlite3.connect(data_dir / "preload.db") as connection:
        named = connection.execute(
            "SELECT file_path, offset_in_file, index_in_frame, content_sha256 FROM windows"
        ).fetchall()
    connection.close()
    store = WaveformStore(data_dir)
    store.read(WaveformPlace(*row) for row in named)
    store.close()
    return len(stored_frames(data_dir)) - len({(path, offset) for path, offset, *_ in named})


def errors_in_logs(folder: Path) -> list[str]:
    """Return what the servers logged as an error."""
    lines = (line for log in sorted(folder.glob("server-*.log")) for line in log.read_text().splitlines())
    return [line for line in lines if '"level": "ERROR"' in line]


@pytest.mark.parametrize(("n_kills", "n_measurements"), canary([(2, 30), (20, 120)]))
def test_kills_lose_nothing_acknowledged(
    tmp_path: Path, fork_server: Callable[..., ServerProcess], n_kills: int, n_measurements: int
) -> None:
    measurements = recorded_session(n_measurements)
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    write_session(sessions / "long.session.h5", Session("axis", tuple(w for windows in measurements for w in windows)))
    parts = [windows[i : i + PART] for windows in measurements for i in (0, PART)]

    with running_service(tmp_path / "calm") as api:
        prepare(api, "axis")
        for part in parts:
            api.accept("axis", part)
        expected = judged(api, "axis")
    assert len(expected) > n_measurements  # the loss is alarmed

    data_dir, port = tmp_path / "var", free_port()

    def start() -> ServerProcess:
        server = fork_server(data_dir, port, PRELOAD_REPLAY_DIR=str(sessions))
        server.wait_until_up()
        return server

    server = start()
    with httpx.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
        api = Api(http, data_dir)
        prepare(api, "posted")
        prepare(api, "replayed")
        job = http.post(
            "/v1/axes/replayed/replays", json={"session": "long", "speed": 8 * 3600 * n_measurements / REPLAY_S}
        ).json()
    poster = Poster(server.url, parts)
    thread = threading.Thread(target=poster.run, daemon=True)
    thread.start()
    server = kill_again_and_again(server, start, poster, data_dir, job["id"], n_kills=n_kills)
    assert thread.is_alive()  # every kill hit a replay
    poster.may_go_on.set()
    thread.join(timeout=300)
    assert not thread.is_alive()
    assert poster.unexpected == [], errors_in_logs(tmp_path)

    with httpx.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
        api = Api(http, data_dir)
        while (job := http.get(f"/v1/jobs/{job['id']}").json())["status"] in ("queued", "running"):
            time.sleep(0.1)
        assert (job["status"], job["done"], job["total"]) == ("done", *(n_measurements * N_WINDOWS,) * 2), job
        assert judged(api, "posted") == expected
        assert judged(api, "replayed") == expected
    every_start = [window.started_at.isoformat() for windows in measurements for window in windows]
    assert stored_windows(data_dir, "posted") == every_start
    assert stored_windows(data_dir, "replayed") == every_start
    server.process.terminate()
    server.process.wait()
    assert assert_waveforms_are_whole(data_dir) <= 2 * n_kills  # at most the one under way of each axis


def kill_again_and_again(
    server: ServerProcess,
    start: Callable[[], ServerProcess],
    poster: Poster,
    data_dir: Path,
    job_id: str,
    *,
    n_kills: int,
) -> ServerProcess:
    """Kill the service at random moments; look after each start whether anything acknowledged is missing."""
    rng = np.random.default_rng()
    progress, kills_of_job = 0, 0
    for _ in range(n_kills):
        enough = len(poster.acknowledged) + PART * rng.integers(0, MOST_PARTS)
        poster.may_go_on.set()
        while len(poster.acknowledged) < enough:
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.05))  # about as long as a request takes: the kill falls anywhere in it
        server.process.kill()
        server.process.wait()
        poster.may_go_on.clear()
        acknowledged = set(poster.acknowledged)
        server = start()
        stored = stored_windows(data_dir, "posted")
        assert acknowledged <= set(stored)
        assert len(stored) == len(set(stored))
        job = httpx.get(f"{server.url}/v1/jobs/{job_id}", trust_env=False, timeout=60.0).json()
        assert progress <= job["done"] <= len(stored_windows(data_dir, "replayed"))
        progress = job["done"]
        kills_of_job += job["status"] != "done"
    assert kills_of_job >= n_kills // 2
    return server
