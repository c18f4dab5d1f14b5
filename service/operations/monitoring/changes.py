"""Tell whether anything that a page shows may have changed: a commit, a new silence, a shelved alarm that is back."""

import uuid
from bisect import bisect_right
from dataclasses import dataclass
from datetime import datetime, timedelta

from service.clock import now
from service.store import alarms, axes
from service.store.database import Database


@dataclass(frozen=True, slots=True)
class _Known:
    revision: str
    turns: list[datetime]  # when an axis falls silent, or an alarm comes back that was shelved, in order


class Changes:
    """Gives each state of the stored data a mark. While nothing is written, no table is read for it."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._start = uuid.uuid4().hex[:8]  # marks of an earlier run of the service are not those of this one
        self._known: _Known | None = None

    def mark(self) -> str:
        """Return the mark of what is stored now."""
        revision, turns_at = self._database.revision(), self._known
        if turns_at is None or turns_at.revision != revision:
            turns_at = self._known = _Known(revision, self._turns())
        return f"{self._start}-{revision}-{bisect_right(turns_at.turns, now())}".replace(":", ".").replace(",", ".")

    def _turns(self) -> list[datetime]:
        with self._database.read() as session:
            silent_from = [last_at + timedelta(hours=hours) for last_at, hours in axes.silences(session)]
            return sorted([*silent_from, *alarms.ends_of_shelves(session)])
