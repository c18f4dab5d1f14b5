"""Keep uploaded recordings: their rows, and their files in ``recordings/<folder>``, whole or not at all.

While files arrive, the folder ends in ``.part``; it has its name when the row that names it is committed. One that is
being removed ends in ``.gone`` until the row is gone. So what a crash left over is known by its name.
"""

import fcntl
import os
import shutil
import uuid
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import StorageError
from service.store.lookup import existing_of
from service.store.tables import RecordingRow
from service.store.waveform_files import make_folder, sync_folder

#: Uploaded: it has arrived, and is only looked into. Checked: each window can be taken. Imported: they are.
UPLOADED, CHECKED, IMPORTED = "uploaded", "checked", "imported"
#: So much of the disk is left to the windows that come in meanwhile.
ROOM_LEFT_BYTES = 256 * 2**20

#: Ends of the names of folders that are no recordings yet, or no more.
UNDER_WAY = _ARRIVING, _LEAVING = ".part", ".gone"


class ArrivingFolder:
    """A folder whose files arrive; unless it is kept, it is removed again. Other processes know that it is in use."""

    def __init__(self, root: Path) -> None:
        self.name = uuid.uuid4().hex
        self.path = root / f"{self.name}{_ARRIVING}"
        with _disk_errors():
            make_folder(root)
            self.path.mkdir()
            self._lock = _locked(self.path)
        self._kept = False

    def sync(self) -> None:
        """Wait until all that is in it is on disk."""
        with _disk_errors():
            # files and folders alike
            for path in (*self.path.rglob("*"), self.path, self.path.parent):
                sync_folder(path)

    def keep(self) -> None:
        """Let it be: a row is about to be committed that names it."""
        self._kept = True

    def close(self) -> None:
        """Remove it unless it is kept."""
        if not self._kept:
            shutil.rmtree(self.path, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


@dataclass(frozen=True, slots=True)
class Room:
    """What a disk has left."""

    free_bytes: int

    def require(self, n_bytes: int) -> None:
        """Refuse so many bytes if too little would be left; raises StorageError."""
        if self.free_bytes < n_bytes + ROOM_LEFT_BYTES:
            raise StorageError(
                f"a recording of {n_bytes / 2**20:.0f} MiB needs as much room on the disk and {ROOM_LEFT_BYTES >> 20} "
                f"MiB besides; {self.free_bytes / 2**20:.0f} MiB are free. Free some, then send it again"
            )


class RecordingFiles:
    """The folders of recordings below one folder."""

    def __init__(self, data_dir: Path) -> None:
        self._root = data_dir / "recordings"

    def begin(self) -> ArrivingFolder:
        """Make a folder for files that arrive.

        Raises StorageError if the disk does not take it.
        """
        return ArrivingFolder(self._root)

    def room(self) -> Room:
        """Return what the disk has left; raises StorageError."""
        with _disk_errors():
            make_folder(self._root)
            return Room(shutil.disk_usage(self._root).free)

    def require_room(self, n_bytes: int) -> None:
        """Refuse so many bytes if the disk would have too little left; raises StorageError."""
        self.room().require(n_bytes)

    def folder(self, name: str) -> Path:
        """Return the folder of a recording whose row is committed; it has its name from now on."""
        path = self._root / name
        if not path.is_dir():
            with suppress(FileNotFoundError):
                path.with_name(name + _ARRIVING).rename(path)
        return path

    def begin_removal(self, name: str) -> None:
        """Take a folder out of use; its row is about to be removed."""
        path = self.folder(name)
        with _disk_errors(), suppress(FileNotFoundError):
            path.rename(path.with_name(name + _LEAVING))

    def undo_removal(self, name: str) -> None:
        """Take a folder into use again: its row was not removed."""
        path = self._root / name
        with suppress(OSError):
            path.with_name(name + _LEAVING).rename(path)

    def end_removal(self, name: str) -> None:
        """Remove a folder that was taken out of use."""
        shutil.rmtree(self._root / (name + _LEAVING), ignore_errors=True)

    def clean_up(self, named: Collection[str]) -> None:
        """Settle what a crash left over: a folder that a row names is kept, any other that was under way is removed."""
        for path in [*self._root.glob(f"*{_ARRIVING}"), *self._root.glob(f"*{_LEAVING}")]:
            lock = _locked(path)
            if lock is None:
                continue  # another process is at work on it
            with suppress(OSError):
                if path.stem in named:
                    path.rename(path.with_suffix(""))
                else:
                    shutil.rmtree(path)
            os.close(lock)


def _locked(path: Path) -> int | None:
    """Hold a folder against other processes; None if one of them has it, or it is gone."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


@contextmanager
def _disk_errors() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise not_taken(error) from error


def not_taken(error: Exception) -> StorageError:
    """Return what is raised where the disk refused a part of a recording."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return StorageError(f"the disk did not take the recording ({reason}); nothing of it is stored")


def get_recording(session: Session, axis_id: str, recording_id: int) -> RecordingRow:
    """Return one recording of an axis or say that there is none."""
    return existing_of(axis_id, session.get(RecordingRow, recording_id), f"recording {recording_id}")


def list_recordings(session: Session, axis_id: str, before_id: int | None, limit: int) -> list[RecordingRow]:
    """Return recordings of an axis, newest first."""
    query = select(RecordingRow).where(RecordingRow.axis_id == axis_id)
    if before_id is not None:
        query = query.where(RecordingRow.id < before_id)
    return list(session.scalars(query.order_by(RecordingRow.id.desc()).limit(limit)))


def folders(session: Session) -> list[str]:
    """Return the folders that rows name."""
    return list(session.scalars(select(RecordingRow.folder)))
