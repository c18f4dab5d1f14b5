"""List, acknowledge, comment on, shelve and clear alarms."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from monitor_core.recordings.elements.units import metres
from service.clock import now
from service.documents.change import NotExamined, not_examined, read_cause
from service.documents.measurement import read_evidence
from service.errors import ConflictError, InvalidRequestError
from service.jobs import Repeatedly
from service.json_types import JsonObject
from service.operations.monitoring.alarm_changes import (
    bring_back,
    change_alarm,
    comment_on_alarm,
    is_shelved,
    shelve_alarm,
)
from service.operations.monitoring.intake.epochs import begin_by_inspection
from service.operations.monitoring.lost_motion import learn_anew
from service.store import alarms, jobs
from service.store.axes import get_axis
from service.store.database import Database
from service.store.measurements import newest_monitored
from service.store.tables import AlarmEventRow, AlarmRow, MeasurementRow

#: How often it is looked whether a shelf has ended.
LOOKED_EVERY_S: Final = 2.0
#: What is shelved for longer is forgotten: it is looked at anew by then.
LONGEST_SHELF: Final = timedelta(days=92)
#: Of the jobs that find which change of an axis explains its alarm.
EXPLANATION: Final = "alarm-explanation"
#: So many named the causes of the tests; older ones may be of a smaller change.
MOST_RECENT: Final = 8


@dataclass(frozen=True, slots=True)
class AlarmView:
    """An alarm with its history."""

    row: AlarmRow
    events: list[AlarmEventRow]
    explanation: JsonObject  # what is known of its cause now

    def last_to(self, status: str) -> AlarmEventRow | None:
        """Return the last event that brought the alarm into a status."""
        came = (event for event in reversed(self.events) if event.new_status == status and event.kind is None)
        return next((event for event in came if event.old_status != status), None)

    @property
    def shelved_until(self) -> datetime | None:
        """Until when it rests; None if it does not."""
        return self.row.shelved_until if is_shelved(self.row) else None

    @property
    def last_by_people(self) -> int:
        """Number of the newest event that somebody caused; 0 if nobody did anything yet."""
        return max((event.id for event in self.events if event.who is not None), default=0)


class Alarms:
    """List and handle alarms."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def list(self, axis_id: str | None, status: str | None, before_id: int | None, limit: int) -> list[AlarmView]:
        """Return alarms, newest first."""
        with self._database.read() as session:
            rows = alarms.list_alarms(session, axis_id=axis_id, status=status, before_id=before_id, limit=limit)
            return _views(session, rows)

    def open_by_axis(self) -> dict[str, AlarmView]:
        """Return the newest open alarm of each axis that has any."""
        with self._database.read() as session:
            newest = {row.axis_id: row for row in reversed(alarms.list_open(session))}
            events = alarms.events_of(session, [row.id for row in newest.values()])
            return {axis_id: AlarmView(row, events[row.id], row.explanation) for axis_id, row in newest.items()}

    def get(self, alarm_id: int) -> AlarmView:
        """Return one alarm."""
        with self._database.read() as session:
            return _views(session, [alarms.get_alarm(session, alarm_id)])[0]

    def standing(self, begin: int, most: int) -> tuple[Sequence[AlarmView], int, int]:
        """Return so many open alarms from a place on, how many there are, and how many of them wait for somebody.

        Active ones come first, then those that were seen, then those that rest; newest first within each.
        """
        order = {alarms.ACTIVE: 0, alarms.ACKNOWLEDGED: 1}
        with self._database.read() as session:
            rows = sorted(alarms.list_open(session), key=lambda row: (is_shelved(row), order[row.status]))
            n_waiting = sum(row.status == alarms.ACTIVE and not is_shelved(row) for row in rows)
            return _views(session, rows[begin : begin + most]), len(rows), n_waiting

    def acknowledge(self, alarm_id: int, comment: str, who: str, *, seen: int | None = None) -> AlarmView:
        """Note that somebody has seen the alarm.

        ``seen`` is the newest event of people that the caller knows of: a later one is a conflict.
        """
        with self._changing(alarm_id, seen) as (session, row):
            if row.status != alarms.ACTIVE:
                raise ConflictError(f"only an active alarm can be acknowledged; alarm {alarm_id} is {row.status}")
            change_alarm(session, row, alarms.ACKNOWLEDGED, comment, who)
        return self.get(alarm_id)

    def comment(self, alarm_id: int, comment: str, who: str) -> AlarmView:
        """Keep what somebody says of an alarm, open or not."""
        with self._changing(alarm_id, None) as (session, row):
            comment_on_alarm(session, row, comment, who)
        return self.get(alarm_id)

    def shelve(self, alarm_id: int, until: datetime, comment: str, who: str, *, seen: int | None = None) -> AlarmView:
        """Shelve an open alarm until a moment: receivers hear nothing of it until then.

        ``seen`` as of :meth:`acknowledge`. Raises InvalidRequestError if the moment is past or too far away.
        """
        if not timedelta(0) < until - now() <= LONGEST_SHELF:
            raise InvalidRequestError(
                f"an alarm is shelved until a moment within the next {LONGEST_SHELF.days} days; got {until.isoformat()}"
            )
        with self._changing(alarm_id, seen) as (session, row):
            if row.status not in alarms.OPEN:
                raise ConflictError(f"only an open alarm can be shelved; alarm {alarm_id} is {row.status}")
            shelve_alarm(session, row, until, comment, who)
        return self.get(alarm_id)

    def clear(self, alarm_id: int, comment: str, who: str, *, seen: int | None = None) -> AlarmView:
        """Close an alarm; its axis has been looked at, so a new baseline is learnt.

        Not where one is learnt already, since the charts began anew after the alarm. ``seen`` as of
        :meth:`acknowledge`.
        """
        with self._changing(alarm_id, seen) as (session, row):
            if row.status not in alarms.OPEN:
                raise ConflictError(f"alarm {alarm_id} is {row.status} already")
            change_alarm(session, row, alarms.CLEARED, comment, who)
            session.flush()
            if row.kind == alarms.LOST_MOTION:
                learn_anew(session.connection(), row.axis_id, row.epoch)
            elif row.epoch in (alarms.OF_OLDER_CHARTS, get_axis(session, row.axis_id).epoch):
                begin_by_inspection(session.connection(), row.axis_id)
        return self.get(alarm_id)

    @contextmanager
    def _changing(self, alarm_id: int, seen: int | None) -> Iterator[tuple[Session, AlarmRow]]:
        """Open a transaction on an alarm; ConflictError if somebody changed it since the caller looked."""
        with self._database.write(self.get(alarm_id).row.axis_id) as session:
            row = alarms.get_alarm(session, alarm_id)
            if seen is not None:
                events = alarms.events_of(session, [alarm_id])[alarm_id]
                newer = [event for event in events if event.who is not None and event.kind != "comment"]
                if newer and newer[-1].id > seen:
                    last = newer[-1]
                    raise ConflictError(
                        f"alarm {alarm_id} was changed meanwhile: {last.who}, {last.kind or last.new_status}, "
                        f"“{last.reason}”; look at it again first"
                    )
            yield session, row


def _views(session: Session, rows: Sequence[AlarmRow]) -> list[AlarmView]:
    events = alarms.events_of(session, [row.id for row in rows])
    return [AlarmView(row, events[row.id], explanation_now(session, row)) for row in rows]


def explanation_now(session: Session, row: AlarmRow) -> JsonObject:
    """Return what is known of the cause of an alarm: where it was not examined, why not as things stand now."""
    cause = read_cause(row.explanation)
    if cause.examined or cause.reason in (NotExamined.REFUSED, NotExamined.LOST_MOTION):
        return row.explanation
    if row.status not in alarms.OPEN:
        waited = cause.reason in (NotExamined.NOT_YET, NotExamined.TOO_FEW_POSITIONS)
        return not_examined(NotExamined.CLOSED) if waited else row.explanation
    if read_evidence(row.evidence).baseline_started_at is None:
        return not_examined(NotExamined.NO_BASELINE)
    if get_axis(session, row.axis_id).configuration.get("drive_model") is None:
        return not_examined(NotExamined.NO_DRIVE_MODEL)
    return _not_examined_with_model(session, row)


def _not_examined_with_model(session: Session, row: AlarmRow) -> JsonObject:
    job = jobs.newest_job(session, row.axis_id, EXPLANATION)
    status = None if job is None or job.arguments.get("alarm") != row.id else job.status
    if status in (jobs.QUEUED, jobs.RUNNING):
        return not_examined(NotExamined.UNDER_WAY)
    n_positions = count_positions(recent_side(session, row))
    if n_positions < fewest_positions():
        return not_examined(NotExamined.TOO_FEW_POSITIONS, n_positions)
    return not_examined(NotExamined.FAILED if status == jobs.FAILED else NotExamined.NOT_YET)


def recent_side(session: Session, row: AlarmRow) -> list[MeasurementRow]:
    """Return the newest measurements since the onset of an alarm, in time order."""
    return newest_monitored(session, row.axis_id, read_evidence(row.evidence).onset, None, MOST_RECENT)


def count_positions(rows: Sequence[MeasurementRow]) -> int:
    """Count the positions of measurements, those that are the same but for scatter once."""
    from monitor_core.change import positions_of  # noqa: PLC0415  # few axes ever alarm

    return positions_of(np.array([metres(row.position_mm) for row in rows])).size if rows else 0


def fewest_positions() -> int:
    """Return how many positions tell the causes of an alarm from each other."""
    from monitor_core.change import FEWEST_POSITIONS  # noqa: PLC0415  # as above

    return FEWEST_POSITIONS


def watch_of_shelves(database: Database) -> Repeatedly:
    """Return what brings alarms back as long as the service runs, first those whose shelf ended while none ran."""
    end = partial(bring_back_ended, database)
    return Repeatedly("shelves", end, every_s=LOOKED_EVERY_S, waits="an alarm whose shelf has ended")


def bring_back_ended(database: Database) -> int:
    """Bring back every alarm whose shelf has ended, and return how many; of several services, one brings it back."""
    with database.read() as session:
        if not alarms.has_ended_shelves(session, now()):
            return 0
    with database.write() as session:
        ended = alarms.take_ended_shelves(session, now())
        for row in ended:
            bring_back(session, row)
    return len(ended)
