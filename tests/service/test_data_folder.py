"""A data folder that the service cannot go on with: one sentence, and whatever lies there stays as it was."""

import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import httpx
import numpy as np
import pytest

from service.app import open_database
from service.errors import DataFolderError, ServiceError, StorageError
from service.settings import Settings
from tests.conftest import canary, free_port
from tests.service.conftest import (
    Api,
    ServerProcess,
    assert_problem,
    running_service,
    simulated_measurement,
)
from tests.service.test_serve import run_serve


def content_of(folder: Path) -> dict[str, bytes]:
    """Return every file of a folder, but for the lock, which holds nothing."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


def refusal(folder: Path, kind: type[ServiceError] = DataFolderError, **settings: object) -> str:
    """Return the sentence with which a service refuses to start."""
    with pytest.raises(kind) as refused:
        open_database(Settings(data_dir=folder, **settings)).close()
    sentence = str(refused.value)
    assert len(sentence) > 20
    assert "\n" not in sentence
    return sentence


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """Make a data folder with one judged measurement."""
    with running_service(tmp_path / "var") as api:
        api.register("axis")
        api.accept("axis", simulated_measurement(np.random.default_rng(1), "m"))
    return tmp_path / "var"


def test_second_service_on_a_folder_is_refused_and_the_first_goes_on(api: Api) -> None:
    api.register("axis")
    sentence = refusal(api.data_dir)
    assert str(api.data_dir) in sentence
    assert "in use by another process" in sentence
    done = run_serve("--port", "0", "--data-dir", api.data_dir)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.splitlines()[-1].startswith(f"preload: the data folder {api.data_dir} is in use")
    assert "Traceback" not in done.stderr
    assert api.accept("axis", simulated_measurement(np.random.default_rng(1), "m"))["accepted"] == 15


def test_folder_is_free_again_after_a_kill(tmp_path: Path, fork_server: Callable[..., ServerProcess]) -> None:
    server = fork_server(tmp_path, free_port())
    server.wait_until_up()
    assert str(tmp_path) in refusal(tmp_path)
    server.process.kill()
    server.process.wait()
    open_database(Settings(data_dir=tmp_path)).close()


@pytest.mark.parametrize("emptied", canary(["zero bytes", "gone", "new"]))
def test_empty_database_beside_waveforms_is_refused(kept: Path, emptied: str) -> None:
    path = kept / "preload.db"
    path.unlink()
    if emptied == "zero bytes":
        path.touch()
    elif emptied == "new":  # as somebody may have begun in another folder
        open_database(Settings(data_dir=kept.parent / "other")).close()
        (kept.parent / "other" / "preload.db").rename(path)
    before = content_of(kept)
    sentence = refusal(kept)
    assert str(kept / "raw") in sentence
    assert "backup" in sentence
    after = content_of(kept)
    assert {name: after[name] for name in before if name.startswith("raw/")} == {
        name: content for name, content in before.items() if name.startswith("raw/")
    }
    assert ("preload.db" in after) == (emptied != "gone")


def test_file_that_is_no_database_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "preload.db").write_bytes(b"the notes of somebody else\n" * 100)
    before = content_of(tmp_path)
    assert str(tmp_path / "preload.db") in refusal(tmp_path)
    assert content_of(tmp_path) == before


def test_database_of_another_program_is_left_alone(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "preload.db")) as connection:
        connection.execute("CREATE TABLE recipes (name TEXT)")
        connection.commit()
    before = content_of(tmp_path)
    sentence = refusal(tmp_path)
    assert "another program" in sentence
    assert "recipes" in sentence
    assert content_of(tmp_path) == before


def test_newer_database_is_left_alone(kept: Path) -> None:
    with closing(sqlite3.connect(kept / "preload.db")) as connection:
        connection.execute("UPDATE alembic_version SET version_num = '0999'")
        connection.commit()
    with closing(sqlite3.connect(kept / "preload.db")) as connection:
        before = list(connection.iterdump())
    assert "0999" in refusal(kept)
    with closing(sqlite3.connect(kept / "preload.db")) as connection:
        assert list(connection.iterdump()) == before


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Mount a folder once more in its own place, read-only."""
    if os.geteuid() != 0 or os.system(f"mount --bind {folder} {folder} 2>/dev/null") != 0:  # noqa: S605
        pytest.skip("a read-only volume takes the right to mount")
    try:
        if os.system(f"mount -o remount,bind,ro {folder}") != 0:  # noqa: S605
            pytest.skip("this system does not mount a folder read-only")
        yield
    finally:
        os.system(f"umount -l {folder}")  # noqa: S605


def test_read_only_volume_is_refused_at_the_start(kept: Path) -> None:
    before = content_of(kept)
    with read_only(kept):
        sentence = refusal(kept, StorageError)
    assert sentence == f"the data folder {kept} cannot be written: Read-only file system"
    assert content_of(kept) == before


def test_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert str(tmp_path / "file" / "var") in refusal(tmp_path / "file" / "var", StorageError)


def wait_until_idle() -> None:
    """Wait until this process, the service with it, has next to nothing to compute for a fifth of a second."""
    for _ in range(300):
        spent = time.process_time()
        time.sleep(0.2)
        if time.process_time() - spent < 0.01:
            return
    raise AssertionError("the service is still at work after a minute")


def test_locked_database_leaves_the_process_alive_and_not_ready(api: Api) -> None:
    api.register("axis")
    with closing(sqlite3.connect(api.data_dir / "preload.db")) as holder:
        holder.execute("BEGIN IMMEDIATE")
        windows = simulated_measurement(np.random.default_rng(1), "m")
        answers: list[httpx.Response] = []
        posting = [threading.Thread(target=lambda: answers.append(api.post("axis", windows))) for _ in range(45)]
        for thread in posting:
            thread.start()
        wait_until_idle()  # every post waits by now
        slowest = 0.0
        for _ in range(20):
            asked = time.monotonic()
            assert api.http.get("/healthz").status_code == 200
            slowest = max(slowest, time.monotonic() - asked)
        asked = time.monotonic()
        problem = assert_problem(api.http.get("/readyz"), 503, "storage-failed")
        assert time.monotonic() - asked < 20.0
        holder.rollback()
    assert slowest < 20.0  # a post waits for the lock for 30 s
    assert "database is locked" in problem["detail"]
    for thread in posting:
        thread.join()
    assert api.http.get("/readyz").status_code == 200
    assert {answer.status_code for answer in answers} <= {200, 201}  # they waited for the lock, and were served
    assert len(api.http.get("/v1/axes/axis/trend").json()["points"]) == 1


def test_database_that_is_gone_takes_nothing_more(api: Api, tmp_path: Path) -> None:
    """What is written into a file without a name would be acknowledged, and lost at the restart."""
    api.register("axis")
    path, away = api.data_dir / "preload.db", tmp_path / "away.db"
    windows = simulated_measurement(np.random.default_rng(1), "m")
    path.rename(away)
    for answer in (api.http.get("/readyz"), api.post("axis", windows), api.http.get("/v1/axes/axis")):
        assert str(path) in assert_problem(answer, 503, "storage-failed")["detail"]
    assert api.http.get("/healthz").status_code == 200
    path.write_bytes(away.read_bytes())
    assert "restart" in assert_problem(api.http.get("/readyz"), 503, "storage-failed")["detail"]
    path.unlink()
    away.rename(path)
    assert api.http.get("/readyz").status_code == 200
    assert api.accept("axis", windows)["accepted"] == 15


def test_data_folder_that_is_gone_is_not_ready(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/elsewhere.db"
    with running_service(tmp_path / "var", database_url=url) as api:
        (tmp_path / "var").rename(tmp_path / "away")
        problem = assert_problem(api.http.get("/readyz"), 503, "storage-failed")
    assert str(tmp_path / "var") in problem["detail"]


def test_service_on_a_volume_that_became_read_only_says_so(api: Api) -> None:
    api.register("axis")
    windows = simulated_measurement(np.random.default_rng(1), "m")
    with read_only(api.data_dir):
        assert "Read-only" in assert_problem(api.http.get("/readyz"), 503, "storage-failed")["detail"]
        assert_problem(api.post("axis", windows), 503, "storage-failed")
        assert api.axis("axis")["open_alarms"] == 0  # what is stored can be read
    assert api.http.get("/readyz").status_code == 200
    assert api.accept("axis", windows)["accepted"] == 15


def test_damaged_database_names_the_backup(kept: Path) -> None:
    """Rows that cannot be read are an error with a sentence, and what can be read is not written over."""
    path = kept / "preload.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'axes'").fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    content = bytearray(path.read_bytes())
    content[(root - 1) * size : root * size] = b"\xff" * size
    path.write_bytes(content)
    sentence = refusal(kept, StorageError)
    assert "is damaged" in sentence
    assert "restore the backup" in sentence
    assert path.read_bytes() == content
