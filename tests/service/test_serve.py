"""``preload serve`` as a process: how it starts, what it says when it cannot, how it stops."""

import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from datetime import timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest

from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from service.cli.remote.server import ENDS_WITHIN_S, GRACE_S
from service.store import notices
from service.store.database import Database
from tests.conftest import free_port
from tests.service.conftest import START, ServerProcess, simulated_measurement
from tests.service.test_access import served


def run_serve(*words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``preload serve`` where it is expected to end by itself."""
    command = [sys.executable, "-m", "service.cli.main", "serve", *words]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=60, env=os.environ | environment
    )


def test_port_in_use_is_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = run_serve("--port", str(port), "--data-dir", tmp_path / "var")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == f"preload: cannot listen on 127.0.0.1 port {port}: Address already in use\n"
    assert not (tmp_path / "var").exists()


@pytest.mark.release
def test_database_that_is_not_there_ends_the_start(tmp_path: Path) -> None:
    url = f"postgresql+psycopg://user:secret@127.0.0.1:{free_port()}/none"
    done = run_serve("--port", "0", "--data-dir", tmp_path, PRELOAD_DATABASE_URL=url)
    assert done.returncode == 1
    assert "secret" not in done.stderr
    assert "dashboard" not in done.stderr  # no address that nobody listens on
    assert re.search(r"^preload: the database refused: .+$", done.stderr, re.MULTILINE), done.stderr
    assert "Traceback" not in done.stderr


def test_address_is_printed_once_the_service_listens(tmp_path: Path, fork_server: Callable[..., ServerProcess]) -> None:
    """A start that takes long, here because the database is locked, does not name an address that nobody answers."""
    Database(f"sqlite:///{tmp_path}/preload.db").migrate()
    with closing(sqlite3.connect(tmp_path / "preload.db")) as holder:
        holder.execute("BEGIN IMMEDIATE")
        server = fork_server(tmp_path, free_port())
        while "Started server process" not in server.log.read_text():
            time.sleep(0.05)
        time.sleep(0.5)
        assert "dashboard" not in server.log.read_text()
        assert not server.is_up()
        holder.rollback()
    while "dashboard" not in server.log.read_text():
        time.sleep(0.01)
    assert server.is_up()


@pytest.mark.release
def test_starts_beside_unknown_variables_and_stops_soon_while_a_job_runs(
    tmp_path: Path, start_server: Callable[..., ServerProcess]
) -> None:
    rng = np.random.default_rng(1)
    windows = [
        window
        for i in range(3)
        for window in simulated_measurement(rng, f"m{i}", n_windows=8, started_at=START + timedelta(hours=i))
    ]
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    write_session(sessions / "slow.session.h5", Session("axis", tuple(windows)))
    server = start_server(tmp_path / "var", free_port(), PRELOAD_SOMETHING_ELSE="1", PRELOAD_REPLAY_DIR=str(sessions))
    server.wait_until_up()
    with httpx.Client(base_url=server.url, trust_env=False, timeout=30.0) as http:
        assert http.put("/v1/axes/axis", json={"name": "axis"}).status_code == 201
        answer = http.post("/v1/axes/axis/replays", json={"session": "slow", "speed": 1.0})  # lasts two hours
        while http.get(answer.headers["location"]).json()["done"] == 0:
            time.sleep(0.02)
    stopped = time.monotonic()
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(timeout=15) in (0, -signal.SIGTERM)
    assert time.monotonic() - stopped < 5.0
    log = server.log.read_text()
    assert "Traceback" not in log
    assert len(re.findall(rf"^dashboard: {server.url}/ +API: {server.url}/docs$", log, re.MULTILINE)) == 1
    assert '"message": "PUT /v1/axes/{axis} 201"' in log


def test_receivers_that_do_not_answer_delay_a_stop_together_and_not_until_the_process_is_killed(tmp_path: Path) -> None:
    with ExitStack() as silent:
        listening = silent.enter_context(socket.create_server(("127.0.0.1", 0)))
        listening.settimeout(20.0)
        port = listening.getsockname()[1]
        brokers = [f"[[mqtt]]\nname = 'b{i}'\nhost = '127.0.0.1'\nport = {port}\n" for i in range(2)]
        receivers = tmp_path / "receivers.toml"
        desk = f"[[webhook]]\nname = 'desk'\nurl = 'http://127.0.0.1:{port}/'\n"
        receivers.write_text("".join(brokers) + desk, encoding="utf-8")
        with served(tmp_path / "var", receivers_file=receivers) as (app, _):
            with app.state.services.database.write() as session:
                notices.add_notice(session, START, "org.test.raised", "axes/a", {"axis": "a"})
            for _ in range(5):  # each broker is told of states and of notices
                silent.enter_context(listening.accept()[0])
            stopped = time.monotonic()
        assert time.monotonic() - stopped < ENDS_WITHIN_S - GRACE_S
