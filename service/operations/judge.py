"""Complete measurements are judged in order: the core's outcome is stored with the state it leads to."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from monitor_core.pipeline import AxisState, MeasurementOutcome, advance, judge_measurement
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from service.clock import now
from service.errors import WaveformDamagedError
from service.observability import Metrics
from service.operations.alarms import raise_alarm
from service.operations.axes import AxisConfiguration
from service.operations.documents import alarm_evidence, measurement_document, response_document
from service.operations.monitor_state import dump_state, load_state
from service.operations.settings_of_axis import core_settings, detector_design
from service.store import calibrations, measurements
from service.store.archive import accepted_windows
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import AxisRow, MeasurementRow
from service.store.waveforms import WaveformStore


class Judge:
    """Judges what is complete. The caller holds the lane of the axis."""

    def __init__(self, database: Database, waveforms: WaveformStore, metrics: Metrics) -> None:
        self._database = database
        self._waveforms = waveforms
        self._metrics = metrics

    def judge_complete(self, axis_id: str, held: Mapping[datetime, Window]) -> list[dict[str, Any]]:
        """Judge the complete measurements of an axis in time order; return their outcomes.

        Parameters
        ----------
        axis_id : str
            Of the axis.
        held : mapping of datetime to Window
            Windows at hand by their start; others are read from disk.
        """
        with self._database.read() as session:
            waiting = [row.id for row in measurements.measurements_with_status(session, axis_id, measurements.COMPLETE)]
        return [self._judge(axis_id, measurement_id, held) for measurement_id in waiting]

    def _judge(self, axis_id: str, measurement_id: int, held: Mapping[datetime, Window]) -> dict[str, Any]:
        with self._metrics.judging.time():
            with self._database.read() as session:
                axis = get_axis(session, axis_id)
                calibration = calibrations.active_calibration(session, axis)
                outcome = self._outcome(session, axis, measurement_id, calibration, held)
            with self._database.write() as session:
                row = measurements.get_measurement(session, axis_id, measurement_id)
                _store(
                    session,
                    axis=get_axis(session, axis_id),
                    row=row,
                    outcome=outcome,
                    calibration=calibration,
                    metrics=self._metrics,
                )
        self._metrics.measurements.labels(row.refusal_reason or row.status).inc()
        assert row.outcome is not None  # noqa: S101 - just stored
        return row.outcome

    def _outcome(
        self,
        session: Session,
        axis: AxisRow,
        measurement_id: int,
        calibration: Calibration | None,
        held: Mapping[datetime, Window],
    ) -> MeasurementOutcome:
        settings = core_settings(AxisConfiguration.model_validate(axis.configuration))
        try:
            windows = accepted_windows(session, self._waveforms, measurement_id, held)
        except WaveformDamagedError as error:
            return _refused(Rejection(RejectionReason.WAVEFORM_DAMAGED, str(error)))
        if not windows:
            return _refused(
                Rejection(
                    RejectionReason.TOO_FEW_AVERAGES,
                    f"at least {settings.mode.minimum_averages} accepted windows are needed; got none",
                )
            )
        return judge_measurement(windows, settings, calibration)


def _refused(rejection: Rejection) -> MeasurementOutcome:
    return MeasurementOutcome(rejection, rejection, rejection)


def _store(
    session: Session,
    *,
    axis: AxisRow,
    row: MeasurementRow,
    outcome: MeasurementOutcome,
    calibration: Calibration | None,
    metrics: Metrics,
) -> None:
    """Write the outcome, the state that follows from it, and the alarm if it raises one, in one transaction."""
    before = load_state(axis.monitor_state)
    after = _state_after(before, row, outcome, calibration, axis)
    refusal = outcome.refusal
    row.status = measurements.JUDGED if refusal is None else measurements.REFUSED
    row.refusal_reason = None if refusal is None else str(refusal.reason)
    row.judged_at = now()
    row.calibration_id = axis.active_calibration_id
    row.monitor_state = str(after.detector.status)
    row.outcome = measurement_document(row, outcome, after, calibration)
    row.response = response_document(outcome)
    row.frequency_hz = row.outcome["frequency_hz"]
    row.preload_n = row.outcome["preload_n"]
    if row.outcome["interval_95_n"] is not None:
        row.interval_lower_n, row.interval_upper_n = row.outcome["interval_95_n"]
    axis.monitor_state = dump_state(after)
    if calibration is not None and after.detector.alarm is not None and before.detector.alarm is None:
        evidence = alarm_evidence(row, outcome, after, calibration)
        raise_alarm(session, axis.id, row.id, "preload-loss", evidence)
        metrics.alarms.labels("preload-loss").inc()


def _state_after(
    before: AxisState,
    row: MeasurementRow,
    outcome: MeasurementOutcome,
    calibration: Calibration | None,
    axis: AxisRow,
) -> AxisState:
    last = before.detector.last_at
    if calibration is None or (last is not None and row.started_at <= last):
        return before  # a measurement from before the last one cannot be put into charts that have moved on
    design = detector_design(AxisConfiguration.model_validate(axis.configuration))
    return advance(before, outcome, row.started_at, calibration=calibration, design=design)
