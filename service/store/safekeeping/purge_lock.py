"""Keep purges and backups apart: a purge removes files, a backup copies those that were named a while ago.

The lock is that of ``flock`` on ``purge.lock`` in the data folder, so that other programs can take it; on PostgreSQL a
purge holds one in the database as well, for services whose data folders are not the same.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import text

from service.store.database import Database

LOCK_FILE = "purge.lock"
_IN_DATABASE = 7102027


@contextmanager
def no_purge(data_dir: Path) -> Iterator[None]:
    """Wait until no purge is at work on a data folder, and let none begin meanwhile."""
    try:
        lock = os.open(data_dir / LOCK_FILE, os.O_RDONLY | os.O_CREAT, 0o600)
    except OSError:  # a folder that cannot be written is not purged either
        yield
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_SH)
        yield
    finally:
        os.close(lock)


@contextmanager
def purging(database: Database, data_dir: Path) -> Iterator[bool]:
    """Yield whether files may be removed now; if not, a backup or another purge is at work."""
    lock = os.open(data_dir / LOCK_FILE, os.O_RDONLY | os.O_CREAT, 0o600)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        if database.file is not None:
            yield True
            return
        with database.connect() as connection, connection.begin():
            query = text(f"SELECT pg_try_advisory_xact_lock({_IN_DATABASE})")
            yield bool(connection.execute(query).scalar())
    finally:
        os.close(lock)
