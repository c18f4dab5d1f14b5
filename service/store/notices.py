"""Keep notices for receivers outside, and how far each receiver has been told."""

from datetime import datetime, timedelta

from sqlalchemy import func, select, text
from sqlalchemy.orm import Session

from service.json_types import JsonObject
from service.store.service_order import database_time, is_shared
from service.store.tables import DeadLetterRow, NoticeRow, ReceiverRow


def add_notice(session: Session, at: datetime, kind: str, subject: str, content: JsonObject) -> None:
    """Keep a notice, in the transaction of what it tells of."""
    if is_shared(session.connection()):
        # Their numbers must become visible in their order, or a receiver would pass one over: one writer at a time.
        session.execute(text("LOCK TABLE notices IN SHARE ROW EXCLUSIVE MODE"))
    session.add(NoticeRow(at=at, kind=kind, subject=subject, content=content))
    session.flush()


def receiver(session: Session, name: str, at: datetime) -> ReceiverRow:
    """Return how far a receiver has been told; a new one is told of what comes from now on."""
    row = session.get(ReceiverRow, name)
    if row is None and is_shared(session.connection()):  # services that start together must not both add it
        session.execute(text("LOCK TABLE receivers IN SHARE ROW EXCLUSIVE MODE"))
        row = session.get(ReceiverRow, name)
    if row is None:
        newest = session.scalar(select(func.max(NoticeRow.id))) or 0
        row = ReceiverRow(
            name=name, told_until=newest, n_tries=0, failing_since=None, next_try_at=at, last_error=None,
            last_told_at=None, owner=None, lease_until=None,
        )  # fmt: skip
        session.add(row)
        session.flush()
    return row


def take_receiver(session: Session, name: str, owner: str, lease: timedelta) -> ReceiverRow | None:
    """Give a receiver to an owner, who alone tells it something until the lease ends; None if another one does."""
    query = select(ReceiverRow).where(ReceiverRow.name == name).with_for_update(skip_locked=True)
    row = session.scalar(query)
    if row is None:
        return None
    at = database_time(session)
    if row.lease_until is not None and row.lease_until > at and row.owner != owner:
        return None
    row.owner, row.lease_until = owner, at + lease
    return row


def own_receiver(session: Session, name: str, owner: str) -> ReceiverRow | None:
    """Return a receiver, which nobody else changes until the transaction ends; None if another one has it now."""
    query = select(ReceiverRow).where(ReceiverRow.name == name, ReceiverRow.owner == owner).with_for_update()
    return session.scalar(query)


def next_notice(session: Session, after: int) -> NoticeRow | None:
    """Return the first notice after another; None if there is none yet."""
    return session.scalar(select(NoticeRow).where(NoticeRow.id > after).order_by(NoticeRow.id).limit(1))


def count_waiting(session: Session, after: int) -> int:
    """Count the notices after another."""
    return int(session.scalar(select(func.count()).select_from(NoticeRow).where(NoticeRow.id > after)) or 0)


def dead_letters(session: Session, name: str) -> list[DeadLetterRow]:
    """Return what a receiver never got, oldest first."""
    return list(session.scalars(select(DeadLetterRow).where(DeadLetterRow.receiver == name).order_by(DeadLetterRow.id)))
