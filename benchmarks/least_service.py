"""The least that a durable service can do with a request: what ``benchmarks.ingest`` compares the service with.

By default: receive it, put it on disk, acknowledge it; nothing is read, checked or looked at. With ``--judging`` it
does besides what an answer needs: it reads the MessagePack, hashes, compresses, gates, judges complete measurements,
and keeps rows of windows and outcomes. It has no limits, no conflicts, no order, no trend and no charts, and believes
what it is sent. Server and framework are the service's, and so is what has to be on disk before the answer.
"""

import argparse
import hashlib
import json
import os
import sqlite3
import threading
from collections import defaultdict
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import uvicorn
import zstandard
from fastapi import FastAPI, Request, Response
from fastapi.concurrency import run_in_threadpool

from benchmarks import ingest
from monitor_core.pipeline import check_window, judge_measurement
from monitor_core.recording import Conditions, ExcitationSource, Rejection, Window
from service.api.http.body import JSON_TYPE
from service.blas_threads import compute_in_one_thread
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings

_TABLES = (
    "CREATE TABLE bodies (at INTEGER)",
    "CREATE TABLE windows (axis TEXT, started_at TEXT, sha256 TEXT, place INTEGER, PRIMARY KEY (axis, started_at))",
    "CREATE TABLE measurements (axis TEXT, document TEXT)",
)


class Disk:
    """One file and one database, for one thread at a time."""

    def __init__(self, folder: Path) -> None:
        self.rows = sqlite3.connect(folder / "rows.db", isolation_level=None, check_same_thread=False)
        for statement in ("PRAGMA journal_mode=WAL", "PRAGMA synchronous=FULL", *_TABLES):
            self.rows.execute(statement)
        self.file = (folder / "bodies").open("ab", buffering=0)
        self.turn = threading.Lock()

    def keep(self, _axis: str, body: bytes) -> object:
        """Put a body on disk, and a row that says where."""
        with self.turn:
            place = self.file.tell()
            self.file.write(body)
            os.fsync(self.file.fileno())
            self.rows.execute("INSERT INTO bodies VALUES (?)", (place,))
        return {}


class Judging:
    """Gates and judges what it keeps."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk
        self._open: dict[tuple[str, str], list[Window]] = defaultdict(list)
        self._settings = core_settings(AxisConfiguration.model_validate(ingest.CONFIGURATION))
        self._calibration = ingest.calibration()

    def take(self, axis: str, body: bytes) -> object:
        """Do with the windows of a body all that has to be done before they are acknowledged."""
        with self._disk.turn:
            self._disk.rows.execute("BEGIN IMMEDIATE")
            windows = msgpack.unpackb(body)["windows"]
            place = self._disk.file.tell()
            self._disk.file.write(zstandard.ZstdCompressor(level=1).compress(body))
            outcomes = [outcome for document in windows for outcome in self._window(axis, document, place)]
            os.fsync(self._disk.file.fileno())
            self._disk.rows.execute("COMMIT")
        return {"accepted": len(windows), "measurements": outcomes}

    def _window(self, axis: str, document: dict[str, Any], place: int) -> list[dict[str, float]]:
        window = Window(
            excitation=np.frombuffer(document["excitation"], "<f4"),
            response=np.frombuffer(document["response"], "<f4"),
            sample_rate=document["sample_rate_hz"],
            started_at=datetime.fromisoformat(document["started_at"]),
            conditions=Conditions(1e-3 * document["position_mm"], document["payload_kg"]),
            measurement=document["measurement"],
            excitation_source=ExcitationSource(document["excitation_source"]),
        )
        digest = hashlib.sha256(document["excitation"])
        digest.update(document["response"])
        row = (axis, document["started_at"], digest.hexdigest(), place)
        self._disk.rows.execute("INSERT INTO windows VALUES (?, ?, ?, ?)", row)
        together = self._open[axis, window.measurement]
        if not isinstance(check_window(window, self._settings, self._calibration), Rejection):
            together.append(window)
        if len(together) < ingest.N_WINDOWS:
            return []
        estimate = judge_measurement(self._open.pop((axis, window.measurement)), self._settings, self._calibration)
        assert not isinstance(estimate.preload, Rejection)
        outcome = {"preload_n": estimate.preload.preload}
        self._disk.rows.execute("INSERT INTO measurements VALUES (?, ?)", (axis, json.dumps(outcome)))
        return [outcome]


def create_app(take: Callable[[str, bytes], object]) -> FastAPI:
    """Return an application that hands over whatever it is sent."""
    app = FastAPI()

    @app.post("/v1/axes/{axis}/windows")
    async def post_windows(axis: str, request: Request) -> Response:
        answer = await run_in_threadpool(take, axis, await request.body())
        return Response(json.dumps(answer).encode(), 201, media_type=JSON_TYPE)

    return app


def main() -> None:
    """Serve on loopback."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--judging", action="store_true")
    options = parser.parse_args()
    compute_in_one_thread()
    disk = Disk(options.data_dir)
    take = Judging(disk).take if options.judging else disk.keep
    uvicorn.run(create_app(take), port=options.port, log_level="warning", access_log=False)


if __name__ == "__main__":
    main()
