"""Query alarms and their changes."""

from collections.abc import Mapping, Sequence
from datetime import datetime

from sqlalchemy import ColumnElement, bindparam, func, select
from sqlalchemy.orm import Session

from service.store.lookup import existing
from service.store.tables import AlarmEventRow, AlarmRow, AxisRow

ACTIVE, ACKNOWLEDGED, CLEARED = "active", "acknowledged", "cleared"
#: Raised by charts that a late measurement changed: with it they raise no alarm. Listed where it is asked for.
WITHDRAWN = "withdrawn"
OPEN = (ACTIVE, ACKNOWLEDGED)
#: What the charts of the preload find, and those of several numbers that are watched together.
PRELOAD_LOSS, SEVERAL_NUMBERS = "preload-loss", "several-numbers"
#: What the chart of lost motion finds: its alarms are of no measurement of windows, and of no fold of the other charts.
LOST_MOTION = "lost-motion"
#: Epoch of alarms that the charts of this version of the program do not raise: no fold comes to it.
OF_OLDER_CHARTS = -1
_N_OPEN = select(func.count()).where(AlarmRow.axis_id == bindparam("axis_id"), AlarmRow.status.in_(OPEN))
_ARCHIVED = select(AxisRow.id).where(AxisRow.archived_at.is_not(None))


def get_alarm(session: Session, alarm_id: int) -> AlarmRow:
    """Return one alarm or say that there is none."""
    return existing(session.get(AlarmRow, alarm_id), f"alarm {alarm_id}")


def list_alarms(
    session: Session, *, axis_id: str | None, status: str | None, before_id: int | None, limit: int,
    by_measurements: bool = False,
) -> list[AlarmRow]:  # fmt: skip
    """Return alarms, newest first; those of an archived axis only where it is asked for.

    ``by_measurements``: without those of lost motion, that no measurement of windows raises.
    """
    query = select(AlarmRow)
    if by_measurements:
        query = query.where(AlarmRow.kind != LOST_MOTION)
    if axis_id is not None:
        query = query.where(AlarmRow.axis_id == axis_id)
    else:
        query = query.where(AlarmRow.axis_id.not_in(_ARCHIVED))
    query = query.where(AlarmRow.status != WITHDRAWN if status is None else AlarmRow.status == status)
    if before_id is not None:
        query = query.where(AlarmRow.id < before_id)
    return list(session.scalars(query.order_by(AlarmRow.id.desc()).limit(limit)))


def count_open(session: Session, axis_id: str) -> int:
    """Count the alarms of an axis that are not cleared."""
    return int(session.scalar(_N_OPEN, {"axis_id": axis_id}) or 0)


def list_open(session: Session) -> list[AlarmRow]:
    """Return the alarms of axes at work that are not cleared, newest first."""
    query = select(AlarmRow).where(AlarmRow.status.in_(OPEN), AlarmRow.axis_id.not_in(_ARCHIVED))
    return list(session.scalars(query.order_by(AlarmRow.id.desc())))


def ends_of_shelves(session: Session) -> list[datetime]:
    """Return until when open alarms are shelved, or were."""
    query = select(AlarmRow.shelved_until).where(AlarmRow.status.in_(OPEN), AlarmRow.shelved_until.is_not(None))
    return [until for until in session.scalars(query) if until is not None]


def has_ended_shelves(session: Session, moment: datetime) -> bool:
    """Tell whether the shelf of an open alarm ended until a moment."""
    return session.scalar(select(AlarmRow.id).where(*_shelved_until(moment)).limit(1)) is not None


def take_ended_shelves(session: Session, moment: datetime) -> list[AlarmRow]:
    """Return the open alarms whose shelf ended until a moment, without those that another service has taken."""
    query = select(AlarmRow).where(*_shelved_until(moment)).order_by(AlarmRow.id)
    return list(session.scalars(query.with_for_update(skip_locked=True)))


def _shelved_until(moment: datetime) -> tuple[ColumnElement[bool], ...]:
    return AlarmRow.status.in_(OPEN), AlarmRow.shelved_until <= moment


def open_by_axis(session: Session) -> dict[str, int]:
    """Count the open alarms of every axis that has any."""
    query = (
        select(AlarmRow.axis_id, func.count().label("open")).where(AlarmRow.status.in_(OPEN)).group_by(AlarmRow.axis_id)
    )
    return {row.axis_id: row.open for row in session.execute(query)}


def of_lost_motion(session: Session, axis_id: str) -> list[AlarmRow]:
    """Return the alarms of the lost motion of an axis in order, without those that were withdrawn."""
    of_axis = (AlarmRow.axis_id == axis_id, AlarmRow.status != WITHDRAWN, AlarmRow.kind == LOST_MOTION)
    return list(session.scalars(select(AlarmRow).where(*of_axis).order_by(AlarmRow.measured_at, AlarmRow.id)))


def raised_after(session: Session, axis_id: str, epoch: int, after: datetime | None) -> list[AlarmRow]:
    """Return the alarms by measurements later than a moment, of an epoch of the charts and those after it, in order."""
    of_axis = (AlarmRow.axis_id == axis_id, AlarmRow.status != WITHDRAWN, AlarmRow.kind != LOST_MOTION)
    query = select(AlarmRow).where(*of_axis, AlarmRow.epoch >= epoch)
    if after is not None:
        query = query.where(AlarmRow.measured_at > after)
    return list(session.scalars(query.order_by(AlarmRow.measured_at, AlarmRow.id)))


def newest_in_epoch(session: Session, axis_id: str, epoch: int) -> AlarmRow | None:
    """Return the newest alarm by measurements of an epoch of the charts, if it is open."""
    of_epoch = (AlarmRow.axis_id == axis_id, AlarmRow.epoch == epoch, AlarmRow.kind != LOST_MOTION)
    newest = select(AlarmRow).where(*of_epoch, AlarmRow.status != WITHDRAWN)
    row = session.scalars(newest.order_by(AlarmRow.measured_at.desc(), AlarmRow.id.desc()).limit(1)).first()
    return row if row is not None and row.status in OPEN else None


def events_of(session: Session, alarm_ids: Sequence[int]) -> dict[int, list[AlarmEventRow]]:
    """Return the changes of alarms by alarm, oldest first."""
    query = select(AlarmEventRow).where(AlarmEventRow.alarm_id.in_(alarm_ids)).order_by(AlarmEventRow.id)
    events: dict[int, list[AlarmEventRow]] = {alarm_id: [] for alarm_id in alarm_ids}
    for event in session.scalars(query) if alarm_ids else ():
        events[event.alarm_id].append(event)
    return events


def date_back(session: Session, axis_id: str, done_at: Mapping[str, datetime]) -> None:
    """Let alarms of an axis have been raised when they were measured, and people have acted at moments by status."""
    for row in session.scalars(select(AlarmRow).where(AlarmRow.axis_id == axis_id)):
        row.raised_at = row.measured_at
        for event in session.scalars(select(AlarmEventRow).where(AlarmEventRow.alarm_id == row.id)):
            event.at = row.measured_at if event.who is None else done_at.get(event.new_status, event.at)
