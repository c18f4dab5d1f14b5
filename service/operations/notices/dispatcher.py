"""Send each notice to all receivers, in order and with retries: nothing is lost while one is down.

Of several services on one database one at a time tells a receiver. It holds the receiver by a lease: when it is gone
another goes on, with the notice that it may have told already, under the same id.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial

from service.clock import now
from service.errors import BusyError, StorageError
from service.jobs import Repeatedly, close_all
from service.observability import Metrics
from service.operations.notices.senders import NotTakenError, Sender
from service.store import notices
from service.store.database import Database
from service.store.service_order import lease_owner
from service.store.tables import DeadLetterRow, NoticeRow, ReceiverRow

log = logging.getLogger(__name__)

#: So often each receiver looks whether there is something for it.
POLL_S = 0.5
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 300.0
#: A notice that was not taken for so long becomes a dead letter, one that is refused for good after so many tries.
GIVEN_UP_AFTER = timedelta(days=3)
_TRIES_OF_REFUSED = 3
#: Longer than receivers take to answer; who takes longer may be told once more, under the same id.
LEASE = timedelta(seconds=60)


@dataclass(frozen=True, slots=True)
class Standing:
    """How far a receiver has been told, how much waits for it, and what it never got."""

    row: ReceiverRow
    n_waiting: int
    dead_letters: list[DeadLetterRow]

    @property
    def failing_since(self) -> datetime | None:
        """Since when it takes nothing: a notice that was given up does not make it well, one that it takes does."""
        told = self.row.last_told_at
        given_up = [letter.at for letter in self.dead_letters if told is None or letter.at > told]
        return min((*given_up, *filter(None, [self.row.failing_since])), default=None)


class Dispatcher:
    """Runs one thread for each receiver: one that is slow or down keeps no other waiting."""

    def __init__(self, database: Database, senders: Sequence[Sender], metrics: Metrics) -> None:
        self._database = database
        self._senders = senders
        self._metrics = metrics
        self._owner = lease_owner()
        self._telling = [
            Repeatedly(
                f"receiver-{sender.name}",
                partial(self.tell_next, sender),
                every_s=POLL_S,
                waits=f"receiver {sender.name}",
            )
            for sender in senders
        ]

    def start(self) -> None:
        """Start sending; a new receiver gets what comes from now on."""
        for sender in self._senders:
            with self._database.write() as session:
                notices.receiver(session, sender.name, now())
        for telling in self._telling:
            telling.start()

    def stop(self) -> None:
        """Begin to send nothing more."""
        for telling in self._telling:
            telling.stop()

    def close(self, within_s: float) -> None:
        """Stop sending; what was not taken so soon is sent after the next start, or once more under the same id."""
        close_all(self._telling, within_s)
        try:
            with self._database.write() as session:
                for sender in self._senders:
                    if (own := notices.own_receiver(session, sender.name, self._owner)) is not None:
                        own.owner = own.lease_until = None
        except (BusyError, StorageError) as error:
            log.warning("another service tells the receivers when the leases of this one have run out: %s", error)

    def standings(self) -> list[Standing]:
        """Return how it stands with each receiver that is set up."""
        with self._database.read() as session:
            rows = [notices.receiver(session, sender.name, now()) for sender in self._senders]
            return [
                Standing(row, notices.count_waiting(session, row.told_until), notices.dead_letters(session, row.name))
                for row in rows
            ]

    def tell_next(self, sender: Sender) -> bool:
        """Send a receiver its next notice if it is time and no other service does; return whether it took it."""
        at = now()
        with self._database.read() as session:
            row = notices.receiver(session, sender.name, at)
            if row.next_try_at > at or notices.next_notice(session, row.told_until) is None:
                return False
        with self._database.write() as session:
            taken = notices.take_receiver(session, sender.name, self._owner, LEASE)
            if taken is None or taken.next_try_at > at:
                return False
            notice = notices.next_notice(session, taken.told_until)
        if notice is None:
            return False
        try:
            sender.send(notice)
        except NotTakenError as error:
            self._note_failure(sender.name, notice, at, error)
            return False
        with self._database.write() as session:
            own = notices.own_receiver(session, sender.name, self._owner)
            if own is None:
                log.warning("receiver %s took notice %d, and another service tells it on", sender.name, notice.id)
                return False
            _move_on(own, notice, at)
            own.last_told_at, own.last_error = at, None
        self._metrics.notices.labels(sender.name, "taken").inc()
        return True

    def _note_failure(self, name: str, notice: NoticeRow, at: datetime, error: NotTakenError) -> None:
        with self._database.write() as session:
            row = notices.own_receiver(session, name, self._owner)
            if row is None:
                return
            row.n_tries += 1
            row.failing_since = row.failing_since or at
            row.last_error = str(error)[:500]
            pause_s = min(FIRST_PAUSE_S * 2.0 ** (row.n_tries - 1), LONGEST_PAUSE_S)
            row.next_try_at = at + timedelta(seconds=pause_s)
            given_up = at - row.failing_since >= GIVEN_UP_AFTER or (error.for_good and row.n_tries >= _TRIES_OF_REFUSED)
            if given_up:
                session.add(DeadLetterRow(receiver=name, notice_id=notice.id, at=at, error=str(error)[:500]))
                _move_on(row, notice, at)
        self._metrics.notices.labels(name, "given up" if given_up else "not taken").inc()
        log.warning("receiver %s did not take notice %d: %s", name, notice.id, error)


def _move_on(row: ReceiverRow, notice: NoticeRow, at: datetime) -> None:
    row.told_until, row.n_tries, row.failing_since, row.next_try_at = notice.id, 0, None, at
