"""Alarms: raised by a measurement, acknowledged and cleared by people; every change is kept."""

from dataclasses import dataclass
from itertools import zip_longest

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.preload import Calibration
from service.clock import now
from service.documents.change import not_examined_yet, read_cause
from service.documents.measurement import alarm_evidence
from service.errors import ConflictError
from service.json_types import JsonObject
from service.operations.monitoring.intake.chart_state import begin_again
from service.operations.monitoring.intake.charts import Folded
from service.operations.monitoring.intake.known import Lanes
from service.operations.notices.alarm_notice import alarm_notice, kind_of
from service.store import alarms
from service.store.axes import get_axis
from service.store.database import Database
from service.store.intake import AxisRecord
from service.store.notices import add_notice
from service.store.tables import AlarmEventRow, AlarmRow
from service.store.trend.points import TrendPoint

#: What the charts find.
PRELOAD_LOSS = "preload-loss"

#: What fits into a row of the history.
LONGEST_REASON = 1000


@dataclass(frozen=True, slots=True)
class AlarmView:
    """An alarm with its history."""

    row: AlarmRow
    events: list[AlarmEventRow]

    def last_to(self, status: str) -> AlarmEventRow | None:
        """Return the last event that brought the alarm into a status."""
        return next((event for event in reversed(self.events) if event.new_status == status), None)


def settle_alarms(
    connection: Connection,
    axis: AxisRecord,
    folded: Folded,
    calibration: Calibration,
) -> int:
    """Store the alarms of charts that were folded from a moment on, and return how many are new.

    Alarms that they raised before, from there on, are the same ones in order, if with other evidence; one that is not
    raised any more is withdrawn.
    """
    with Session(connection) as session:
        epoch = folded.charts.epoch
        before = alarms.raised_after(session, axis.id, epoch, folded.again_after) if folded.again else []
        for row, found in zip_longest(before, folded.raised):
            if found is None:
                _change(session, row, alarms.WITHDRAWN, "with a measurement that arrived late the charts raise none")
                continue
            evidence = alarm_evidence(found.point, found.state, calibration)
            if row is None:
                _raise(session, axis, epoch, found.point, evidence)
            elif row.evidence != evidence:
                row.evidence, row.measurement_id, row.measured_at = evidence, found.point.measurement_id, found.point.at
                _change(session, row, row.status, "a measurement that arrived late changed the evidence")
        session.commit()  # hands it to the connection
    return max(len(folded.raised) - len(before), 0)


def _raise(session: Session, axis: AxisRecord, epoch: int, point: TrendPoint, evidence: JsonObject) -> None:
    at = now()
    row = AlarmRow(
        axis_id=axis.id, measurement_id=point.measurement_id, kind=PRELOAD_LOSS, raised_at=at, epoch=epoch,
        measured_at=point.at, status=alarms.ACTIVE, evidence=evidence, explanation=not_examined_yet(axis.configuration),
    )  # fmt: skip
    session.add(row)
    session.flush()
    raised = "raised by measurement"
    _tell(session, row, AlarmEventRow(alarm_id=row.id, at=at, old_status=None, new_status=alarms.ACTIVE, reason=raised))


def store_explanation(session: Session, row: AlarmRow, explanation: JsonObject) -> None:
    """Keep the latest answer with the alarm, and each answer of another sentence in its history."""
    cause = read_cause(explanation)
    before, row.explanation = read_cause(row.explanation), explanation
    if cause.sentence != before.sentence:
        answer = f"explained: {cause.sentence}" if cause.examined else cause.sentence
        _change(session, row, row.status, answer[:LONGEST_REASON])


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
            _change(session, row, alarms.ACKNOWLEDGED, comment, who)
        return self.get(alarm_id)

    def clear(self, alarm_id: int, comment: str, who: str) -> AlarmView:
        """Close an alarm; its axis has been looked at, so a new baseline is learnt."""
        axis_id = self.get(alarm_id).row.axis_id
        with self._lanes.of(axis_id), self._database.write(axis_id) as session:
            row = alarms.get_alarm(session, alarm_id)
            if row.status not in alarms.OPEN:
                raise ConflictError(f"alarm {alarm_id} is {row.status} already")
            _change(session, row, alarms.CLEARED, comment, who)
            begin_again(session, get_axis(session, axis_id))
        return self.get(alarm_id)


def _change(session: Session, row: AlarmRow, status: str, reason: str, who: str | None = None) -> None:
    event = AlarmEventRow(alarm_id=row.id, at=now(), old_status=row.status, new_status=status, reason=reason, who=who)
    row.status = status
    _tell(session, row, event)


def _tell(session: Session, row: AlarmRow, event: AlarmEventRow) -> None:
    """Keep an event of an alarm, and with it what receivers outside are told."""
    session.add(event)
    add_notice(session, event.at, kind_of(event), f"axes/{row.axis_id}", alarm_notice(row, event))
