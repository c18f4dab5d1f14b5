"""Change alarms: each change is stored as an event, with a notice for receivers."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from datetime import datetime
from functools import partial
from itertools import zip_longest
from typing import TypeVar

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from service.clock import now, text_of
from service.documents.change import NotExamined, not_examined, read_cause
from service.documents.measurement import alarm_evidence
from service.documents.together import together_evidence
from service.json_types import JsonObject
from service.operations.monitoring.axis_configuration import load_configuration, preload_share
from service.operations.monitoring.intake.charts import Folded, Raised
from service.store import alarms
from service.store.intake import AxisRecord
from service.store.notices import add_notice
from service.store.tables import AlarmEventRow, AlarmRow

T = TypeVar("T")

#: What fits into a row of the history.
LONGEST_REASON = 1000
#: What changes alarms that were raised already, unless somebody says otherwise.
LATE = "a measurement that arrived late"
#: Why an alarm goes on as one of the other kind.
_GOES_ON_AS = {
    alarms.PRELOAD_LOSS: "the preload's own chart raises it now, too",
    alarms.SEVERAL_NUMBERS: "several numbers together raise it, the preload's own chart does not any more",
}


def settle_alarms(connection: Connection, axis: AxisRecord, folded: Folded, because_of: str = LATE) -> tuple[str, ...]:
    """Store the alarms of charts that were folded from a moment on, and return the kinds of those that are new.

    Alarms that they raised before, from there on, are the same ones in order within each epoch, if with other evidence;
    one that is not raised any more is withdrawn, unless nothing was watched that charts could raise it by.
    """
    new = list[str]()
    with Session(connection) as session:
        for epoch, row, alarm in _paired(session, axis, folded):
            if row is None and alarm is not None:
                new.append(alarm.kind)
                _raise(session, axis, epoch, alarm, "raised by measurement")
            elif row is not None and alarm is not None:
                reason = f"{because_of} changed the evidence" if row.kind == alarm.kind else _GOES_ON_AS[alarm.kind]
                row.epoch, row.kind = alarm.point.epoch, alarm.kind
                raised_by = alarm.point.measurement_id, alarm.point.at
                raise_again(session, row, raised_by, _evidence(axis, alarm), reason)
            elif row is not None and epoch in folded.watched:
                change_alarm(session, row, alarms.WITHDRAWN, f"with {because_of} the charts raise none")
        session.commit()  # hands it to the connection
    return tuple(new)


def let_alarms_stand(connection: Connection, axis: AxisRecord, folded: Folded) -> None:
    """Keep alarms as they are stored, whatever charts raise that another version of the program folded.

    Nothing was measured anew, so nobody is told anything but of an alarm that nobody knew of. One that these charts do
    not raise is none of theirs: only a person ends it.
    """
    with Session(connection) as session:
        for epoch, row, alarm in _paired(session, axis, folded):
            if row is not None and alarm is not None:
                row.epoch, row.measured_at = epoch, alarm.point.at  # so that they know it again
            elif row is not None and row.status in alarms.OPEN:
                row.epoch = alarms.OF_OLDER_CHARTS
                session.add(_event(row, "another version of the program does not raise it; it stands until cleared"))
            elif alarm is not None and row is None and epoch == folded.charts.epoch:
                _raise(session, axis, epoch, alarm, "raised by another version of the program")
        session.commit()


def _paired(session: Session, axis: AxisRecord, folded: Folded) -> Iterator[tuple[int, AlarmRow | None, Raised | None]]:
    """Return the stored alarms of what was folded beside those that the charts raise, in order within each epoch.

    What has none of its own kind is the same as one of the other: people act on one cause once.
    """
    after = folded.again_after
    earlier = alarms.raised_after(session, axis.id, folded.since_epoch, after) if folded.again else []
    stood = [(_epoch_at(folded, row.measured_at), row) for row in earlier]
    rows, left = list[tuple[int, AlarmRow]](), list[tuple[int, Raised]]()
    for kind in (alarms.PRELOAD_LOSS, alarms.SEVERAL_NUMBERS):
        raised = [(alarm.point.epoch, alarm) for alarm in folded.raised if alarm.kind == kind]
        for epoch, row, alarm in in_order([(epoch, row) for epoch, row in stood if row.kind == kind], raised):
            if row is not None and alarm is not None:
                yield epoch, row, alarm
            elif row is not None:
                rows.append((epoch, row))
            elif alarm is not None:
                left.append((epoch, alarm))
    for epoch, row, alarm in in_order(rows, left):
        stands = alarms.newest_in_epoch(session, axis.id, epoch) if alarm is not None and alarm.goes_on else None
        from_before = stands if stands is not None and stands.kind == alarms.SEVERAL_NUMBERS else None
        yield epoch, row or from_before, alarm


def in_order(
    stood: Iterable[tuple[int, AlarmRow]], raised: Iterable[tuple[int, T]]
) -> Iterator[tuple[int, AlarmRow | None, T | None]]:
    """Return stored alarms beside those that a chart raises, epoch by epoch: in order within each they are the same."""
    stored, now_raised = defaultdict[int, list[AlarmRow]](list), defaultdict[int, list[T]](list)
    for epoch, row in stood:
        stored[epoch].append(row)
    for epoch, alarm in raised:
        now_raised[epoch].append(alarm)
    for epoch in sorted({*stored, *now_raised}):
        for pair in zip_longest(stored[epoch], now_raised[epoch]):
            yield epoch, *pair


def _epoch_at(folded: Folded, moment: datetime) -> int:
    entered = [epoch for begins_at, epoch in folded.entered if begins_at <= moment]
    return entered[-1] if entered else folded.since_epoch


def _evidence(axis: AxisRecord, alarm: Raised) -> JsonObject:
    if alarm.kind == alarms.SEVERAL_NUMBERS:
        return together_evidence(alarm.point, alarm.state.joint)
    model = load_configuration(axis.configuration).drive_model
    return alarm_evidence(alarm.point, alarm.state, alarm.calibration, partial(preload_share, model))


def raise_again(
    session: Session, row: AlarmRow, raised_by: tuple[int | None, datetime], evidence: JsonObject, reason: str
) -> None:
    """Let an alarm that charts raise once more rest on what raises it now: number of its measurement, and when."""
    if row.evidence != evidence:
        row.evidence, (row.measurement_id, row.measured_at) = evidence, raised_by
        change_alarm(session, row, row.status, reason)


def _raise(session: Session, axis: AxisRecord, epoch: int, alarm: Raised, reason: str) -> None:
    point = alarm.point
    row = AlarmRow(
        axis_id=axis.id, measurement_id=point.measurement_id, kind=alarm.kind, epoch=epoch, measured_at=point.at,
        evidence=_evidence(axis, alarm),
        explanation=not_examined(NotExamined.NOT_YET),
    )  # fmt: skip
    add_alarm(session, row, reason)


def add_alarm(session: Session, row: AlarmRow, reason: str) -> None:
    """Raise an alarm now."""
    row.raised_at, row.status, row.shelved_until = now(), alarms.ACTIVE, None
    session.add(row)
    session.flush()
    event = AlarmEventRow(alarm_id=row.id, at=row.raised_at, old_status=None, new_status=alarms.ACTIVE, reason=reason)
    _tell(session, row, event)


def store_explanation(session: Session, row: AlarmRow, explanation: JsonObject) -> None:
    """Keep the latest answer with the alarm, and each answer of another sentence in its history."""
    cause = read_cause(explanation)
    earlier, row.explanation = read_cause(row.explanation), explanation
    if cause.sentence != earlier.sentence:
        answer = f"explained: {cause.sentence}" if cause.examined else cause.sentence
        change_alarm(session, row, row.status, answer[:LONGEST_REASON])


def change_alarm(session: Session, row: AlarmRow, status: str, reason: str, who: str | None = None) -> None:
    """Give an alarm a status, and keep when, why, and by whom where it was somebody."""
    event = AlarmEventRow(alarm_id=row.id, at=now(), old_status=row.status, new_status=status, reason=reason, who=who)
    row.status = status
    if status not in alarms.OPEN:
        row.shelved_until = None  # what is over rests no more: receivers hear of its end
    _tell(session, row, event)


def comment_on_alarm(session: Session, row: AlarmRow, comment: str, who: str) -> None:
    """Keep what somebody says of an alarm; nothing else changes."""
    _tell(session, row, _event(row, comment, who, "comment"))


def shelve_alarm(session: Session, row: AlarmRow, until: datetime, comment: str, who: str) -> None:
    """Shelve an alarm until a moment; receivers are told of that, and of nothing else until then."""
    row.shelved_until = None
    _tell(session, row, _event(row, f"shelved until {text_of(until)}: {comment}"[:LONGEST_REASON], who, "shelved"))
    row.shelved_until = until


def bring_back(session: Session, row: AlarmRow) -> None:
    """Unshelve an alarm; receivers, who heard nothing meanwhile, are told how it stands now."""
    row.shelved_until = None
    _tell(session, row, _event(row, "the time that it was shelved for is over", None, "back"))


def is_shelved(row: AlarmRow) -> bool:
    """Tell whether an alarm rests now."""
    return row.shelved_until is not None and row.shelved_until > now()


def _event(row: AlarmRow, reason: str, who: str | None = None, kind: str | None = None) -> AlarmEventRow:
    return AlarmEventRow(
        alarm_id=row.id, at=now(), old_status=row.status, new_status=row.status, reason=reason, who=who, kind=kind
    )


def _tell(session: Session, row: AlarmRow, event: AlarmEventRow) -> None:
    """Keep an event of an alarm, and with it what receivers outside are told."""
    session.add(event)
    if is_shelved(row):
        return
    add_notice(session, event.at, kind_of(event), f"axes/{row.axis_id}", alarm_notice(row, event))


#: Of the kinds of CloudEvents; the name of the new status follows.
KIND = "org.preload-monitor.alarm."


def kind_of(event: AlarmEventRow) -> str:
    """Return what happened: raised, comment, shelved, back or the new status; ``updated`` where that is the old one."""
    if event.kind is not None:
        return KIND + event.kind
    if event.old_status is None:
        return KIND + "raised"
    return KIND + ("updated" if event.new_status == event.old_status else event.new_status)


def alarm_notice(alarm: AlarmRow, event: AlarmEventRow) -> JsonObject:
    """Return the alarm as it stands after an event, with what was said of it."""
    evidence = alarm.evidence
    return {
        "alarm": alarm.id,
        "axis": alarm.axis_id,
        "kind": alarm.kind,
        "status": event.new_status,
        "reason": event.reason,
        "sentence": evidence.get("sentence"),
        "cause": read_cause(alarm.explanation).sentence,
        "check_next": evidence.get("check_next"),
        "preload_n": evidence.get("preload_n"),
        "interval_n": evidence.get("interval"),
        "interval_kind": evidence.get("interval_kind"),
        "baseline_preload_n": evidence.get("baseline_preload_n"),
        "frequency_fall_percent": evidence.get("frequency_fall_percent"),
        "frequency_fall_interval_95_percent": evidence.get("frequency_fall_interval_95_percent"),
        "preload_lost_if_preload_percent": evidence.get("preload_lost_if_preload_percent"),
        "numbers": evidence.get("numbers"),
        "lost_motion_um": evidence.get("lost_motion_um"),
        "lost_motion_baseline_um": evidence.get("lost_motion_baseline_um"),
        "onset": evidence.get("onset"),
    }
