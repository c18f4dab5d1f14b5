"""Alarms: raised by a measurement, acknowledged and cleared by people; every change is kept."""

from dataclasses import dataclass

from service.errors import ConflictError
from service.operations.monitoring.alarm_changes import change_alarm
from service.operations.monitoring.intake.epochs import begin_by_inspection
from service.operations.monitoring.intake.known import Lanes
from service.store import alarms
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import AlarmEventRow, AlarmRow


@dataclass(frozen=True, slots=True)
class AlarmView:
    """An alarm with its history."""

    row: AlarmRow
    events: list[AlarmEventRow]

    def last_to(self, status: str) -> AlarmEventRow | None:
        """Return the last event that brought the alarm into a status."""
        return next((event for event in reversed(self.events) if event.new_status == status), None)


class Alarms:
    """List and handle alarms."""

    def __init__(self, database: Database, lanes: Lanes) -> None:
        self._database = database
        self._lanes = lanes

    def list(self, axis_id: str | None, status: str | None, before_id: int | None, limit: int) -> list[AlarmView]:
        """Return alarms, newest first."""
        with self._database.read() as session:
            rows = alarms.list_alarms(session, axis_id=axis_id, status=status, before_id=before_id, limit=limit)
            events = alarms.events_of(session, [row.id for row in rows])
            return [AlarmView(row, events[row.id]) for row in rows]

    def open_by_axis(self) -> dict[str, AlarmView]:
        """Return the newest open alarm of each axis that has any."""
        with self._database.read() as session:
            newest = {row.axis_id: row for row in reversed(alarms.list_open(session))}
            events = alarms.events_of(session, [row.id for row in newest.values()])
            return {axis_id: AlarmView(row, events[row.id]) for axis_id, row in newest.items()}

    def get(self, alarm_id: int) -> AlarmView:
        """Return one alarm."""
        with self._database.read() as session:
            return AlarmView(alarms.get_alarm(session, alarm_id), alarms.events_of(session, [alarm_id])[alarm_id])

    def acknowledge(self, alarm_id: int, comment: str, who: str) -> AlarmView:
        """Note that somebody has seen the alarm."""
        with self._database.write(self.get(alarm_id).row.axis_id) as session:
            row = alarms.get_alarm(session, alarm_id)
            if row.status != alarms.ACTIVE:
                raise ConflictError(f"only an active alarm can be acknowledged; alarm {alarm_id} is {row.status}")
            change_alarm(session, row, alarms.ACKNOWLEDGED, comment, who)
        return self.get(alarm_id)

    def clear(self, alarm_id: int, comment: str, who: str) -> AlarmView:
        """Close an alarm; its axis has been looked at, so a new baseline is learnt.

        Not where one is learnt already, since the charts began anew after the alarm.
        """
        axis_id = self.get(alarm_id).row.axis_id
        with self._lanes.of(axis_id), self._database.write(axis_id) as session:
            row = alarms.get_alarm(session, alarm_id)
            if row.status not in alarms.OPEN:
                raise ConflictError(f"alarm {alarm_id} is {row.status} already")
            change_alarm(session, row, alarms.CLEARED, comment, who)
            session.flush()
            if row.epoch == get_axis(session, axis_id).epoch:
                begin_by_inspection(session.connection(), axis_id)
        return self.get(alarm_id)
