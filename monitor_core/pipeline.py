"""Lead a window from gate to mode, preload and state. Live, replay and tests all call these functions and no others.

::

    check_window       one window            → SignalQuality | Rejection
    judge_measurement  windows of one place  → mode → preload feature → newtons with interval; drag torque
    advance            axis state, outcome   → axis state (baseline, charts, alarm)
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from monitor_core.errors import OutsideValidityError
from monitor_core.modal import ModalMeasurement, ModeGate, calibrate_phase, measure_mode
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    ModalReading,
    PreloadEstimate,
    Weighting,
    calibrate,
    estimate_preload,
    expected_band,
    systematic_uncertainty_between,
)
from monitor_core.preload.drag_torque import DragTorque, estimate_drag_torque
from monitor_core.quality import QualityGate, SignalQuality, gate_window
from monitor_core.recording import Conditions, Rejection, RejectionReason, Window
from monitor_core.trend import DetectorDesign, DetectorState, Observation, step
from monitor_core.uncertainty import Estimate

#: Without a calibration and a stated band the mode is looked for between these shares of the sampling rate: below the
#: roll-off of any anti-aliasing filter, above the slow motion of the table itself.
UNSTATED_BAND = (0.02, 0.4)
#: A window whose excitation in the band is weaker than this share of what the calibration had is refused.
EXCITATION_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """What is stated about an axis before anything is measured."""

    search_band: tuple[float, float] | None = None  # where the mode is looked for without a calibration [Hz]
    quality: QualityGate = field(default_factory=QualityGate)
    mode: ModeGate = field(default_factory=ModeGate)
    moving_mass: Estimate | None = None  # used where a calibration has one payload only [kg]

    def __post_init__(self) -> None:
        if self.search_band is not None and not 0.0 < self.search_band[0] < self.search_band[1]:
            low, high = self.search_band
            raise OutsideValidityError(f"search_band must rise from above 0 Hz; got {low:g} to {high:g} Hz")


@dataclass(frozen=True, slots=True)
class MeasurementOutcome:
    """Outcome of one measurement."""

    modal: ModalMeasurement | Rejection
    preload: PreloadEstimate | Rejection
    drag_torque: DragTorque | Rejection

    @property
    def refusal(self) -> Rejection | None:
        """Why there is no preload, the earliest reason first."""
        return next((answer for answer in (self.modal, self.preload) if isinstance(answer, Rejection)), None)


@dataclass(frozen=True, slots=True)
class AxisState:
    """Where an axis stands: the charts, and the conditions under which their baseline was learnt."""

    detector: DetectorState = field(default_factory=DetectorState)
    baseline_conditions: tuple[Conditions, ...] = ()


def search_band(settings: AxisSettings, calibration: Calibration | None, window: Window) -> tuple[float, float]:
    """Tell where the mode of a window is looked for, in hertz.

    Where a calibration says it, else where the operator says it, else nearly everywhere.
    """
    if calibration is not None:
        try:
            return expected_band(calibration, window.conditions)
        except OutsideValidityError:
            pass  # so far from the calibrated positions that Eq. (8) says nothing
    return settings.search_band or _usable_band(window)


def _whole_band(settings: AxisSettings, window: Window) -> tuple[float, float]:
    """Tell which lines of a window are compared with a model, in hertz: all that can be used.

    In the band of the mode alone friction may look like a delay, and a nearby antiresonance is not seen.
    """
    low, high = _usable_band(window)
    stated_low, stated_high = settings.search_band or (low, high)
    return min(low, stated_low), max(high, stated_high)


def measure_response(windows: Sequence[Window], settings: AxisSettings) -> ModalMeasurement | Rejection:
    """Measure the response of one measurement, without a calibration, on all lines that a model is compared with.

    ``windows``: accepted by :func:`check_window`, of one measurement at one position; at least one; ``settings``:
    of the axis; its band says where the mode is looked for, which the measurement is gated by.
    """
    band, lines = search_band(settings, None, windows[0]), _whole_band(settings, windows[0])
    return measure_mode(windows, band=band, gate=settings.mode, lines=lines)


def _usable_band(window: Window) -> tuple[float, float]:
    return UNSTATED_BAND[0] * window.sample_rate, UNSTATED_BAND[1] * window.sample_rate


def check_window(window: Window, settings: AxisSettings, calibration: Calibration | None) -> SignalQuality | Rejection:
    """Gate one window on its own: fit to be averaged, or why not."""
    gate, (low, high) = settings.quality, search_band(settings, calibration, window)
    if not low < high < 0.5 * window.sample_rate:
        return Rejection(
            RejectionReason.SAMPLE_RATE_MISMATCH,
            f"the mode is looked for up to {high:g} Hz, which needs more than {2.0 * high:g} Hz sampling rate; "
            f"got {window.sample_rate:g} Hz",
        )
    if calibration is not None and calibration.excitation_level is not None:
        least = EXCITATION_SHARE * calibration.excitation_level * math.sqrt(high - low)
        gate = replace(gate, minimum_band_excitation=least)
    return gate_window(window, gate, band=(low, high))


def judge_measurement(
    windows: Sequence[Window], settings: AxisSettings, calibration: Calibration | None
) -> MeasurementOutcome:
    """Average the accepted windows of one measurement, find the mode, and turn it into a preload.

    ``windows``: accepted by :func:`check_window`, of one measurement at one position; at least one; ``settings``:
    of the axis; ``calibration``: in force; without one the mode is measured and the preload refused as
    ``not-calibrated``. Returned: estimates, or the named reasons why there are none.
    """
    modal = measure_mode(
        windows,
        band=search_band(settings, calibration, windows[0]),
        gate=settings.mode,
        phase=None if calibration is None else calibration.phase_reference,
        maximum_modes=2 if calibration is None else calibration.maximum_modes,
    )
    return MeasurementOutcome(modal, _preload(modal, windows[0], calibration), estimate_drag_torque(windows))


def _preload(
    modal: ModalMeasurement | Rejection, window: Window, calibration: Calibration | None
) -> PreloadEstimate | Rejection:
    if isinstance(modal, Rejection):
        return modal
    if calibration is None:
        return Rejection(RejectionReason.NOT_CALIBRATED, "no calibration is in force: activate one for this axis")
    return estimate_preload(
        modal.mode.frequency,
        modal.conditions,
        calibration,
        excitation_source=window.excitation_source,
        excitation_quantity=window.excitation_quantity,
    )


def advance(
    state: AxisState, outcome: MeasurementOutcome, at: datetime, *, calibration: Calibration, design: DetectorDesign
) -> AxisState:
    """Carry the state of an axis over one measurement.

    A refused measurement changes nothing; nor does one whose preload was set on purpose, which tells nothing about
    wear. What is watched is the preload feature: it is nearly normally distributed where newtons are not.
    """
    if isinstance(outcome.preload, Rejection) or isinstance(outcome.modal, Rejection):
        return state
    return advance_estimate(
        state, outcome.preload, outcome.modal.conditions, at, calibration=calibration, design=design
    )


def advance_estimate(
    state: AxisState,
    estimate: PreloadEstimate,
    conditions: Conditions,
    at: datetime,
    *,
    calibration: Calibration,
    design: DetectorDesign,
) -> AxisState:
    """Carry the state over one estimate, however its frequency was obtained."""
    if conditions.preload is not None:
        return state
    learning = state.detector.baseline is None
    systematic = (
        0.0
        if learning
        else systematic_uncertainty_between(estimate.feature.value, conditions, state.baseline_conditions, calibration)
    )
    # the frequency's own uncertainty only: the scatter between measurements is what the baseline learns
    observation = Observation(at, estimate.feature.value, estimate.feature_own_uncertainty, systematic)
    return AxisState(
        detector=step(state.detector, observation, design),
        baseline_conditions=(*state.baseline_conditions, conditions) if learning else state.baseline_conditions,
    )


def calibrate_from_measurements(
    measurements: Sequence[ModalMeasurement],
    *,
    settings: AxisSettings,
    weighting: Weighting = Weighting.NONE,
    prior: CoefficientPrior | None = None,
) -> Calibration:
    """Fit k1…k4 to the measurements of a calibration session, with polarity, delay and excitation level of the axis.

    Measurements are weighted alike by default: their own standard uncertainties are far below the scatter between
    measurements, so they are no guide to how much each is worth.
    """
    readings = [
        ModalReading(m.mode.frequency.value, m.conditions, m.mode.frequency.standard_uncertainty) for m in measurements
    ]
    excitations = {(m.excitation_quantity, m.excitation_source) for m in measurements}
    if len(excitations) != 1:
        got = ", ".join(sorted(f"{quantity} from {source}" for quantity, source in excitations))
        raise OutsideValidityError(f"a calibration holds for one kind of excitation; the measurements are of {got}")
    quantity, source = excitations.pop()
    return calibrate(
        readings,
        weighting=weighting,
        excitation_source=source,
        excitation_quantity=quantity,
        moving_mass=settings.moving_mass,
        maximum_modes=1 if statistics.median(m.n_modes for m in measurements) < 2 else 2,
        phase_reference=calibrate_phase([m.mode for m in measurements]),
        excitation_level=statistics.median(m.excitation_level for m in measurements),
        prior=prior,
    )
