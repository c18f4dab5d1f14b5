"""Complete measurements are judged in order: the core's outcome is stored with the state it leads to."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from monitor_core.pipeline import AxisState, MeasurementOutcome, advance, judge_measurement
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.trend import DetectorDesign
from service.clock import now
from service.errors import WaveformDamagedError
from service.observability import Metrics
from service.operations.alarms import raise_alarm
from service.operations.documents import alarm_evidence, measurement_document, response_document
from service.operations.monitor_state import dump_state, load_design, load_state
from service.operations.settings_of_axis import AxisConfiguration, core_settings
from service.store import measurements
from service.store.archive import accepted_windows
from service.store.axes import get_axis
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database
from service.store.tables import AxisRow, MeasurementRow
from service.store.waveforms import WaveformStore

log = logging.getLogger(__name__)


class Judge:
    """Judges what is complete. The caller holds the lane of the axis."""

    def __init__(
        self, database: Database, waveforms: WaveformStore, in_force: CalibrationsInForce, metrics: Metrics
    ) -> None:
        self._database = database
        self._waveforms = waveforms
        self._in_force = in_force
        self._metrics = metrics

    def judge(
        self, axis_id: str, measurement_ids: Sequence[int], held: Mapping[datetime, Window]
    ) -> list[dict[str, Any]]:
        """Judge complete measurements of an axis one after another; return their outcomes.

        Parameters
        ----------
        axis_id : str
            Of the axis.
        measurement_ids : sequence of int
            In time order.
        held : mapping of datetime to Window
            Windows at hand by their start; others are read from disk.
        """
        return [self._judge(axis_id, measurement_id, held) for measurement_id in measurement_ids]

    def _judge(self, axis_id: str, measurement_id: int, held: Mapping[datetime, Window]) -> dict[str, Any]:
        with self._metrics.judging.time():
            with self._database.read() as session:
                axis = get_axis(session, axis_id)
                calibration = self._in_force.of(session, axis)
                windows = self._windows(session, measurement_id, held)
            configuration = AxisConfiguration.model_validate(axis.configuration)
            outcome = _outcome(windows, configuration, calibration)
            with self._database.write() as session:
                verdict = _store(
                    session,
                    axis=get_axis(session, axis_id, lock=True),
                    row=measurements.get_measurement(session, axis_id, measurement_id),
                    outcome=outcome,
                    calibration=calibration,
                )
        self._metrics.measurements.labels(verdict.outcome).inc()
        if verdict.alarm is not None:
            self._metrics.alarms.labels(verdict.alarm).inc()
        return verdict.document

    def _windows(
        self, session: Session, measurement_id: int, held: Mapping[datetime, Window]
    ) -> list[Window] | Rejection:
        try:
            return accepted_windows(session, self._waveforms, measurement_id, held)
        except WaveformDamagedError as error:
            return Rejection(RejectionReason.WAVEFORM_DAMAGED, str(error))


@dataclass(frozen=True, slots=True)
class _Verdict:
    """What is said about a measurement, and under which names it is counted."""

    document: dict[str, Any]
    outcome: str
    alarm: str | None = None


def _outcome(
    windows: list[Window] | Rejection, configuration: AxisConfiguration, calibration: Calibration | None
) -> MeasurementOutcome:
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
    except Exception as error:  # the windows are stored: one that breaks the core must not block the axis
        log.exception("judging '%s' failed", windows[0].measurement)
        return _refused(Rejection(RejectionReason.FIT_FAILED, f"the computation failed: {error}"))


def _refused(rejection: Rejection) -> MeasurementOutcome:
    return MeasurementOutcome(rejection, rejection, rejection)


def _store(
    session: Session,
    *,
    axis: AxisRow,
    row: MeasurementRow,
    outcome: MeasurementOutcome,
    calibration: Calibration | None,
) -> _Verdict:
    """Write the outcome, the state that follows from it, and the alarm if it raises one, in one transaction."""
    before = load_state(axis.monitor_state)
    after = _state_after(before, row, outcome, calibration, load_design(axis.detector_design))
    refusal = outcome.refusal
    row.status = measurements.JUDGED if refusal is None else measurements.REFUSED
    row.refusal_reason = None if refusal is None else str(refusal.reason)
    row.judged_at = now()
    row.calibration_id = axis.active_calibration_id
    row.monitor_state = str(after.detector.status)
    row.outcome = document = measurement_document(row, outcome, after, calibration)
    row.response = response_document(outcome)
    row.frequency_hz = document["frequency_hz"]
    row.preload_n = document["preload_n"]
    if document["interval_95_n"] is not None:
        row.interval_lower_n, row.interval_upper_n = document["interval_95_n"]
    axis.monitor_state = dump_state(after)
    alarm = None
    if calibration is not None and after.detector.alarm is not None and before.detector.alarm is None:
        alarm = "preload-loss"
        raise_alarm(session, axis.id, row.id, alarm, alarm_evidence(row, outcome, after, calibration))
    return _Verdict(document, row.refusal_reason or row.status, alarm)


def _state_after(
    before: AxisState,
    row: MeasurementRow,
    outcome: MeasurementOutcome,
    calibration: Calibration | None,
    design: DetectorDesign,
) -> AxisState:
    last = before.detector.last_at
    if calibration is None or (last is not None and row.started_at <= last):
        return before  # a measurement from before the last one cannot be put into charts that have moved on
    return advance(before, outcome, row.started_at, calibration=calibration, design=design)
