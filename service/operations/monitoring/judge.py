"""A complete measurement is judged: the core's outcome, and the rows that it leads to."""

import logging
from dataclasses import dataclass

from sqlalchemy import Connection

from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisState, MeasurementOutcome, advance, judge_measurement
from monitor_core.preload import Calibration, PreloadEstimate
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.trend import TrendStatus
from service.clock import now
from service.documents.change import not_examined_yet
from service.documents.measurement import alarm_evidence, finite_or_null, measurement_document, response_document
from service.json_types import JsonObject
from service.operations.monitoring.alarms import raise_alarm
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings
from service.operations.monitoring.monitor_state import dump_state, load_design, load_state
from service.store import intake
from service.store.intake import JUDGED, REFUSED, AxisRecord, ChartsRecord, JudgedRecord, MeasurementRecord

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is said about a measurement, and under which names it is counted."""

    document: JsonObject
    state: TrendStatus  # of the axis, after it
    outcome: str
    alarm: str | None


def judge(
    windows: list[Window] | Rejection, configuration: AxisConfiguration, calibration: Calibration | None
) -> MeasurementOutcome:
    """Return the core's outcome for the accepted windows of a measurement, or for the reason why they cannot be had."""
    settings = core_settings(configuration)
    if isinstance(windows, Rejection):
        return _refused(windows)
    if not windows:
        return _refused(
            Rejection(
                RejectionReason.TOO_FEW_AVERAGES,
                f"at least {settings.mode.minimum_averages} accepted windows are needed; got none",
            )
        )
    try:
        return judge_measurement(windows, settings, calibration)
    except Exception as error:  # one measurement that breaks the core must not block all that follow on its axis
        log.exception("judging '%s' failed", windows[0].measurement)
        return _refused(Rejection(RejectionReason.FIT_FAILED, f"the computation failed: {error}"))


def record(
    connection: Connection,
    axis: AxisRecord,
    row: MeasurementRecord,
    outcome: MeasurementOutcome,
    calibration: Calibration | None,
) -> Verdict:
    """Write the outcome, the state that follows from it, and the alarm if it raises one."""
    charts = intake.read_charts(connection, axis)
    before = load_state(charts.monitor_state)
    after = _state_after(before, charts, row, outcome, calibration)
    refusal = outcome.refusal
    reason = None if refusal is None else str(refusal.reason)
    row.status = JUDGED if refusal is None else REFUSED
    row.calibration_id = axis.active_calibration_id
    row.outcome = document = measurement_document(row, outcome, after, calibration)
    mode = outcome.modal.mode if isinstance(outcome.modal, ModalMeasurement) else None
    estimate = outcome.preload if isinstance(outcome.preload, PreloadEstimate) else None
    judged = JudgedRecord(
        status=row.status,
        refusal_reason=reason,
        judged_at=now(),
        calibration_id=row.calibration_id,
        monitor_state=str(after.detector.status),
        outcome=document,
        response=response_document(outcome),
        frequency_hz=None if mode is None else finite_or_null(mode.frequency.value),
        preload_n=None if estimate is None else finite_or_null(estimate.preload),
        interval_lower_n=None if estimate is None else finite_or_null(estimate.interval.lower),
        interval_upper_n=None if estimate is None else finite_or_null(estimate.interval.upper),
    )
    intake.save_judged(connection, row, judged)
    intake.save_state(connection, axis, dump_state(after))
    alarm = None
    if calibration is not None and after.detector.alarm is not None and before.detector.alarm is None:
        alarm = "preload-loss"
        raise_alarm(
            connection,
            axis.id,
            row.id,
            alarm,
            evidence=alarm_evidence(row, outcome, after, calibration),
            explanation=not_examined_yet(axis.configuration),
        )
    return Verdict(document, after.detector.status, reason or row.status, alarm)


def _state_after(
    before: AxisState,
    charts: ChartsRecord,
    row: MeasurementRecord,
    outcome: MeasurementOutcome,
    calibration: Calibration | None,
) -> AxisState:
    last = before.detector.last_at
    if calibration is None or (last is not None and row.started_at <= last):
        return before  # a measurement from before the last one cannot be put into charts that have moved on
    design = load_design(charts.detector_design)
    return advance(before, outcome, row.started_at, calibration=calibration, design=design)


def _refused(rejection: Rejection) -> MeasurementOutcome:
    return MeasurementOutcome(rejection, rejection, rejection)
