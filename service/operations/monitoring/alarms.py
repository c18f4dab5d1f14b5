"""Alarms: raised by a measurement, acknowledged and cleared by people; every change is kept."""

from dataclasses import dataclass

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from service.clock import now
from service.documents.change import read_cause
from service.errors import ConflictError
from service.json_types import JsonObject
from service.operations.monitoring.lanes import Lanes
from service.operations.monitoring.monitor_state import begin_new_baseline
from service.store import alarms
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import AlarmEventRow, AlarmRow

#: What fits into a row of the history.
LONGEST_REASON = 1000


@dataclass(frozen=True, slots=True)
class AlarmView:
    """An alarm with its history."""

    row: AlarmRow
    events: list[AlarmEventRow]


def raise_alarm(
    connection: Connection,
    axis_id: str,
    measurement_id: int | None,
    kind: str,
    *,
    evidence: JsonObject,
    explanation: JsonObject,
) -> None:
    """Store a new alarm in the transaction that stores the measurement it rests on."""
    at = now()
    row = AlarmRow(
        axis_id=axis_id, measurement_id=measurement_id, kind=kind, raised_at=at, status=alarms.ACTIVE,
        evidence=evidence, explanation=explanation,
    )  # fmt: skip
    with Session(connection) as session:
        session.add(row)
        session.flush()
        raised = "raised by measurement"
        session.add(AlarmEventRow(alarm_id=row.id, at=at, old_status=None, new_status=alarms.ACTIVE, reason=raised))
        session.commit()  # hands both to the connection


def store_explanation(session: Session, row: AlarmRow, explanation: JsonObject) -> None:
    """Keep the latest answer with the alarm, and each answer of another sentence in its history."""
    cause = read_cause(explanation)
    if cause.sentence != read_cause(row.explanation).sentence:
        answer = f"explained: {cause.sentence}" if cause.examined else cause.sentence
        _change(session, row, row.status, answer[:LONGEST_REASON])
    row.explanation = explanation


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

    def get(self, alarm_id: int) -> AlarmView:
        """Return one alarm."""
        with self._database.read() as session:
            return AlarmView(alarms.get_alarm(session, alarm_id), alarms.events_of(session, [alarm_id])[alarm_id])

    def acknowledge(self, alarm_id: int, comment: str) -> AlarmView:
        """Note that somebody has seen the alarm."""
        with self._database.write() as session:
            row = alarms.get_alarm(session, alarm_id)
            if row.status != alarms.ACTIVE:
                raise ConflictError(f"only an active alarm can be acknowledged; alarm {alarm_id} is {row.status}")
            _change(session, row, alarms.ACKNOWLEDGED, comment)
        return self.get(alarm_id)

    def clear(self, alarm_id: int, comment: str) -> AlarmView:
        """Close an alarm; its axis has been looked at, so a new baseline is learnt."""
        axis_id = self.get(alarm_id).row.axis_id
        with self._lanes.of(axis_id), self._database.write() as session:
            row = alarms.get_alarm(session, alarm_id)
            if row.status == alarms.CLEARED:
                raise ConflictError(f"alarm {alarm_id} is cleared already")
            _change(session, row, alarms.CLEARED, comment)
            axis = get_axis(session, axis_id)
            axis.monitor_state = begin_new_baseline(axis.monitor_state)
        return self.get(alarm_id)


def _change(session: Session, row: AlarmRow, status: str, reason: str) -> None:
    session.add(AlarmEventRow(alarm_id=row.id, at=now(), old_status=row.status, new_status=status, reason=reason))
    row.status = status
