"""Collect the evidence behind a value: gate readings, the ladder to newtons, the response over the baseline's."""

import cmath
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from monitor_core.errors import MonitorCoreError
from monitor_core.modal import GateReading, ModeReadings, averaged_response, gate_readings, read_gates
from monitor_core.pipeline import MeasurementOutcome, search_band, whole_band
from monitor_core.preload import Calibration, PreloadLadder, expected_band, preload_ladder
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.recordings.calibration_file import calibration_from_document
from monitor_core.response import FrequencyResponse, ModalParameters
from monitor_core.uncertainty import Estimate
from service.documents.stored_measurement import NOTHING_MEASURED, StoredMeasurement
from service.errors import LetGoError, WaveformDamagedError
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings, load_configuration
from service.operations.monitoring.intake.chart_state import load_state
from service.operations.monitoring.intake.judge import judge
from service.operations.monitoring.stored_modes import accepted_windows
from service.operations.monitoring.trend import MeasurementView
from service.store import axes, calibrations, measurements
from service.store.database import Database
from service.store.trend.points import Span, point_before
from service.store.trend.shown import PageOf, page_of_points
from service.store.waveforms import WaveformStore

#: Measurements of the baseline that are averaged, and how far from the place of the measurement they may be [mm].
_MOST_AVERAGED, _SAME_PLACE_MM = 8, 5.0
#: The newest calibrations are asked.
MOST_CALIBRATIONS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Responses:
    """The response of a measurement on all lines, and the mean of the baseline's at the same place, or another one."""

    measured: FrequencyResponse | None  # None: its waveforms are not there, or could not be averaged
    baseline: FrequencyResponse | None  # or that of the other measurement
    n_baseline: int
    band: tuple[float, float] | None  # where the mode is looked for [Hz]
    windows: tuple[Window, ...]  # that were averaged


@dataclass(frozen=True, slots=True)
class OtherJudgement:
    """What a calibration says of a measurement."""

    calibration: int
    outcome: MeasurementOutcome


def evidence_of(
    database: Database, waveforms: WaveformStore, axis_id: str, view: MeasurementView
) -> "MeasurementEvidence":
    """Return what the value of a measurement rests on; its waveforms are read when they are first asked for."""
    with database.read() as session:
        configuration = load_configuration(axes.get_axis(session, axis_id).configuration)
        number = view.row.calibration_id
        row = None if number is None else calibrations.get_calibration(session, axis_id, number)
    calibration = None if row is None else calibration_from_document(row.document)
    return MeasurementEvidence(database, waveforms, axis_id, view, configuration, calibration)


@dataclass(frozen=True, eq=False)
class MeasurementEvidence:
    """Why one measurement has its value: what it was judged by is known, its waveforms are read once."""

    _database: Database
    _waveforms: WaveformStore
    axis_id: str
    view: MeasurementView
    configuration: AxisConfiguration
    calibration: Calibration | None  # by which it was judged

    def gates(self) -> tuple[GateReading, ...]:
        """Return what each gate read; none where no mode was found, or its waveforms are needed and not there."""
        outcome = self.view.outcome or NOTHING_MEASURED
        if self.calibration is not None and outcome.n_modes == 1:
            stored = _stored_gates(outcome, self.configuration, self.calibration)
            if stored is not None:
                return stored
        if not self.windows:
            return ()
        settings, calibration = core_settings(self.configuration), self.calibration
        read = read_gates(
            self.windows,
            band=search_band(settings, calibration, self.windows[0]),
            gate=settings.mode,
            phase=None if calibration is None else calibration.phase_reference,
            maximum_modes=2 if calibration is None else max(calibration.maximum_modes, outcome.n_modes),
        )
        return read.gates if isinstance(read, ModeReadings) else ()

    def ladder(self) -> PreloadLadder | None:
        """Return the terms between the frequency and the preload; None if there is no preload."""
        outcome, calibration = self.view.outcome or NOTHING_MEASURED, self.calibration
        frequency, conditions = outcome.frequency_hz, outcome.conditions
        if calibration is None or frequency is None or conditions is None or outcome.preload_n is None:
            return None
        return preload_ladder(frequency, conditions, calibration, feature=outcome.preload_feature_s2)

    def responses(self, beside: int | None = None) -> Responses:
        """Return the whole response, and the baseline's at the same place, or that of the measurement ``beside`` it."""
        windows = self.windows
        if not windows:
            return Responses(None, None, 0, None, ())
        settings = core_settings(self.configuration)
        lines, band = whole_band(settings, windows[0]), search_band(settings, self.calibration, windows[0])
        measured = averaged_response(windows, lines)
        if isinstance(measured, Rejection):
            return Responses(None, None, 0, band, tuple(windows))
        if beside is None:
            others = [r for r in self._baseline(lines) if np.array_equal(r.frequency, measured.frequency)]
        else:
            others = [r for r in self._response_of(beside) if r.quantity == measured.quantity]
        return Responses(measured, _mean(others), len(others), band, tuple(windows))

    def _response_of(self, measurement_id: int) -> list[FrequencyResponse]:
        """Return the whole response of another measurement, if its samples are there."""
        windows = self._windows_of(measurement_id)
        if not windows:
            return []
        answer = averaged_response(windows, whole_band(core_settings(self.configuration), windows[0]))
        return [] if isinstance(answer, Rejection) else [answer]

    def judgements(self) -> list[OtherJudgement]:
        """Return what the newest calibrations say of the same windows; none where the waveforms are not there."""
        if not self.windows:
            return []
        with self._database.read() as session:
            rows = calibrations.list_calibrations(session, self.axis_id)
        judged_by = self.view.row.calibration_id
        chosen = [row for i, row in enumerate(rows) if i < MOST_CALIBRATIONS or row.id == judged_by]
        calibrated = ((row.id, calibration_from_document(row.document)) for row in chosen)
        return [OtherJudgement(number, judge(self.windows, self.configuration, each)) for number, each in calibrated]

    def neighbours(self) -> tuple[int | None, int | None]:
        """Return the numbers of the measurements before and after it, in order of time."""
        with self._database.read() as session:
            number, at = axes.get_axis(session, self.axis_id).number, self.view.row.started_at
            previous = point_before(session.connection(), number, at)
            after = PageOf(Span(at), 1, after=(at, self.view.row.id))
            following = page_of_points(session.connection(), number, after)
        return None if previous is None else previous.measurement_id, following[0].measurement_id if following else None

    @cached_property
    def windows(self) -> list[Window]:
        """The accepted windows; none where they were let go or are damaged."""
        return self._windows_of(self.view.row.id)

    def _windows_of(self, measurement_id: int) -> list[Window]:
        try:
            return accepted_windows(self._database, self._waveforms, measurement_id)
        except (LetGoError, WaveformDamagedError):
            return []

    def _baseline(self, lines: tuple[float, float]) -> list[FrequencyResponse]:
        with self._database.read() as session:
            baseline = load_state(axes.get_axis(session, self.axis_id).monitor_state).detector.baseline
            if baseline is None:
                return []
            rows = measurements.newest_monitored(session, self.axis_id, baseline.started_at, baseline.ended_at, 100)
        own = self.view.row
        same_place = [row.id for row in rows if abs(row.position_mm - own.position_mm) <= _SAME_PLACE_MM]
        read = (self._windows_of(number) for number in same_place[-_MOST_AVERAGED:] if number != own.id)
        responses = (averaged_response(windows, lines) for windows in read if windows)
        return [response for response in responses if isinstance(response, FrequencyResponse)]


def _stored_gates(
    outcome: StoredMeasurement, configuration: AxisConfiguration, calibration: Calibration
) -> tuple[GateReading, ...] | None:
    """Return what the gates read by what is stored of a judged measurement; None if that does not tell."""
    if (
        outcome.conditions is None
        or outcome.frequency_hz is None
        or outcome.frequency_standard_uncertainty_hz is None
        or outcome.damping_ratio is None
        or outcome.residue_phase_rad is None
        or outcome.coherence is None
        or outcome.n_averages is None
    ):
        return None
    frequency = Estimate(outcome.frequency_hz, outcome.frequency_standard_uncertainty_hz)
    residue = cmath.rect(1.0, outcome.residue_phase_rad)  # of its size no gate asks, where there is one mode
    mode = ModalParameters(frequency, Estimate(outcome.damping_ratio, 0.0), 0.0, residue)
    try:
        band = expected_band(calibration, outcome.conditions)
    except MonitorCoreError:
        return None
    gate = core_settings(configuration).mode
    readings = gate_readings(
        [mode], outcome.coherence, outcome.n_averages, band=band, gate=gate, phase=calibration.phase_reference
    )
    # a mode that is stored has passed: what is above the limit is what joined its uncertainty behind the gate
    is_widened = any(each.gate is RejectionReason.UNCERTAIN_FREQUENCY and not each.passed for each in readings)
    return None if is_widened else readings


def _mean(responses: Sequence[FrequencyResponse]) -> FrequencyResponse | None:
    """Average responses on the same lines."""
    if not responses:
        return None
    first, coherences = responses[0], [r.coherence for r in responses if r.coherence is not None]
    return FrequencyResponse(
        first.frequency,
        np.mean([response.response for response in responses], axis=0),
        first.quantity,
        np.mean(coherences, axis=0) if len(coherences) == len(responses) else None,
        sum(response.n_averages for response in responses),
    )
