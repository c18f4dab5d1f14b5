"""Lead a window from gate to mode and preload. Live, replay and tests all call these functions and no others.

::

    check_window       one window            → Rejection | None
    judge_measurement  windows of one place  → mode → preload feature → newtons with interval, if calibrated; friction
    advance            axis state, outcome   → axis state (baseline, charts, alarm): monitor_core/axis_state.py
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from monitor_core.cross_checks import cross_checked, refuse_wraps
from monitor_core.errors import OutsideValidityError
from monitor_core.modal import ModalMeasurement, ModeGate, calibrate_phase, measure_mode
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    ModalReading,
    PreloadEstimate,
    Weighting,
    calibrate,
    calibration_from_prior,
    estimate_preload,
    expected_band,
    with_unset_preload,
)
from monitor_core.preload.drag_torque import Friction, estimate_friction
from monitor_core.preload.estimate import refuse_other_channels
from monitor_core.preload.fit import BETWEEN_SESSIONS
from monitor_core.preload.witnesses import WitnessName
from monitor_core.quality import QualityGate, gate_window
from monitor_core.recording import (
    Doubt,
    DoubtReason,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    ResponseQuantity,
    Window,
)
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
    preload: PreloadEstimate | Rejection | None  # None: no calibration is in force, and the frequency alone is watched
    friction: Friction | Rejection
    doubts: tuple[Doubt, ...] = ()  # of the windows themselves; those of a preload stand with it, too

    @property
    def refusal(self) -> Rejection | None:
        """Why there is neither preload nor frequency, the earliest reason first."""
        return next((answer for answer in (self.modal, self.preload) if isinstance(answer, Rejection)), None)


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


def whole_band(settings: AxisSettings, window: Window) -> tuple[float, float]:
    """Tell which lines of a window are compared with a model, in hertz: all that can be used.

    In the band of the mode alone friction may look like a delay, and a nearby antiresonance is not seen.
    """
    low, high = _usable_band(window)
    stated_low, stated_high = settings.search_band or (low, high)
    return min(low, stated_low), max(high, stated_high)


def measure_response(windows: Sequence[Window], settings: AxisSettings) -> ModalMeasurement | Rejection:
    """Measure the response of one measurement, without a calibration, on all lines that a model is compared with.

    The windows, at least one, are those of one measurement at one position that :func:`check_window` accepts. The band
    of the settings says where the mode is looked for, which the measurement is gated by.
    """
    band, lines = search_band(settings, None, windows[0]), whole_band(settings, windows[0])
    checked = cross_checked(windows, band[0])
    return _warned(measure_mode(checked.windows, band=band, gate=settings.mode, lines=lines), checked.doubts)


def _warned(modal: ModalMeasurement | Rejection, doubts: Sequence[Doubt]) -> ModalMeasurement | Rejection:
    """Let a measured mode say what its windows contradict themselves in."""
    if isinstance(modal, Rejection) or not doubts:
        return modal
    return replace(modal, warnings=(*(doubt.detail for doubt in doubts), *modal.warnings))


def _usable_band(window: Window) -> tuple[float, float]:
    return UNSTATED_BAND[0] * window.sample_rate, UNSTATED_BAND[1] * window.sample_rate


def check_window(window: Window, settings: AxisSettings, calibration: Calibration | None) -> Rejection | None:
    """Return why a window on its own is not fit to be averaged, or ``None``."""
    if _refuse_channels(window, calibration) is not None:  # judge_measurement says it
        calibration = None
    gate, band = settings.quality, search_band(settings, calibration, window)
    if (refusal := _sampled_too_slowly(window, band)) is not None:
        return refusal
    low, high = band
    if calibration is not None and calibration.excitation_level is not None:
        least = EXCITATION_SHARE * calibration.excitation_level * math.sqrt(high - low)
        gate = replace(gate, minimum_band_excitation=least)
    return refuse_wraps(window) or gate_window(window, gate, band=band)


def _sampled_too_slowly(window: Window, band: tuple[float, float]) -> Rejection | None:
    """Return why a band is not in the spectrum of a window, or ``None``."""
    low, high = band
    if low < high < 0.5 * window.sample_rate:
        return None
    return Rejection(
        RejectionReason.SAMPLE_RATE_MISMATCH,
        f"the mode is looked for up to {high:g} Hz, which needs more than {2.0 * high:g} Hz sampling rate; "
        f"got {window.sample_rate:g} Hz",
    )


def judge_measurement(
    windows: Sequence[Window], settings: AxisSettings, calibration: Calibration | None
) -> MeasurementOutcome:
    """Average the accepted windows of one measurement, find the mode, and turn it into a preload.

    The windows, at least one, are those of one measurement at one position that :func:`check_window` accepts, by this
    calibration or by one before it. Without a calibration the mode is measured, and no preload stands beside it; the
    outcome holds estimates, or the named reasons why there are none. By a calibration for another excitation or
    response nothing is judged.
    """
    if (mismatch := _refuse_channels(windows[0], calibration)) is not None:
        outcome = judge_measurement(windows, settings, None)
        modal = outcome.modal if isinstance(outcome.modal, ModalMeasurement) else mismatch
        return replace(outcome, modal=modal, preload=mismatch)
    calibrated = None if calibration is None else calibration.trace_polarity
    checked = cross_checked(windows, search_band(settings, calibration, windows[0])[0], calibrated)
    windows = checked.windows
    band = search_band(settings, calibration, windows[0])
    modal = _sampled_too_slowly(windows[0], band) or measure_mode(
        windows,
        band=band,
        gate=settings.mode,
        phase=None if calibration is None else calibration.phase_reference,
        maximum_modes=2 if calibration is None else calibration.maximum_modes,
    )
    friction = estimate_friction(windows, checked.trace_polarity or calibrated)
    if isinstance(modal, ModalMeasurement) and isinstance(friction, Friction):
        modal = _with_friction(modal, friction)
    preload = _preload(modal, windows[0], calibration)
    if calibration is not None and calibration.maximum_modes < 2 and _may_be_two_modes(modal, preload):
        both = _with_second_mode(modal, windows, settings, calibration, friction)
        modal, preload = both or (modal, preload)
    if isinstance(preload, PreloadEstimate):  # first: what nothing else can be judged by
        preload = replace(preload, doubts=(*checked.doubts, *preload.doubts))
    return MeasurementOutcome(_warned(modal, checked.doubts), preload, friction, checked.doubts)


def _refuse_channels(window: Window, calibration: Calibration | None) -> Rejection | None:
    """Return why a calibration does not hold for the channels of a window, or ``None``."""
    if calibration is None:
        return None
    return refuse_other_channels(calibration, window.source, window.excitation_quantity, window.response_quantity)


def _with_friction(modal: ModalMeasurement, friction: Friction) -> ModalMeasurement:
    return replace(modal, friction_torque=friction.torque.value, trace_polarity=friction.trace_polarity)


#: What a second mode beside the calibrated one shows itself by.
_SIGNS_OF_TWO_MODES = (
    DoubtReason.DAMPING_CHANGED,
    DoubtReason.MASS_OR_MOUNTING_CHANGED,
    DoubtReason.MOVED_MASS_CHANGED,
    RejectionReason.DAMPING_MISMATCH,
    RejectionReason.MOVED_MASS_MISMATCH,
    RejectionReason.NO_PEAK_IN_BAND,
    RejectionReason.WRONG_PHASE,
)


def _may_be_two_modes(modal: ModalMeasurement | Rejection, preload: PreloadEstimate | Rejection | None) -> bool:
    """Tell whether one mode explains a measurement less well than it did the calibration."""
    if isinstance(modal, Rejection):
        return modal.reason in _SIGNS_OF_TWO_MODES
    if modal.leaves_response:
        return True
    if preload is None:
        return False
    reasons = (preload.reason,) if isinstance(preload, Rejection) else tuple(doubt.reason for doubt in preload.doubts)
    return any(reason in _SIGNS_OF_TWO_MODES for reason in reasons)


def _with_second_mode(
    modal: ModalMeasurement | Rejection,
    windows: Sequence[Window],
    settings: AxisSettings,
    calibration: Calibration,
    friction: Friction | Rejection,
) -> tuple[ModalMeasurement, PreloadEstimate | Rejection | None] | None:
    """Measure once more with two modes; where the data require them, half of what that moves joins the uncertainty."""
    band = search_band(settings, calibration, windows[0])
    both = measure_mode(windows, band=band, gate=settings.mode, phase=calibration.phase_reference, maximum_modes=2)
    if isinstance(both, Rejection) or both.n_modes < 2:
        return None
    frequency = both.mode.frequency
    moved = 0.0 if isinstance(modal, Rejection) else modal.mode.frequency.value - frequency.value
    wider = replace(frequency, standard_uncertainty=math.hypot(frequency.standard_uncertainty, 0.5 * moved))
    both = replace(both, mode=replace(both.mode, frequency=wider))
    both = _with_friction(both, friction) if isinstance(friction, Friction) else both
    estimate = _preload(both, windows[0], calibration)
    if not isinstance(estimate, PreloadEstimate):
        return both, estimate
    doubt = Doubt(
        DoubtReason.SECOND_MODE,
        f"a second mode has come that the calibration did not have; with it the axial one lies at "
        f"{frequency.value:.2f} Hz, without it {moved:+.2f} Hz from there, half of which joins the uncertainty",
    )
    return both, estimate.with_doubts([doubt])


def _preload(
    modal: ModalMeasurement | Rejection, window: Window, calibration: Calibration | None
) -> PreloadEstimate | Rejection | None:
    if isinstance(modal, Rejection):
        return modal
    if calibration is None:
        return None
    return estimate_preload(
        modal.mode.frequency,
        modal.conditions,
        calibration,
        excitation_source=window.source,
        excitation_quantity=window.excitation_quantity,
        response_quantity=window.response_quantity,
        witnesses=witnesses_of(modal),
        random_uncertainty=modal.random_uncertainty,
    )


def witnesses_of(modal: ModalMeasurement) -> dict[WitnessName, float]:
    """Return what a measurement holds besides its frequency, for comparison with the calibration."""
    values = {
        WitnessName.DAMPING_RATIO: modal.mode.damping_ratio.value,
        WitnessName.RESIDUE: abs(modal.mode.residue),
        WitnessName.EXCITATION_LEVEL: modal.excitation_level,
    }
    if modal.noise_level > 0.0:
        values[WitnessName.NOISE_LEVEL] = modal.noise_level
    if modal.rigid_line is not None:
        values[WitnessName.RIGID_LINE] = modal.rigid_line.value
    if modal.friction_torque is not None:
        values[WitnessName.FRICTION_TORQUE] = modal.friction_torque
    return values


def calibrate_from_measurements(
    measurements: Sequence[ModalMeasurement],
    *,
    settings: AxisSettings,
    weighting: Weighting = Weighting.NONE,
    prior: CoefficientPrior | None = None,
    between_sessions: float = BETWEEN_SESSIONS,
) -> Calibration:
    """Fit k1…k4 to the measurements of a calibration session, with polarity, delay and excitation level of the axis.

    Measurements are weighted alike by default: their own standard uncertainties are far below the scatter between
    measurements, so they are no guide to how much each is worth. The measurements are taken to be of one session: what
    other days change of a frequency is declared, relative.
    """
    readings = _readings(measurements)
    quantity, source, response = _channels(measurements)
    polarities = {m.trace_polarity for m in measurements} - {None}
    return calibrate(
        readings,
        weighting=weighting,
        excitation_source=source,
        excitation_quantity=quantity,
        response_quantity=response,
        moving_mass=settings.moving_mass,
        maximum_modes=1 if statistics.median(m.n_modes for m in measurements) < 2 else 2,
        phase_reference=calibrate_phase([m.mode for m in measurements]),
        excitation_level=statistics.median(m.excitation_level for m in measurements),
        prior=prior,
        between_sessions=between_sessions,
        trace_polarity=polarities.pop() if len(polarities) == 1 else None,  # of two kinds none is the right one
    )


def calibrate_by_drive(
    measurements: Sequence[ModalMeasurement],
    prior: CoefficientPrior,
    log_preload: Estimate,
    *,
    settings: AxisSettings,
    weighting: Weighting = Weighting.NONE,
) -> Calibration:
    """Join what a drive model lets expect with measurements: of preloads that were set, and of one that nobody set.

    ``log_preload`` is that of the latter, ln(P/N) (:func:`~monitor_core.preload.with_unset_preload`, which raises where
    they contradict the prior or carry a payload). One measurement at least, with the motor held as in the prior: with
    another source of excitation OutsideValidityError is raised.
    """
    quantity, source, response = _channels(measurements)
    if prior.excitation_source is not source:
        raise OutsideValidityError(
            f"expected what a drive model says of an excitation from '{source}', as the measurements have it; "
            f"got it of one from '{prior.excitation_source}'"
        )
    prior = replace(prior, excitation_quantity=quantity, response_quantity=response)
    unset = [m for m in measurements if m.conditions.preload is None]
    at_set_preload = [m for m in measurements if m.conditions.preload is not None]
    if unset:
        prior = with_unset_preload(prior, _readings(unset), log_preload)
    if not at_set_preload:
        return calibration_from_prior(prior, moving_mass=settings.moving_mass)
    return calibrate_from_measurements(at_set_preload, settings=settings, weighting=weighting, prior=prior)


def _readings(measurements: Sequence[ModalMeasurement]) -> list[ModalReading]:
    return [
        ModalReading(
            m.mode.frequency.value, m.conditions, m.mode.frequency.standard_uncertainty, witnesses=witnesses_of(m)
        )
        for m in measurements
    ]


def _channels(
    measurements: Sequence[ModalMeasurement],
) -> tuple[ExcitationQuantity, ExcitationSource, ResponseQuantity]:
    """Return what was measured of which source; OutsideValidityError if it is not of one kind."""
    channels = {(m.excitation_quantity, m.excitation_source, m.response_quantity) for m in measurements}
    if len(channels) != 1:
        got = ", ".join(sorted(f"{response} by {quantity} from {source}" for quantity, source, response in channels))
        raise OutsideValidityError(
            f"a calibration holds for one kind of excitation and response; the measurements are of {got}"
        )
    return channels.pop()
