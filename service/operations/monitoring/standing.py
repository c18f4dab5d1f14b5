"""Collect the facts for the sentence that says how an axis stands."""

from collections.abc import Sequence
from typing import Final

from monitor_core.trend import TrendStatus
from service.documents.axis_sentence import AxisFacts, Cleared, OpenAlarm
from service.documents.change import read_cause
from service.documents.lost_motion import ReadingStanding
from service.documents.measurement import read_evidence
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.axis_configuration import preload_share
from service.operations.monitoring.calibrations import CalibrationOverview
from service.operations.monitoring.history import AxisHistory
from service.operations.monitoring.trend import AxisStatus
from service.store import alarms as status_of

#: Newest alarms that are looked through for what is said of an axis.
MOST_TOLD: Final = 50


def facts_of(
    status: AxisStatus,
    calibrations: CalibrationOverview,
    alarms: Sequence[AlarmView],
    history: AxisHistory,
    lost_motion: ReadingStanding,
) -> AxisFacts:
    """Return what is known of an axis; its alarms come newest first."""
    row, last, together = status.row, status.last, history.together
    alarms = [view for view in alarms if view.row.kind != status_of.LOST_MOTION]
    return AxisFacts(
        state=row.state,
        is_silent=status.state != row.state,
        heard_at=row.last_charted_at,
        silent_after_hours=status.configuration.silent_after_hours,
        in_force=calibrations.active,
        stored=max((calibration.id for calibration in calibrations.calibrations), default=None),
        judged_anew_by=None if status.stale is None else status.stale.calibration,
        last_at=row.last_measured_at,
        last_refused=last.reason,
        preload=last.preload_n,
        baseline=last.baseline_preload_n,
        has_friction=last.friction_torque_nm is not None,
        cleared=_cleared(status, calibrations, alarms),
        alert=history.alert,
        alarm=open_alarm([v for v in alarms if v.row.kind == status_of.PRELOAD_LOSS]) if row.state == "alarm" else None,
        changed_since=None if together is None or together.alarm is None else together.alarm.onset,
        lost_motion_grows=lost_motion.sentence if lost_motion.state == TrendStatus.ALARM else None,
        present=history.line,
        fall=last.fall(lambda: preload_share(status.configuration.drive_model)),
    )


def open_alarm(alarms: Sequence[AlarmView]) -> OpenAlarm | None:
    """Return what is said of the newest alarm that is open."""
    view = next((view for view in alarms if view.row.status in status_of.OPEN), None)
    if view is None:
        return None
    evidence, cause = read_evidence(view.row.evidence), read_cause(view.row.explanation)
    seen = view.last_to(status_of.ACKNOWLEDGED)
    is_other = cause.examined and cause.cause not in ("preload", "unknown", "none")
    return OpenAlarm(
        onset=evidence.onset,
        baseline=evidence.baseline_preload_n,
        owner=None if seen is None else seen.who,
        acknowledged_at=None if seen is None else seen.at,
        other_cause=cause.sentence if is_other else None,
        loss=evidence.loss,
        fall=evidence.fall,
        while_learning=evidence.while_learning,
    )


def _cleared(status: AxisStatus, calibrations: CalibrationOverview, alarms: Sequence[AlarmView]) -> Cleared | None:
    """Return the clearing with which the charts began again, if nothing moved them since."""
    row = status.row
    if row.state != "unknown" or row.epoch_from is not None:
        return None
    events = [event for view in alarms if (event := view.last_to(status_of.CLEARED)) is not None]
    newest = max(events, key=lambda event: event.at, default=None)
    activated_at = max((activation.activated_at for activation in calibrations.activations), default=None)
    if newest is None or (activated_at is not None and activated_at > newest.at):
        return None
    return Cleared(newest.at, newest.who, newest.reason)
