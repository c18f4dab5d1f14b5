"""Keep refused requests in the log of changes: an entry an hour for each address and caller, and a bounded number."""

import logging
import threading
from dataclasses import dataclass
from datetime import datetime, timedelta

from service.clock import now, text_of
from service.documents.printable import printable
from service.errors import ServiceError
from service.jobs import Repeatedly
from service.operations.access.throttle import host_of
from service.store.access import drop_refusals
from service.store.database import Database
from service.store.tables import AuditRow

log = logging.getLogger(__name__)

#: What is refused is counted in memory, and written so often: a write lets every open page look for changes.
WRITTEN_EVERY_S = 10.0
#: An entry counts what is refused for so long.
COUNTED_FOR = timedelta(hours=1)
#: Further addresses and callers of that time share an entry for each status.
MOST_ENTRIES = 500
#: So many entries are kept of all times, the newest.
MOST_KEPT = 10_000
_MOST_OF_PATH = 300


@dataclass(frozen=True, slots=True)
class Refused:
    """One request that was refused: who asked, from which address, for what, and the status of the answer."""

    who: str
    address: str
    action: str
    path: str
    status: int


@dataclass(slots=True)
class _Entry:
    begun: Refused
    begun_at: datetime
    last_at: datetime
    n: int = 0
    n_written: int = 0
    row: int | None = None  # its number in the log, once it is written


class Refusals:
    """Counts what is refused, and writes it into the log."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()  # of what is counted
        self._writing = threading.Lock()
        self._entries: dict[tuple[str, str, int], _Entry] = {}
        self._since = now()

    def note(self, refused: Refused) -> None:
        """Count a request; this waits for no disk."""
        at, host = now(), host_of(refused.address)
        with self._lock:
            key = (host, refused.who, refused.status)
            if key not in self._entries and len(self._entries) >= MOST_ENTRIES:
                refused = Refused("others", "further addresses", "any", "any", refused.status)
                key = (refused.address, refused.who, refused.status)
            entry = self._entries.setdefault(key, _Entry(refused, at, at))
            entry.n, entry.last_at = entry.n + 1, at

    def write(self) -> None:
        """Write what was counted since the last time; what the database does not take waits for the next time."""
        with self._writing:
            with self._lock:
                counted = [(entry, entry.n) for entry in self._entries.values() if entry.n > entry.n_written]
            if not counted:
                return
            is_over = now() - self._since > COUNTED_FOR
            try:
                rows = self._store(counted, drops=is_over)
            except ServiceError as error:
                log.warning("%d entries of what was refused wait: %s", len(counted), error)
                return
            with self._lock:
                for (entry, n), row in zip(counted, rows, strict=True):
                    entry.n_written, entry.row = n, row
                if is_over:
                    self._entries = {key: each for key, each in self._entries.items() if each.n > each.n_written}
                    self._since = now()

    def writer(self) -> Repeatedly:
        """Return what writes as long as the service runs."""
        return Repeatedly("refusals", self.write, every_s=WRITTEN_EVERY_S, waits="what was refused")

    def _store(self, counted: list[tuple[_Entry, int]], *, drops: bool) -> list[int]:
        """Store counts of entries, and return the numbers of their rows."""
        with self._database.write() as session:
            rows = []
            for entry, n in counted:
                row = None if entry.row is None else session.get(AuditRow, entry.row)
                if row is None:
                    row = _row_of(entry)
                    session.add(row)
                row.target = _target_of(entry, n)
                rows.append(row)
            session.flush()
            if drops:
                drop_refusals(session, keep=MOST_KEPT)
            return [row.id for row in rows]


def _row_of(entry: _Entry) -> AuditRow:
    begun = entry.begun
    return AuditRow(
        at=entry.begun_at,
        who=f"{begun.who} from {host_of(begun.address)}"[:120],
        action=begun.action[:200],
        status=begun.status,
    )


def _target_of(entry: _Entry, n: int) -> str:
    path = printable(entry.begun.path)[:_MOST_OF_PATH]
    return path if n == 1 else f"{path} ({n} times until {text_of(entry.last_at.replace(microsecond=0))})"
