"""Rows of alarms and their changes."""

from collections.abc import Iterable

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import UnknownResourceError
from service.store.tables import AlarmEventRow, AlarmRow

ACTIVE, ACKNOWLEDGED, CLEARED = "active", "acknowledged", "cleared"


def get_alarm(session: Session, alarm_id: int) -> AlarmRow:
    """Return one alarm or say that there is none."""
    row = session.get(AlarmRow, alarm_id)
    if row is None:
        raise UnknownResourceError(f"there is no alarm {alarm_id}")
    return row


def list_alarms(
    session: Session, *, axis_id: str | None, statuses: Iterable[str] | None, before_id: int | None, limit: int
) -> list[AlarmRow]:
    """Return alarms, newest first."""
    query = select(AlarmRow)
    if axis_id is not None:
        query = query.where(AlarmRow.axis_id == axis_id)
    if statuses is not None:
        query = query.where(AlarmRow.status.in_(list(statuses)))
    if before_id is not None:
        query = query.where(AlarmRow.id < before_id)
    return list(session.scalars(query.order_by(AlarmRow.id.desc()).limit(limit)))


def open_alarms(session: Session, axis_id: str) -> list[AlarmRow]:
    """Return the alarms of an axis that are not cleared."""
    return list_alarms(session, axis_id=axis_id, statuses=(ACTIVE, ACKNOWLEDGED), before_id=None, limit=1000)


def events_of(session: Session, alarm_id: int) -> list[AlarmEventRow]:
    """Return the changes of an alarm, oldest first."""
    return list(
        session.scalars(select(AlarmEventRow).where(AlarmEventRow.alarm_id == alarm_id).order_by(AlarmEventRow.id))
    )
