"""Keep notices for receivers outside, and how far each receiver has been told."""

from datetime import datetime

from sqlalchemy import func, select, text
from sqlalchemy.orm import Session

from service.json_types import JsonObject
from service.store.tables import DeadLetterRow, NoticeRow, ReceiverRow


def add_notice(session: Session, at: datetime, kind: str, subject: str, content: JsonObject) -> None:
    """Keep a notice, in the transaction of what it tells of."""
    if session.get_bind().dialect.name == "postgresql":
        # Their numbers must become visible in their order, or a receiver would pass one over: one writer at a time.
        session.execute(text("LOCK TABLE notices IN SHARE ROW EXCLUSIVE MODE"))
    session.add(NoticeRow(at=at, kind=kind, subject=subject, content=content))
    session.flush()


def receiver(session: Session, name: str, at: datetime) -> ReceiverRow:
    """Return how far a receiver has been told; a new one is told of what comes from now on."""
    row = session.get(ReceiverRow, name)
    if row is None:
        newest = session.scalar(select(func.max(NoticeRow.id))) or 0
        row = ReceiverRow(
            name=name, told_until=newest, n_tries=0, failing_since=None, next_try_at=at, last_error=None,
            last_told_at=None,
        )  # fmt: skip
        session.add(row)
        session.flush()
    return row


def next_notice(session: Session, after: int) -> NoticeRow | None:
    """Return the first notice after another; None if there is none yet."""
    return session.scalar(select(NoticeRow).where(NoticeRow.id > after).order_by(NoticeRow.id).limit(1))


def count_waiting(session: Session, after: int) -> int:
    """Count the notices after another."""
    return int(session.scalar(select(func.count()).select_from(NoticeRow).where(NoticeRow.id > after)) or 0)


def dead_letters(session: Session, name: str) -> list[DeadLetterRow]:
    """Return what a receiver never got, oldest first."""
    return list(session.scalars(select(DeadLetterRow).where(DeadLetterRow.receiver == name).order_by(DeadLetterRow.id)))
