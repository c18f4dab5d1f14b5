"""Connect to the database: SQLite in WAL mode by default, PostgreSQL by URL."""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from itertools import count
from pathlib import Path
from threading import local
from typing import Any, cast
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import DBAPIError, IntegrityError, TimeoutError as PoolTimeoutError
from sqlalchemy.orm import Session
from sqlalchemy.orm.exc import StaleDataError

from service.errors import BusyError, StorageError
from service.json_types import document_of
from service.store.safekeeping.database_file import database_file
from service.store.safekeeping.private import close_to_others
from service.store.schema import VERSION, bring_up_to_date
from service.store.service_order import AxisLocks, is_shared, keep_others_out, lock_axis, lock_free_axes, require_schema

#: One for each of the worker threads that answer requests (40, starlette's default), and a few for jobs.
CONNECTIONS = 48
#: A writer waits so long for the one before it.
PATIENCE_MS = 30_000
#: Who asks whether the database can be written waits no longer than that.
PATIENCE_OF_CHECK_MS = 1000

#: Of a service whose machine is gone the server lets go after that, and the next one may work at its axes.
_SESSION = f"SET lock_timeout = {PATIENCE_MS}; SET idle_in_transaction_session_timeout = {20 * PATIENCE_MS}; " + (
    "SET tcp_keepalives_idle = 10; SET tcp_keepalives_interval = 5; SET tcp_keepalives_count = 3"
)

#: What PostgreSQL calls it when somebody had to wait too long, or two waited for each other.
_WAITED_TOO_LONG = ("55P03", "40P01", "40001")
#: What SQLite calls a file that is not what it wrote.
_DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB")


class Database:
    """An engine, and the ways in: sessions to :meth:`read` and :meth:`write`, and the connections they rest on."""

    def __init__(self, url: str) -> None:
        self.engine = _create_engine(url)
        _COMMITS[self.engine] = _Commits()
        self.file = database_file(url)  # None: kept by a server
        self._locks = AxisLocks()
        self._moment = local()  # of each thread: the session of :meth:`at_one_moment`
        self._schema: str | None = None  # that this program writes, as soon as it is brought up to date

    @contextmanager
    def connect(self) -> Iterator[Connection]:
        """Open a connection, for one transaction (:func:`reading`, :func:`writing`) after another.

        Raises StorageError or BusyError if the database did not take what a transaction wrote; then it changed nothing.
        """
        if self.file is not None:
            self.file.require_unmoved()
        driver: Any = self.engine.dialect.loaded_dbapi
        with _translated(driver), self.engine.connect() as connection:
            try:
                yield connection
            except (DBAPIError, driver.Error):
                connection.invalidate()
                raise
            finally:
                if self.file is not None and not self.file.is_writable():
                    # opened while the volume is read-only, it would stay so when that is mended
                    connection.invalidate()

    @contextmanager
    def translated(self) -> Iterator[None]:
        """Turn errors of the database into those of the service, for a part of what :meth:`connect` is open for."""
        with _translated(self.engine.dialect.loaded_dbapi):
            yield

    @contextmanager
    def at_one_moment(self) -> Iterator[None]:
        """Let all that is read inside be read in one session, at one moment: a page is many answers."""
        with self.read() as session:
            self._moment.session = session
            try:
                yield
            finally:
                self._moment.session = None

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Open a connection, to read what was committed at one moment."""
        opened: Session | None = getattr(self._moment, "session", None)
        if opened is not None:
            yield opened.connection()
            return
        with self.connect() as connection, reading(connection):
            yield connection

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Open a session for reading."""
        opened: Session | None = getattr(self._moment, "session", None)
        if opened is not None:
            yield opened
            return
        with self.reading() as connection, Session(connection, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def write(self, axis_id: str | None = None) -> Iterator[Session]:
        """Open a session for writing, which commits at the end; what depends on the state of an axis names it.

        Nobody else works at that axis meanwhile. Raises BusyError if another service does for too long.
        """
        with (
            self.alone_at([] if axis_id is None else [axis_id]),
            self.connect() as connection,
            writing(connection),
            Session(connection, expire_on_commit=False) as session,
        ):
            self._enter(connection)
            if axis_id is not None and is_shared(connection):
                lock_axis(connection, axis_id)
            yield session
            session.flush()

    def alone_at(self, axis_ids: Sequence[str]) -> AbstractContextManager[None]:
        """Keep the other threads of this service from working at axes; who has them may ask again."""
        return self._locks.held(axis_ids)

    @property
    def schema(self) -> str:
        """Version of the schema, as this program writes it; empty before :meth:`migrate`."""
        return self._schema or ""

    def revision(self) -> str:
        """Return what differs after every commit: counted here in memory, on a server asked of it, without any table.

        A server is asked because other services commit there, too.
        """
        if self.file is not None:
            return str(_COMMITS[self.engine].last)
        with self.connect() as connection, reading(connection):
            return str(connection.execute(text("SELECT pg_current_snapshot()")).scalar())

    @contextmanager
    def at_axes(self, connection: Connection, axis_ids: Sequence[str], *, wait: bool) -> Iterator[list[str]]:
        """Work at axes while nobody else does, and yield those that one may work at; commits at the end.

        That is those that no other service works at, and at least one: where there is none, or where ``wait`` says so,
        it is waited for the first. The embedded database is of one service: nothing is begun, and all are yielded.
        """
        if not is_shared(connection):
            with self.alone_at(axis_ids):
                yield list(axis_ids)
            return
        with self.alone_at(axis_ids), connection.begin():
            self._enter(connection)
            if wait:
                lock_axis(connection, axis_ids[0])
            free = lock_free_axes(connection, axis_ids)
            if not free:
                lock_axis(connection, axis_ids[0])
            yield free or [axis_ids[0]]

    def _enter(self, connection: Connection) -> None:
        if self._schema is not None and is_shared(connection):
            require_schema(connection, self._schema)

    def migrate(self) -> None:
        """Make the tables, or bring those of an older program up to date.

        Raises DataFolderError if the schema is of a newer program, of another one, or too old; then nothing is changed.
        """
        if self.file is not None:
            self.file.require_ours()
        with self.connect() as connection, writing(connection):
            if is_shared(connection):  # two services starting together must not both do it
                keep_others_out(connection)
            bring_up_to_date(connection)
        self._schema = VERSION
        if self.file is not None:
            self.file.remember()

    def check(self) -> None:
        """Raise StorageError if the database does not answer, or takes nothing: within a second, or of this version."""
        with self.connect() as connection:
            if connection.dialect.name == "sqlite":
                driver = cast(sqlite3.Connection, connection.connection.driver_connection)
                driver.execute(f"PRAGMA busy_timeout={PATIENCE_OF_CHECK_MS}")
                try:
                    driver.execute("BEGIN IMMEDIATE")
                    driver.execute("ROLLBACK")
                finally:
                    driver.execute(f"PRAGMA busy_timeout={PATIENCE_MS}")
            elif connection.execute(text("SHOW transaction_read_only")).scalar() == "on":
                raise StorageError("the database is read-only; nothing can be stored")
            else:
                self._enter(connection)

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()
        if self.file is not None:
            self.file.release()


class _Commits:
    """Counts the commits of an engine; to take the next number of a count is one step, whichever thread does it."""

    def __init__(self) -> None:
        self._numbers = count(1)
        self.last = 0

    def note(self) -> None:
        self.last = next(self._numbers)


_COMMITS: WeakKeyDictionary[Engine, _Commits] = WeakKeyDictionary()


@contextmanager
def reading(connection: Connection) -> Iterator[None]:
    """Read what was committed at one moment; in WAL mode this never waits for a writer.

    Here and below: inside :meth:`Database.at_axes` it is a part of that transaction.
    """
    if connection.in_transaction():
        yield
        return
    with connection.begin() as transaction:
        _begin(connection, "DEFERRED")
        yield
        transaction.rollback()


@contextmanager
def writing(connection: Connection) -> Iterator[None]:
    """Take the write lock at once, and commit at the end, durably."""
    if connection.in_transaction():
        yield
        return
    with connection.begin():
        _begin(connection, "IMMEDIATE")
        yield
    _COMMITS[connection.engine].note()


@contextmanager
def trying(connection: Connection) -> Iterator[None]:
    """Write as :func:`writing` does, and undo everything at the end."""
    with connection.begin() as transaction:
        _begin(connection, "IMMEDIATE")
        yield
        transaction.rollback()


def _begin(connection: Connection, mode: str) -> None:
    # Not by an event of the engine: where there is one, listeners are looked for at each statement.
    if connection.dialect.name == "sqlite":
        cast(sqlite3.Connection, connection.connection.driver_connection).execute(f"BEGIN {mode}")


@contextmanager
def _translated(driver: Any) -> Iterator[None]:  # noqa: ANN401 - a module, whichever
    """Turn errors of SQLAlchemy and of the driver (a DB-API module) into those of the service."""
    try:
        yield
    except (IntegrityError, driver.IntegrityError, StaleDataError) as error:
        raise BusyError("another process changed the same thing at this moment; send the request again") from error
    except PoolTimeoutError as error:
        raise BusyError("every database connection is taken; send the request again") from error
    except (DBAPIError, driver.Error) as error:
        cause = error.orig if isinstance(error, DBAPIError) else error
        reason = str(cause).strip().partition("\n")[0]
        if getattr(cause, "sqlstate", None) in _WAITED_TOO_LONG:
            raise BusyError(
                f"another service has been at work on the same for {PATIENCE_MS // 1000} s; send the request again"
            ) from error
        if getattr(cause, "sqlite_errorname", "").startswith(_DAMAGED):
            raise StorageError(f"the database is damaged ({reason}); restore the backup and restart") from error
        raise StorageError(f"the database refused: {reason}; send the request again") from error


def _create_engine(url: str) -> Engine:
    if make_url(url).get_backend_name() != "sqlite":
        return _server_engine(url)
    database = make_url(url).database
    if database:
        _prepare_file(Path(database))
    engine = create_engine(
        url,
        pool_size=CONNECTIONS,
        json_deserializer=document_of,
        connect_args={"timeout": PATIENCE_MS / 1000, "check_same_thread": False},
    )

    @event.listens_for(engine, "connect")
    def _configure(connection: Any, _record: Any) -> None:  # noqa: ANN401 - the driver's own connection
        connection.isolation_level = None  # the driver's own BEGIN comes too late for IMMEDIATE: see _begin
        cursor = connection.cursor()
        # FULL: an acknowledged window must survive a power cut, which NORMAL does not promise in WAL mode.
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={PATIENCE_MS}"):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    return engine


def _prepare_file(path: Path) -> None:
    """Make the folder of a database, and close what there is of it to others: copies beside it are a person's own."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for ending in ("", "-wal", "-shm"):  # the log took the rights of the database
            with suppress(FileNotFoundError):  # the last process to leave it removes the log
                close_to_others(path.with_name(path.name + ending))
    except OSError as error:
        raise StorageError(f"the database {path} cannot be made its owner's alone: {error.strerror}") from error


def _server_engine(url: str) -> Engine:
    # Whatever the server's default is: what is read after a lock was waited for must be what its last holder committed.
    engine = create_engine(
        url,
        pool_pre_ping=True,
        pool_size=CONNECTIONS,
        json_deserializer=document_of,
        isolation_level="READ COMMITTED",
    )

    @event.listens_for(engine, "connect")
    def _configure(connection: Any, _record: Any) -> None:  # noqa: ANN401 - the driver's own connection
        connection.execute(_SESSION)
        connection.commit()

    return engine
