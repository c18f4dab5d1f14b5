"""Keep what works at an axis in order: one thread of a service at a time, and one service on a shared PostgreSQL.

No service works while another one upgrades the schema. The locks between services are PostgreSQL's advisory locks of a
transaction: they end with it, and with the connection of a service that was killed. The embedded database needs none:
one process has its file.
"""

import os
import socket
import threading
import uuid
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from weakref import WeakValueDictionary

from sqlalchemy import Connection, text
from sqlalchemy.orm import Session

from service.clock import now
from service.errors import StorageError
from service.store.tables import VERSION_TABLE

#: Who upgrades the schema holds it alone, who writes holds it with others.
_UPGRADE = 7102018
#: First key of the locks of axes; the second one is a hash of the name. Two axes of one hash wait for each other.
_AXES = 7102019

_LOCK_AXIS = text(f"SELECT pg_advisory_xact_lock({_AXES}, :hash)")
_TRY_AXES = text(
    f"SELECT hash, pg_try_advisory_xact_lock({_AXES}, hash) FROM unnest(CAST(:hashes AS integer[])) AS hash"  # noqa: S608
)
# Two statements in one message: the second one sees what was committed while the first one waited.
_ENTER = f"SELECT pg_advisory_xact_lock_shared({_UPGRADE}); SELECT version_num FROM {VERSION_TABLE}"  # noqa: S608


class AxisLocks:
    """Locks by axis. They order work inside one process; the database keeps several processes apart."""

    def __init__(self) -> None:
        # Weak: a lock lives as long as somebody has it or waits for it, so names nobody registered leave nothing.
        self._locks: WeakValueDictionary[str, threading.RLock] = WeakValueDictionary()
        self._guard = threading.Lock()

    @contextmanager
    def held(self, axis_ids: Sequence[str]) -> Iterator[None]:
        """Hold the locks of axes; in one order, so that no two threads wait for each other."""
        with ExitStack() as stack:
            for axis_id in sorted(axis_ids):
                with self._guard:
                    lock = self._locks.get(axis_id) or threading.RLock()
                    self._locks[axis_id] = lock
                stack.enter_context(lock)
            yield


def is_shared(connection: Connection) -> bool:
    """Tell whether other services may be at work in the same database."""
    return connection.dialect.name == "postgresql"


def keep_others_out(connection: Connection) -> None:
    """Wait until no other service upgrades the schema or writes, however long; until the transaction ends none does."""
    connection.execute(text("SET LOCAL lock_timeout = 0"))
    connection.execute(text(f"SELECT pg_advisory_xact_lock({_UPGRADE})"))


def require_schema(connection: Connection, version: str) -> None:
    """Keep others from upgrading the schema until the transaction ends.

    Raises StorageError if the schema is not of this version any more.
    """
    cursor = connection.connection.cursor()
    cursor.execute(_ENTER)
    cursor.nextset()
    row = cursor.fetchone()
    stored = "none" if row is None else row[0]
    if stored != version:
        raise StorageError(
            f"the schema of the database is of version {stored} now, and this program writes version {version}: a "
            "service of another version has upgraded it; stop this one, and start that version here, too"
        )


def lock_axis(connection: Connection, axis_id: str) -> None:
    """Have an axis alone until the transaction ends; wait for the service that has it.

    Nobody waits who holds an axis already, so that no two services ever wait for each other.
    """
    connection.execute(_LOCK_AXIS, {"hash": _hash(axis_id)})


def lock_free_axes(connection: Connection, axis_ids: Sequence[str]) -> list[str]:
    """Have those of some axes alone that nobody has at this moment, and return them."""
    hashes = {_hash(axis_id) for axis_id in axis_ids}
    taken = {row[0] for row in connection.execute(_TRY_AXES, {"hashes": sorted(hashes)}) if row[1]}
    return [axis_id for axis_id in axis_ids if _hash(axis_id) in taken]


def lease_owner() -> str:
    """Return a new name to hold leases by: host and process for who reads it, and what nobody else has."""
    return f"{socket.gethostname()[:40]}/{os.getpid()}/{uuid.uuid4().hex[:12]}"


def database_time(session: Session) -> datetime:
    """Return the time by which leases run: of the one clock that all services share."""
    if not is_shared(session.connection()):
        return now()
    at: datetime = session.connection().execute(text("SELECT clock_timestamp()")).scalar_one()
    return at


def _hash(axis_id: str) -> int:
    return zlib.crc32(axis_id.encode()) - 2**31
