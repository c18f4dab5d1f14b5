"""Enter what happened long ago as of then, for a history that is made whole afterwards."""

from collections.abc import Mapping
from datetime import datetime

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from service.store.tables import ActivationRow, AlarmEventRow, AlarmRow, CalibrationRow


def date_calibrations(session: Session, axis_id: str, at: datetime) -> None:
    """Let the calibrations of an axis have been fitted and activated at a moment."""
    session.execute(update(CalibrationRow).where(CalibrationRow.axis_id == axis_id).values(created_at=at))
    session.execute(update(ActivationRow).where(ActivationRow.axis_id == axis_id).values(activated_at=at))


def date_alarms(session: Session, axis_id: str, done_at: Mapping[str, datetime]) -> None:
    """Let alarms of an axis have been raised when they were measured, and people have acted at moments by status."""
    for row in session.scalars(select(AlarmRow).where(AlarmRow.axis_id == axis_id)):
        row.raised_at = row.measured_at
        for event in session.scalars(select(AlarmEventRow).where(AlarmEventRow.alarm_id == row.id)):
            event.at = row.measured_at if event.who is None else done_at.get(event.new_status, event.at)
