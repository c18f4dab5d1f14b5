"""The file of the embedded database: that it is ours, that one process alone has it, that it is still there."""

import fcntl
import os
import sqlite3
from contextlib import closing
from pathlib import Path

from sqlalchemy.engine import make_url

from service.errors import DataFolderError, StorageError
from service.store.tables import VERSION_TABLE


class DatabaseFile:
    """A file that SQLite keeps a database in."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock: int | None = None
        self._identity: tuple[int, int] | None = None  # of the file that is open; None: not known yet

    def hold(self) -> None:
        """Take the file for this process until it ends or :meth:`release` is called.

        Raises DataFolderError if another process has it, StorageError if the folder cannot be written.
        """
        name = self.path.with_name(self.path.name + ".lock")
        try:
            name.parent.mkdir(parents=True, exist_ok=True)
            lock = os.open(name, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            raise StorageError(f"the data folder {self.path.parent} cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            raise DataFolderError(
                f"the data folder {self.path.parent} is in use by another process; stop that one, or start this one "
                "with a --data-dir of its own"
            ) from error
        self._lock = lock

    def release(self) -> None:
        """Let other processes have the file."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def require_ours(self) -> None:
        """Refuse a file that somebody else made, before anything is written into it; a new or empty one is ours.

        Raises DataFolderError with the reason.
        """
        if not self.path.exists() or not self.path.stat().st_size:
            return
        try:
            with closing(sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)) as connection:
                tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        except sqlite3.Error as error:
            raise DataFolderError(
                f"{self.path} cannot be read as a database ({error}); put the backup in its place, or move it away"
            ) from error
        if tables and VERSION_TABLE not in tables:
            raise DataFolderError(
                f"{self.path} is a database of another program (it has the tables {', '.join(sorted(tables)[:3])}, no "
                f"{VERSION_TABLE}); start with another --data-dir or PRELOAD_DATABASE_URL"
            )

    def remember(self) -> None:
        """Note which file is open, so that another one in its place is noticed."""
        self._identity = self._identity_now()

    def require_unmoved(self) -> None:
        """Refuse to go on with a file that has no name any more: what is written into it would be gone at a restart.

        Raises StorageError.
        """
        if self._identity is None:
            return
        try:
            moved = self._identity_now() != self._identity
        except OSError as error:
            raise StorageError(
                f"the database {self.path} is gone ({error.strerror}); put it back, or restore the backup and restart"
            ) from error
        if moved:
            raise StorageError(f"another file has replaced the database {self.path}; restart the service")

    def is_writable(self) -> bool:
        """Tell whether the file, and the volume it is on, may be written."""
        return os.access(self.path, os.W_OK)

    def _identity_now(self) -> tuple[int, int]:
        status = os.stat(self.path)
        return status.st_dev, status.st_ino


def database_file(url: str) -> DatabaseFile | None:
    """Return the file that an address names; None if the database is kept by a server, or in memory."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or not parsed.database:
        return None
    return DatabaseFile(Path(parsed.database))


def require_database_of(data_dir: Path, *, empty: bool) -> None:
    """Refuse an empty database beside waveforms: it would take new windows as if there had never been any.

    Raises DataFolderError.
    """
    raw = data_dir / "raw"
    if empty and any(path.is_file() for path in raw.rglob("*")):
        raise DataFolderError(
            f"{raw} holds waveforms, but the database of the same folder is empty or missing; "
            f"restore the database from the backup, or move {raw} away to begin anew"
        )
