"""The least that a durable service can do with a request: receive it, put it on disk, acknowledge it.

``benchmarks.ingest`` sends it what it sends the service. Server and framework are the same, and so is what has to be on
disk before the answer: a new file, its name in the folder, and a row. Nothing is read, checked or looked at.
"""

import argparse
import os
import sqlite3
import uuid
from pathlib import Path
from typing import Annotated

import uvicorn
from fastapi import Depends, FastAPI, Response

from service.api.body import JSON_TYPE, raw_body


def create_app(folder: Path) -> FastAPI:
    """Return an application that stores whatever it is sent below a folder."""
    app = FastAPI()
    database = sqlite3.connect(folder / "rows.db", isolation_level=None, check_same_thread=False)
    for statement in ("PRAGMA journal_mode=WAL", "PRAGMA synchronous=FULL", "CREATE TABLE files (name TEXT)"):
        database.execute(statement)
    names = os.open(folder, os.O_RDONLY)

    @app.post("/v1/axes/{axis}/windows")
    def post_windows(axis: str, body: Annotated[bytes, Depends(raw_body)]) -> Response:
        name = f"{axis}-{uuid.uuid4().hex}"
        with (folder / name).open("xb", buffering=0) as file:
            file.write(body)
            os.fsync(file.fileno())
        os.fsync(names)
        database.execute("INSERT INTO files VALUES (?)", (name,))
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
