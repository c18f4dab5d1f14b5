"""What is stored is its owner's alone, whatever the umask was; and a folder that takes nothing is told."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from service.errors import StorageError
from service.operations.access.people import People
from service.store.database import Database
from service.store.safekeeping.backup import back_up, restore
from service.store.safekeeping.private import private_folder
from tests.service.conftest import Api, assert_problem, running_service, simulated_measurement
from tests.service.test_recordings import session_bytes, upload


@pytest.fixture(params=[0o000, 0o022])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def open_to_others(folder: Path) -> list[str]:
    """Return what of a folder others than its owner have any right to."""
    return [str(path) for path in (folder, *folder.rglob("*")) if path.stat().st_mode & 0o077]


def test_all_that_is_stored_is_its_owners_alone(tmp_path: Path, umask: int) -> None:
    rng, data_dir = np.random.default_rng(1), tmp_path / "var"
    with running_service(data_dir) as api:
        api.register("axis")
        api.accept("axis", simulated_measurement(rng, "m", n_windows=2))
        content = session_bytes(tmp_path, simulated_measurement(rng, "n", n_windows=2))
        assert upload(api, ("n.session.h5", content)).status_code == 202
        assert {path.name for path in data_dir.iterdir()} >= {"preload.db", "preload.db-wal", "raw", "recordings"}
        assert open_to_others(data_dir) == []
        os.umask(umask)  # a backup is a process of its own
        back_up(data_dir, tmp_path / "backup", lambda _: None)
        assert open_to_others(tmp_path / "backup") == []
    os.umask(umask)
    restore(tmp_path / "backup", tmp_path / "restored", lambda _: None)
    assert open_to_others(tmp_path / "restored") == []


def test_a_folder_of_an_older_program_is_closed_when_it_is_opened(tmp_path: Path, umask: int) -> None:
    folder = tmp_path / "var"
    folder.mkdir(mode=0o755)
    database = Database(f"sqlite:///{folder}/preload.db")
    database.migrate()
    People(database, "test").add_user("anna", "viewer", "x" * 10)
    for path in folder.iterdir():  # the log of the database, too: it is open
        path.chmod(0o644)
    with pytest.MonkeyPatch.context() as of_another:
        of_another.setattr(os, "geteuid", lambda: os.getuid() + 1)
        private_folder(folder)
        assert open_to_others(folder)  # whoever owns it decides
        (folder / "rewritten").touch()
        assert (folder / "rewritten").stat().st_mode & 0o777 == 0o666 & ~umask  # its owner reads it, too
        (folder / "rewritten").unlink()
    os.umask(umask)
    private_folder(folder)
    Database(f"sqlite:///{folder}/preload.db").close()
    assert open_to_others(folder) == []
    database.close()


def test_a_copy_beside_the_database_keeps_its_rights_and_a_log_may_be_gone(tmp_path: Path) -> None:
    path, log, copy = (tmp_path / name for name in ("preload.db", "preload.db-wal", "preload.db.copy"))
    for file in (path, copy):
        file.touch()
        file.chmod(0o644)
    log.symlink_to("gone")  # is listed, and is no file: as one that is removed meanwhile
    Database(f"sqlite:///{path}").close()
    assert [file.stat().st_mode & 0o777 for file in (path, copy)] == [0o600, 0o644]


def test_a_database_whose_rights_cannot_be_read_is_refused_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "preload.db").symlink_to("preload.db")
    with pytest.raises(StorageError, match="cannot be made its owner's alone: Too many levels"):
        Database(f"sqlite:///{tmp_path}/preload.db")


@pytest.mark.parametrize("name", ["raw", "recordings", "reports"])
def test_a_folder_that_cannot_be_written_is_not_ready(api: Api, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    folder = api.data_dir / name
    assert api.http.get("/readyz").status_code == 200
    assert not folder.exists()  # a probe leaves nothing
    folder.touch()  # also root cannot write into it
    problem = assert_problem(api.http.get("/readyz"), 503, "storage-failed")
    assert problem["detail"] == f"the data folder {folder} cannot be written: Not a directory"
    folder.unlink()
    folder.mkdir()
    assert api.http.get("/readyz").status_code == 200
    real = tempfile.TemporaryFile

    def on_read_only_volume(*, dir: Path) -> object:  # noqa: A002 - what the library calls it
        if dir == folder:
            raise OSError(30, "Read-only file system")
        return real(dir=dir)

    monkeypatch.setattr(tempfile, "TemporaryFile", on_read_only_volume)
    problem = assert_problem(api.http.get("/readyz"), 503, "storage-failed")
    assert problem["detail"].endswith("Read-only file system")
