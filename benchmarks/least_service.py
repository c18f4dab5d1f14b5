"""The least that a durable service can do with a request: receive it, put it on disk, acknowledge it.

``benchmarks.ingest`` sends it what it sends the service. Server and framework are the same, and so is what has to be on
disk before the answer: the bytes, at the end of a file, and a row. Nothing is read, checked or looked at.
"""

import argparse
import os
import sqlite3
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.concurrency import run_in_threadpool

from service.api.http.body import JSON_TYPE


def create_app(folder: Path) -> FastAPI:
    """Return an application that stores whatever it is sent below a folder."""
    app = FastAPI()
    database = sqlite3.connect(folder / "rows.db", isolation_level=None, check_same_thread=False)
    for statement in ("PRAGMA journal_mode=WAL", "PRAGMA synchronous=FULL", "CREATE TABLE bodies (at INTEGER)"):
        database.execute(statement)
    file = (folder / "bodies").open("ab", buffering=0)

    @app.post("/v1/axes/{axis}/windows")
    async def post_windows(axis: str, request: Request) -> Response:
        return await run_in_threadpool(store, await request.body())

    def store(body: bytes) -> Response:
        place = file.tell()
        file.write(body)
        os.fsync(file.fileno())
        database.execute("INSERT INTO bodies VALUES (?)", (place,))
        return Response(b"{}", 201, media_type=JSON_TYPE)

    return app


def main() -> None:
    """Serve on loopback."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--port", type=int, required=True)
    options = parser.parse_args()
    uvicorn.run(create_app(options.data_dir), port=options.port, log_level="warning", access_log=False)


if __name__ == "__main__":
    main()
