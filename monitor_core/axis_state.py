"""Carry the state of an axis over its measurements: baseline, charts and alarm, from preload features in time order."""

import math
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

from monitor_core.pipeline import MeasurementOutcome
from monitor_core.preload import (
    Calibration,
    ConditionLaw,
    DriveLaw,
    PreloadEstimate,
    SessionSums,
    learn_law,
    systematic_uncertainty_between,
    with_history,
)
from monitor_core.preload.budget import THERMOMETER_OFFSET, lagging
from monitor_core.preload.doubts import PlaceReading, Places
from monitor_core.preload.estimate import new_each_time, place_reading
from monitor_core.preload.feature import position_part
from monitor_core.preload.witnesses import Setting, WitnessName
from monitor_core.recording import Conditions, Rejection
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
