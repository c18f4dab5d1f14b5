"""What is told of an alarm, in one document that needs no other."""

from service.documents.change import read_cause
from service.json_types import JsonObject
from service.store.tables import AlarmEventRow, AlarmRow

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
        "onset": evidence.get("onset"),
    }
