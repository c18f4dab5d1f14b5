"""Lead a window from gate to mode, preload and state. Live, replay and tests all call these functions and no others.

::

    check_window       one window            → Rejection | None
    judge_measurement  windows of one place  → mode → preload feature → newtons with interval, if calibrated; friction
    advance            axis state, outcome   → axis state (baseline, charts, alarm)
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

from monitor_core.cross_checks import cross_checked, refuse_wraps
from monitor_core.errors import OutsideValidityError
from monitor_core.modal import ModalMeasurement, ModeGate, calibrate_phase, measure_mode
from monitor_core.preload import (
    Calibration,
    CoefficientPrior,
    ConditionLaw,
    DriveLaw,
    ModalReading,
    PreloadEstimate,
    SessionSums,
    Weighting,
    calibrate,
    calibration_from_prior,
    estimate_preload,
    expected_band,
    learn_law,
    systematic_uncertainty_between,
    with_history,
    with_unset_preload,
)
from monitor_core.preload.budget import THERMOMETER_OFFSET, lagging
from monitor_core.preload.doubts import PlaceReading, Places
from monitor_core.preload.drag_torque import Friction, estimate_friction
from monitor_core.preload.estimate import new_each_time, place_reading, refuse_other_channels
from monitor_core.preload.feature import position_part
from monitor_core.preload.fit import BETWEEN_SESSIONS
from monitor_core.preload.witnesses import Setting, WitnessName
from monitor_core.quality import QualityGate, gate_window
from monitor_core.recording import (
    Conditions,
    Doubt,
    DoubtReason,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    ResponseQuantity,
    Window,
)
from monitor_core.trend import (
    DetectorDesign,
    DetectorState,
    JointObservation,
    JointState,
    LossDirection,
    Observation,
    Session,
    joint_step,
    step,
)
from monitor_core.trend.detector import SUDDEN_LIMIT
from monitor_core.trend.observation import DEAD_ZONE, SESSION
from monitor_core.uncertainty import Estimate, enlargement

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


@dataclass(frozen=True, slots=True)
class AxisState:
    """Where an axis stands: its charts, the conditions of their baseline, and the places of the session.

    Without a calibration the charts watch 1/f² at the mean conditions of the baseline: ``law`` brings it there. Until
    it is learnt, with the baseline, ``sums`` hold what the sessions so far say of it, in their order, ``drive`` what
    the drive model does.
    """

    detector: DetectorState = field(default_factory=DetectorState)
    baseline_conditions: tuple[Conditions, ...] = ()
    places: Places = field(default_factory=Places)  # of the session that is going on
    places_since: datetime | None = None  # when it began
    joint: JointState = field(default_factory=JointState)  # of the numbers that are watched together
    drive: DriveLaw | None = None
    law: ConditionLaw | None = None
    sums: tuple[SessionSums, ...] = ()

    @property
    def learns_law(self) -> bool:
        """Whether the next measurement changes the law, of an axis without a calibration."""
        return self.law is None or bool(self.sums)


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


def advance(
    state: AxisState, outcome: MeasurementOutcome, at: datetime, *, calibration: Calibration | None,
    design: DetectorDesign,
) -> AxisState:  # fmt: skip
    """Carry the state of an axis over one measurement.

    A refused measurement changes nothing; nor does one whose preload was set on purpose, which tells nothing about
    wear. What is watched is the preload feature, which is nearly normally distributed where newtons are not; without a
    calibration it is 1/f².
    """
    if isinstance(outcome.preload, Rejection) or isinstance(outcome.modal, Rejection):
        return state
    friction = None if isinstance(outcome.friction, Rejection) else outcome.friction.torque.value
    conditions = outcome.modal.conditions
    if outcome.preload is None or calibration is None:
        feature = inverse_square(outcome.modal.mode.frequency, outcome.modal.random_uncertainty)
        charted = ChartedFeature(at, feature, conditions, friction, bool(outcome.doubts))
        return advance_feature(state, charted, calibration=None, design=design)
    return advance_estimate(
        state, outcome.preload, conditions, at, friction_torque=friction,
        damping_ratio=outcome.modal.mode.damping_ratio.value, residue=abs(outcome.modal.mode.residue),
        calibration=calibration, design=design,
    )  # fmt: skip


def inverse_square(frequency: Estimate, random_uncertainty: float | None = None) -> Estimate:
    """Return 1/f² of a frequency [Hz]: what is watched without a calibration [s²].

    With what is new of its uncertainty in each measurement, as :func:`monitor_core.preload.estimate_preload` has it.
    """
    f, own = frequency.value, frequency.standard_uncertainty * new_each_time(frequency, random_uncertainty)
    return Estimate(f**-2.0, 2.0 * own * f**-3.0)


def advance_estimate(
    state: AxisState,
    estimate: PreloadEstimate,
    conditions: Conditions,
    at: datetime,
    *,
    friction_torque: float | None = None,
    damping_ratio: float | None = None,
    residue: float | None = None,
    calibration: Calibration,
    design: DetectorDesign,
) -> AxisState:
    """Carry the state over one estimate, however its frequency was obtained."""
    # the frequency's own uncertainty only: the scatter between measurements is what the baseline learns
    feature = Estimate(estimate.feature.value, estimate.feature_own_uncertainty)
    place = place_reading(conditions, estimate, calibration)
    charted = ChartedFeature(
        at, feature, conditions, friction_torque, bool(estimate.doubts), place, damping_ratio=damping_ratio,
        residue=residue,
    )  # fmt: skip
    return advance_feature(state, charted, calibration=calibration, design=design)


@dataclass(frozen=True, slots=True)
class ChartedFeature:
    """A preload feature for the charts, as measured or as stored; without a calibration it is 1/f²."""

    at: datetime
    feature: Estimate  # with its own standard uncertainty [s²]
    conditions: Conditions
    friction_torque: float | None = None  # [N·m]
    in_doubt: bool = False
    place: PlaceReading | None = None  # what the places of its session are compared by; None: not known
    lubricated: bool = False  # since the feature before it, as somebody said
    damping_ratio: float | None = None  # of the mode [-]
    residue: float | None = None  # its magnitude [m/(N·m·s²) or m/(N·s²)]


#: Conditions of the baseline that are remembered: more places are hardly visited by one axis.
MOST_CONDITIONS = 40


def advance_feature(
    state: AxisState, charted: ChartedFeature, *, calibration: Calibration | None, design: DetectorDesign
) -> AxisState:
    """Carry the state of an axis over one preload feature.

    A state is the fold of this function over the measurements in the order of their time: what arrives late is put in
    by folding again from there. A session whose places contradict each other is in doubt from the measurement on that
    shows it.
    """
    conditions = charted.conditions
    if conditions.preload is not None:
        return state
    learning = state.detector.known is None
    if calibration is not None:
        value, systematic = charted.feature.value, 0.0
        if not learning:
            systematic = systematic_uncertainty_between(value, conditions, state.baseline_conditions, calibration)
    else:
        state, value, systematic = _by_own_law(state, charted)
    places, since = _places_with(state, charted)
    observation = Observation(
        charted.at,
        value,
        charted.feature.standard_uncertainty,
        systematic,
        temperature=conditions.temperature,
        friction_torque=charted.friction_torque,
        in_doubt=charted.in_doubt or places.disagreement is not None,
        lubricated=charted.lubricated,
    )
    together = _numbers_of(charted, observation, calibration)
    if not _numbers_compare(state, charted, value, calibration):
        together = replace(together, values={})
    detector = step(state.detector, observation, design)
    remembered = (*state.baseline_conditions, conditions)[-MOST_CONDITIONS:]
    return replace(
        state,
        detector=detector,
        baseline_conditions=remembered if learning else state.baseline_conditions,
        places=places,
        places_since=since,
        # what a law that is still being learnt makes of it is no number to learn from
        joint=state.joint if state.sums else joint_step(state.joint, together, design, _ways(calibration)),
        sums=() if detector.known is not None else state.sums,
        drive=None if detector.known is not None else state.drive,
    )


#: Numbers together are compared where they may be off by less than so much of their scatter: at 95 %, what lasts and is
#: larger is evidence of a change within some sixty sessions.
SMALL_BESIDE_SCATTER = 0.5


def _numbers_compare(state: AxisState, charted: ChartedFeature, value: float, calibration: Calibration | None) -> bool:
    """Tell whether numbers together can be compared with those of the baseline, at this place and with this payload.

    What calibration or law leave open between them is the same in all sessions there: where it is not small beside the
    scatter, it would be taken for a change that lasts. Friction torque, of which nothing is known beforehand, goes with
    the rest. What temperature does is learnt with the numbers, and not counted.
    """
    baseline = state.detector.baseline
    if baseline is None or state.detector.known is None:
        return True
    alike = next((each.temperature for each in state.baseline_conditions), None)
    here, *seen = (replace(each, temperature=alike) for each in (charted.conditions, *state.baseline_conditions))
    if calibration is None:
        left_open = [(0.0 if state.law is None else state.law.uncertainty_between(here, seen), baseline.scatter)]
    else:
        left_open = [(systematic_uncertainty_between(value, here, seen, calibration), baseline.scatter)]
        setting, *settings = (calibration.setting(each, calibration.preload.upper) for each in (here, *seen))
        witnesses = [witness for witness in calibration.witnesses if witness.name in WITNESSED]
        left_open += [(each.uncertainty_between(setting, settings), each.scatter) for each in witnesses]
    return all(DEAD_ZONE * each <= SMALL_BESIDE_SCATTER * scatter for each, scatter in left_open)


#: Numbers of a measurement that are watched together, and which way each goes as preload is lost.
WATCHED_TOGETHER = {"frequency": LossDirection.FALL, "friction-torque": LossDirection.FALL}
#: These, too, where a calibration tells what place, payload and temperature do to them.
WITNESSED = (WitnessName.DAMPING_RATIO, WitnessName.RESIDUE)


def _ways(calibration: Calibration | None) -> dict[str, LossDirection]:
    """Return which way numbers go as preload is lost, as far as that is known: of some the calibration may have it."""
    ways = dict(WATCHED_TOGETHER)
    if calibration is None:
        return ways
    setting = Setting(0.5 * (calibration.position.lower + calibration.position.upper), calibration.preload.upper)
    for witness in calibration.witnesses:
        rises = witness.rises_with_preload(setting) if witness.name in WITNESSED else None
        if rises is not None:
            ways[str(witness.name)] = LossDirection.FALL if rises else LossDirection.RISE
    return ways


def _numbers_of(charted: ChartedFeature, observation: Observation, calibration: Calibration | None) -> JointObservation:
    """Return the logarithms of what a measurement is watched by; the frequency is that at one place of the axis.

    Without a calibration the mean conditions of the baseline, else the middle of the travel: a preload feature alone is
    a small part of 1/f², and would change many times as much. Damping and residue are counted from what the calibration
    lets expect where and as it was measured, at one preload.
    """
    inverse = observation.value
    if calibration is not None:
        middle = 0.5 * (calibration.position.lower + calibration.position.upper)
        inverse += float(position_part(middle, calibration.coefficients))
    numbers = {"frequency": -0.5 * math.log(inverse)} if inverse > 0.0 else {}
    if charted.friction_torque is not None and charted.friction_torque > 0.0:
        numbers["friction-torque"] = math.log(charted.friction_torque)
    if calibration is not None and calibration.position.covers(charted.conditions.position):
        setting = calibration.setting(charted.conditions, calibration.preload.upper)
        for name, value in zip(WITNESSED, (charted.damping_ratio, charted.residue), strict=True):
            witness = calibration.witness(name)
            if witness is not None and value is not None and value > 0.0:
                numbers[str(name)] = witness.deviation(value, setting).logarithm
    return JointObservation(charted.at, numbers, observation.temperature, observation.in_doubt, observation.lubricated)


def _by_own_law(state: AxisState, charted: ChartedFeature) -> tuple[AxisState, float, float]:
    """Bring 1/f² to the mean conditions of the baseline; return it with what the law leaves open, both in s².

    While the baseline is learnt for the first time, so is the law: with each measurement all sessions so far are
    brought to their mean conditions anew. Then it stands, as long as what was learnt does.
    """
    feature, conditions, detector = charted.feature, charted.conditions, state.detector
    law = state.law
    if law is None or (state.sums and detector.alarm is None):  # of one that falls nothing more is learnt
        sums, variance = state.sums, feature.standard_uncertainty**2
        goes_on = detector.session is not None and detector.session.takes(charted.at)
        of_session = sums[-1] if goes_on and sums else SessionSums()
        before = sums[:-1] if goes_on else sums
        sums = (*before, of_session.with_measurement(feature.value, variance, conditions))
        law = learn_law(sums, state.drive)
        sessions = [*detector.learning, *([] if detector.session is None else [detector.session])]
        brought = [_brought(session, law, each) for session, each in zip(sessions, state.sums, strict=True)]
        session = brought.pop() if detector.session is not None else None
        state = replace(state, law=law, sums=sums, detector=replace(detector, learning=tuple(brought), session=session))
    systematic = 0.0
    if state.detector.known is not None:
        systematic = law.uncertainty_between(conditions, state.baseline_conditions)
    return state, feature.value - law.shift(conditions), systematic


def _brought(session: Session, law: ConditionLaw, sums: SessionSums) -> Session:
    value, squares = law.at_reference(sums)
    return replace(session, value=value, squares=squares)


def expected_frequency(state: AxisState, conditions: Conditions) -> Estimate | None:
    """Return the frequency that one more session of the healthy axis would show, without a calibration [Hz].

    Its standard uncertainty holds the scatter between sessions, the level and the law, enlarged so that 1.96 times it
    covers 95 %. ``None`` as long as the baseline is learnt, or where the law gives no frequency.
    """
    baseline, law = state.detector.baseline, state.law
    if baseline is None or law is None:
        return None
    feature = baseline.mean + law.shift(conditions)
    if not feature > 0.0:
        return None
    few = enlargement(baseline.degrees_of_freedom)
    of_law = law.uncertainty_between(conditions, state.baseline_conditions)
    scatter = few * math.hypot(baseline.scatter, baseline.standard_uncertainty, of_law)
    return Estimate(feature**-0.5, 0.5 * scatter * feature**-1.5)


def charts_see(state: AxisState, conditions: Conditions) -> bool:
    """Tell whether charts without a calibration can see a loss under some conditions.

    They cannot where what the law of the axis leaves open is as large as a loss that alarms at once: at places or
    payloads that its baseline has not seen, and nothing else tells of.
    """
    baseline = state.detector.baseline
    if state.law is None or baseline is None:
        return True
    open_to = DEAD_ZONE * state.law.uncertainty_between(conditions, state.baseline_conditions)
    return open_to <= SUDDEN_LIMIT * baseline.scatter


#: What the sessions of an axis have in common lasts so long: a mounting, a lubrication.
LASTING = timedelta(days=30)
#: A structure has followed what its thermometer said so long ago.
FOLLOWED = timedelta(days=7)


def scatter_with_history(
    state: AxisState,
    at: datetime,
    conditions: Conditions,
    declared: float,
    calibration: Calibration,
    *,
    amplification: float,
) -> float | None:
    """Return the scatter between sessions that an axis in this state is known to have, ``None`` before a baseline.

    ``declared`` is what the budget of its next measurement allows for, both as standard deviations of the feature [s²],
    ``amplification`` that of :func:`friction_amplification` where its friction torque is known, else 1.
    Of a temperature, the structure lags behind what has changed since the session before, not behind its distance from
    the calibration's. What the sessions have shown is pooled with the declared. A mounting or a lubrication lasts for a
    month: a small scatter counts by the months that have shown it, a large one by the sessions.
    """
    detector = state.detector
    if detector.baseline is None or detector.learnt is None:
        return None
    baseline, before = detector.baseline, detector.learnt.latest_temperature
    variance = declared**2
    if conditions.temperature is not None and before is not None and at - detector.learnt.last_at < FOLLOWED:
        _, excess = calibration.excess(conditions)
        changed = min(abs(conditions.temperature - before), abs(excess))
        k_t = amplification * calibration.influence.temperature
        variance -= k_t**2 * (lagging(excess) ** 2 - lagging(changed, THERMOMETER_OFFSET) ** 2)
    known = math.sqrt(max(variance, 0.0))
    months = (baseline.ended_at - baseline.started_at) / LASTING
    dof = baseline.degrees_of_freedom if baseline.scatter > known else min(months, baseline.degrees_of_freedom)
    return with_history(known, baseline.scatter, dof)


def _places_with(state: AxisState, charted: ChartedFeature) -> tuple[Places, datetime]:
    """Return the places of the session that a feature belongs to, and when it began."""
    since = state.places_since
    goes_on = since is not None and charted.at - since < SESSION
    places = state.places if goes_on else Places()
    if charted.place is not None:
        places = places.with_reading(charted.place)
    return places, since if since is not None and goes_on else charted.at


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
