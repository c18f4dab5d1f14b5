"""kill -9 at any moment of a purge: no row is lost, nothing is half gone, no room is lost, and it goes on."""

import shutil
import sqlite3
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import FrameType
from typing import Any

import httpx
import numpy as np
import pytest

from service.clock import now
from service.operations.purge import Purge
from service.operations.retention import rule_of
from service.settings import Settings
from service.store.database import Database
from service.store.safekeeping.backup import back_up
from service.store.waveforms import WaveformStore
from tests.conftest import free_port
from tests.service.conftest import Api, ServerProcess, running_service
from tests.service.killed_steps import Steps, count
from tests.service.plant_history import (
    N_WINDOWS,
    RULE,
    History,
    files_without_rows,
    lived,
    row_counts,
    stored_names,
)

N_ROUNDS, KILLS_OF_ROUND = 12, 3
N_KILLS_OF_SERVICE = 5
#: What reaches disk or database. Between two of these nothing changes that a crash could leave behind.
REACHING_OUT = {"fsync", "write", "unlink", "rmdir", "execute", "commit", "rollback"}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, History]:
    """Make a data folder with a history, of which nothing was let go yet."""
    folder = tmp_path_factory.mktemp("prepared") / "var"
    with running_service(folder) as api:
        return folder, lived(api)


def purge_until(data_dir: Path, step: int, counted: Any) -> None:
    """Purge in this process, and kill it before or after one of its calls that reach disk or database."""
    database, waveforms = Database(f"sqlite:///{data_dir}/preload.db"), WaveformStore(data_dir)
    purge = Purge(database, waveforms, rule_of(Settings(data_dir=data_dir, **RULE)), data_dir)
    with database.write() as session:
        number = purge.begin(session, "test", now()).id

    def profile(_frame: FrameType, event: str, called: Any) -> None:
        if event in ("c_call", "c_return") and called.__name__ in REACHING_OUT:
            count(counted, step)

    sys.setprofile(profile)
    purge.run(number, lambda done, total: None, time.sleep)
    sys.setprofile(None)


@pytest.mark.release
def test_purge_that_is_killed_again_and_again_ends_as_one_that_is_not(
    prepared: tuple[Path, History], tmp_path: Path
) -> None:
    folder, history = prepared
    calm = tmp_path / "calm"
    shutil.copytree(folder, calm)
    was_killed, n_steps = Steps(purge_until, calm).until(-1)
    assert not was_killed
    expected, rows = stored_names(calm), row_counts(calm)
    assert history.kept < expected.keys() < history.old.keys() | {"young"}

    rng, n_kills, left_something = np.random.default_rng(), 0, 0
    for number in range(N_ROUNDS):
        data_dir = tmp_path / f"round-{number}"
        shutil.copytree(folder, data_dir)
        for kill in range(KILLS_OF_ROUND):
            # the later ones fall into what the earlier ones left
            step = int(rng.integers(1, n_steps // (kill + 1)))
            was_killed, _ = Steps(purge_until, data_dir).until(step)
            n_kills += was_killed
            stored = stored_names(data_dir)  # each window is read and checked
            assert expected.keys() <= stored.keys()
            assert set(stored.values()) == {N_WINDOWS}
            assert row_counts(data_dir) == rows
            left_something += bool(unsettled(data_dir))
            assert files_without_rows(data_dir) <= unsettled(data_dir)  # what is left over is known
            if kill == number % KILLS_OF_ROUND:
                assert back_up(data_dir, tmp_path / f"backup-{number}", lambda _: None).damaged == ()
        was_killed, _ = Steps(purge_until, data_dir).until(-1)
        assert not was_killed
        assert stored_names(data_dir) == expected
        assert row_counts(data_dir) == rows
        assert files_without_rows(data_dir) == set()
        assert unsettled(data_dir) == set()
    assert n_kills >= 20
    assert left_something >= 5  # the kills hit the moments that matter


def unsettled(data_dir: Path) -> set[str]:
    with closing(sqlite3.connect(data_dir / "preload.db")) as connection:
        return {path for (path,) in connection.execute("SELECT path FROM unsettled_files")}


@pytest.mark.release
def test_service_that_is_killed_goes_on_with_its_purge(
    prepared: tuple[Path, History], tmp_path: Path, fork_server: Callable[..., ServerProcess]
) -> None:
    """It begins at the start by itself, and is the same job until it is done."""
    folder, history = prepared
    data_dir, port, rng = tmp_path / "var", free_port(), np.random.default_rng()
    shutil.copytree(folder, data_dir)
    rows = row_counts(data_dir)
    environment = {f"PRELOAD_{name.upper()}": str(value) for name, value in RULE.items()}
    for _ in range(N_KILLS_OF_SERVICE):
        server = fork_server(data_dir, port, **environment)
        server.wait_until_up()
        time.sleep(rng.uniform(0.0, 0.05))
        server.process.kill()
        server.process.wait()
        stored_names(data_dir)
        assert row_counts(data_dir) == rows
    server = fork_server(data_dir, port, **environment)
    server.wait_until_up()
    with httpx.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
        api, deadline = Api(http, data_dir), time.monotonic() + 60.0
        while (jobs := [job for job in api.http.get("/v1/jobs").json()["jobs"] if job["kind"] == "purge"])[0][
            "status"
        ] != "done":
            assert time.monotonic() < deadline, jobs
            time.sleep(0.05)
        assert len(jobs) == 1
        said = api.http.get("/v1/retention").json()
    server.process.terminate()
    server.process.wait()
    assert said["to_let_go"]["windows"] == 0
    stored = stored_names(data_dir)
    assert history.kept < stored.keys() < history.old.keys() | {"young"}
    assert said["let_go_windows"] == N_WINDOWS * (len(history.old) + 1 - len(stored)) == jobs[0]["result"]["windows"]
    assert row_counts(data_dir) == rows
    assert files_without_rows(data_dir) == set()
