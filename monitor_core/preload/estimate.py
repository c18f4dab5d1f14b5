"""Estimate the preload in newtons with a 95 % coverage interval and its budget, step by step, or refuse to answer."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from monitor_core.errors import OutsideValidityError
from monitor_core.preload.budget import (
    FrictionExcess,
    UncertaintyBudget,
    VarianceShares,
    joint_budget,
    joint_weights,
    systematic_uncertainty_between,
    uncertainty_budget,
)
from monitor_core.preload.calibration import INVERSE_MOVING_MASS, TEMPERATURE_COEFFICIENT, Calibration, ValidRange
from monitor_core.preload.doubts import (
    ONE_PLACE,
    TEST_LEVEL,
    PlaceReading,
    at_uncertain_preload,
    contradiction,
    deviations_of,
    doubts_of,
    preload_risen,
)
from monitor_core.preload.feature import (
    TEMPERATURE_RESOLUTION,
    payload_factor,
    position_part,
    preload_from_feature,
    to_reference,
)
from monitor_core.preload.witnesses import Deviation, Setting, WitnessName, WitnessValues
from monitor_core.recording import (
    Conditions,
    Doubt,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    ResponseQuantity,
)
from monitor_core.uncertainty import Estimate, Interval, IntervalKind

LEVEL = 0.95
#: A position outside by this share of the calibrated travel still counts as inside: encoders do not repeat exactly.
POSITION_MARGIN = 0.01
#: A place farther off the calibrated travel than this is long, and farther than this, is none of the axis [m].
_FAR_OFF = 1.0
#: Steps of the fixed point for the friction at the estimated preload; each makes the error smaller tenfold or so.
_FRICTION_STEPS = 12
#: A step shorter than this share of the feature ends them: three parts in a million of a preload.
_FRICTION_SETTLED = 1e-6
#: Beyond so many times the highest calibrated preload the usual friction is not carried on.
_MOST_PRELOAD = 1.5
#: Of the temperature coefficient, by how much one place differs from another: it is one for all (standard uncertainty,
#: declared; by finite elements 4 % on two axes).
_TEMPERATURE_BY_PLACE = 0.05
#: A correction for friction leaves at least this share of the feature.
_LEAST_FEATURE = 0.1


@dataclass(frozen=True, slots=True)
class IfStated:
    """The interval as it would be if something were stated that is not."""

    quantities: tuple[str, ...]
    interval: Interval


@dataclass(frozen=True, slots=True)
class PreloadEstimate:
    """Preload of one measurement and what it rests on."""

    preload: float  # [N]
    interval: Interval  # coverage, asymmetric [N]; the upper end is infinite where no preload is too high to fit
    feature: Estimate  # preload feature at the reference conditions, all known uncertainties included [s²]
    feature_own_uncertainty: float  # of it, what is new with this frequency [s²]
    feature_systematic_uncertainty: float  # of it, what all measurements share [s²]
    feature_scatter: float  # of it, what the sessions of an axis show by their scatter [s²]
    shares: VarianceShares
    if_stated: tuple[IfStated, ...]  # what would narrow the interval
    outside: tuple[str, ...]  # position, preload, payload, temperature: those outside the calibrated range
    assumptions: tuple[str, ...]  # what was not stated, and what was taken instead
    doubts: tuple[Doubt, ...] = ()  # what else the windows hold, and speaks against the number
    deviations: Mapping[WitnessName, Deviation] = field(default_factory=dict)  # from what the calibration lets expect
    budget: UncertaintyBudget | None = field(default=None, compare=False, repr=False)  # behind feature and shares

    def with_doubts(self, doubts: Sequence[Doubt]) -> "PreloadEstimate":
        """Add doubts; of one reason the first is kept."""
        by_reason = {doubt.reason: doubt for doubt in (*reversed(doubts), *reversed(self.doubts))}
        return replace(self, doubts=tuple(reversed(by_reason.values())))

    @property
    def extrapolated(self) -> bool:
        """Whether anything lies outside the range that the calibration has seen."""
        return bool(self.outside)


def estimate_preload(
    frequency: Estimate,
    conditions: Conditions,
    calibration: Calibration,
    *,
    excitation_source: ExcitationSource | None = None,
    excitation_quantity: ExcitationQuantity | None = None,
    response_quantity: ResponseQuantity | None = None,
    witnesses: WitnessValues | None = None,
    random_uncertainty: float | None = None,
) -> PreloadEstimate | Rejection:
    r"""Estimate the preload from an axial natural frequency, with its asymmetric 95 % coverage interval.

    Eq. (8) of [1]_ gives :math:`\theta = \mathrm{preload}^{-1/3} = g/k_3` from the feature g, a ratio of two uncertain
    and correlated numbers. The interval holds every θ that the data do not contradict (Fieller's theorem [2]_),

    .. math:: (g - \theta k_3)^2 \le t^2\,\bigl(u^2 + a(\theta)^T C\,a(\theta)\bigr)

    with u the random part (stated uncertainty and reproducibility), C the joint covariance of the calibration and a(θ)
    the gradient of :math:`g - \theta k_3`; t from the effective degrees of freedom (Welch–Satterthwaite). Translated by
    :math:`\mathrm{preload} = \theta^{-3}` it is wider upwards than downwards.

    The frequency is in hertz. A payload or temperature that is not stated is taken as the reference, and the result
    says so; excitation and response of the measurement are ``None`` where a table of frequencies does not tell.
    ``random_uncertainty`` is what is new in each measurement of the frequency's uncertainty, all of it where it is not
    given: errors of the model stay as they are, and the charts do not wait for them to scatter. A frequency is refused
    if excitation or response are not the calibration's, if its place is far off the calibrated travel, if a payload
    cannot be corrected, or if it is above what any preload gives; ``OutsideValidityError`` if it is not positive. The
    upper end of the interval is ``inf`` where no preload is too high to agree with the data (write ``null`` where a
    format has no infinity); the lower end is 0 where nothing is known.

    Examples
    --------
    Calibrated on Table 2 of [1]_, its reading at 200 N and 500 mm, 178.724 Hz (mean of 20), is read as 220 N with a
    95 % interval of 184 to 266 N: the scatter of the table about Eq. (8), 0.25 Hz, at some 65 N/Hz. Calibrated on
    readings that lie on Eq. (8) with the k1…k4 of its Table 3, 200 N are read as 200 N:

    >>> import monitor_core as mc
    >>> def by_table_3(x, preload):
    ...     return 1e4 * (-4872 * x**2 + 5561 * x + 2097 * preload ** (-1 / 3) + 1228) ** -0.5
    >>> readings = [
    ...     mc.ModalReading(by_table_3(x, preload), mc.Conditions(x, preload=preload))
    ...     for x in (0.25, 0.5, 0.75)
    ...     for preload in (100.0, 200.0, 300.0)
    ... ]
    >>> calibration = mc.calibrate(readings, weighting="none", excitation_source=None)
    >>> measured = mc.Estimate(by_table_3(0.4, 200.0), standard_uncertainty=0.1)
    >>> estimate = mc.estimate_preload(measured, mc.Conditions(0.4), calibration)
    >>> f"{estimate.preload:.1f} N, {estimate.interval.lower:.0f} to {estimate.interval.upper:.0f} N"
    '200.0 N, 189 to 211 N'

    References
    ----------
    .. [1] T. L. Nguyen et al., J. Korean Soc. Precis. Eng., 2018.
    .. [2] E. C. Fieller, J. R. Stat. Soc. B 16 (1954) 175.
    """
    if not frequency.value > 0.0:
        raise OutsideValidityError(f"frequency must be positive; got {frequency.value} Hz")
    refusal = (
        refuse_other_channels(calibration, excitation_source, excitation_quantity, response_quantity)
        or _refuse_place(conditions.position, calibration.position)
        or _refuse_payload(conditions, calibration)
    )
    if refusal is not None:
        return refusal
    at_reference = to_reference(frequency.value**-2.0, *calibration.excess(conditions), calibration.influence)
    feature = float(at_reference - position_part(conditions.position, calibration.coefficients))
    if feature <= 0.0:
        return Rejection(
            RejectionReason.OUTSIDE_CALIBRATION,
            f"the preload feature must be positive; got {feature:.3g} s²: {frequency.value:.2f} Hz is above what any "
            f"preload gives at {conditions.position * 1e3:.0f} mm",
        )
    corrected = without_friction_excess(feature, conditions, calibration, witnesses or {})
    feature = corrected.feature
    setting = calibration.setting(conditions, preload_from_feature(feature, calibration.coefficients))
    deviations = deviations_of(witnesses or {}, setting, calibration)
    budget = uncertainty_budget(
        frequency,
        feature,
        conditions,
        calibration,
        friction=_friction_excess(corrected, deviations.get(WitnessName.NOISE_LEVEL)),
        mass=deviations.get(WitnessName.RESIDUE),
        amplification=corrected.amplification,
    )
    # nearly dependent coefficients leave a variance a little below zero, by rounding
    systematic = max(0.0, float(budget.gradient @ calibration.parameters.covariance @ budget.gradient))
    preload = preload_from_feature(feature, calibration.coefficients)
    # of the preload, (k3/g)³, but for a mass that nobody states: the witnesses are what speaks of it
    of_mass = budget.shares.payload if conditions.payload_mass is None else 0.0
    relative = 3.0 * math.sqrt((budget.random + systematic) * max(1.0 - of_mass, 0.0)) / feature
    deviations = at_uncertain_preload(deviations, setting, calibration, relative)
    stated = {name: d for name, d in deviations.items() if not _unstated_mass(name, conditions)}
    if (refusal := contradiction(stated, calibration)) is not None:
        return refusal
    stated_feature = Estimate(feature, math.sqrt(budget.random + systematic), budget.degrees_of_freedom)
    interval = _fieller_interval(feature, calibration, budget)
    return PreloadEstimate(
        preload=preload,
        interval=interval,
        feature=stated_feature,
        feature_own_uncertainty=math.sqrt(budget.frequency) * new_each_time(frequency, random_uncertainty),
        feature_systematic_uncertainty=math.sqrt(systematic),
        feature_scatter=math.sqrt(budget.shown),
        shares=budget.shares,
        if_stated=_if_stated(feature, calibration, budget),
        outside=_outside(interval, conditions, calibration),
        assumptions=_assumptions(conditions, calibration, excitation_source),
        doubts=(*doubts_of(deviations, calibration), *_risen(stated_feature, conditions, calibration)),
        deviations=deviations,
        budget=budget,
    )


@dataclass(frozen=True, slots=True)
class SessionPreload:
    """The one preload of an axis by all measurements of a session."""

    preload: float  # [N]
    interval: Interval  # as of :class:`PreloadEstimate`
    shares: VarianceShares
    if_stated: tuple[IfStated, ...]  # what would narrow the interval
    weights: tuple[float, ...]  # of the measurements, in their order; they add up to 1
    positions: tuple[float, ...]  # of the measurements [m]


def session_preload(
    estimates: Sequence[PreloadEstimate], positions: Sequence[float], calibration: Calibration
) -> SessionPreload | None:
    """Join the measurements of one session, of one preload, at their positions [m]; ``None`` of fewer than two.

    The mean of the features, weighted by the information of each (:func:`~monitor_core.preload.budget.joint_weights`),
    with the interval of :func:`estimate_preload` for the budget that it has: what the measurements share is not
    averaged away (:func:`~monitor_core.preload.budget.joint_budget`).
    """
    budgets = [estimate.budget for estimate in estimates if estimate.budget is not None]
    if len(budgets) < max(len(estimates), 2):
        return None
    places = np.array(positions)
    is_one_place = np.abs(places[:, None] - places) < ONE_PLACE
    own = np.array([estimate.feature_own_uncertainty for estimate in estimates])
    own_shares = np.minimum(own / np.sqrt([max(budget.frequency, 1e-300) for budget in budgets]), 1.0)
    scatter = np.sqrt([budget.reproducibility for budget in budgets])
    if not np.all(np.hypot(own, scatter) > 0.0):  # they state no uncertainty to be weighted by
        return None
    weights = joint_weights(own, scatter, is_one_place)
    feature = float(weights @ [estimate.feature.value for estimate in estimates])
    budget = joint_budget(
        feature,
        budgets,
        weights=weights,
        own_shares=own_shares,
        is_one_place=is_one_place,
        calibration=calibration,
    )
    return SessionPreload(
        preload_from_feature(feature, calibration.coefficients),
        _fieller_interval(feature, calibration, budget),
        budget.shares,
        _if_stated(feature, calibration, budget),
        tuple(weights.tolist()),
        tuple(positions),
    )


def _if_stated(feature: float, calibration: Calibration, budget: UncertaintyBudget) -> tuple[IfStated, ...]:
    return tuple(
        IfStated(names, _fieller_interval(feature, calibration, budget.with_stated(names)))
        for names in _one_by_one_and_all(budget.unstated)
    )


def _one_by_one_and_all(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [(name,) for name in names] + [names] * (len(names) > 1)


def _unstated_mass(name: WitnessName, conditions: Conditions) -> bool:
    """Tell whether a witness speaks of a mass that nobody has stated: it contradicts nothing, and widens."""
    return name is WitnessName.RESIDUE and conditions.payload_mass is None


@dataclass(frozen=True, slots=True)
class WithoutFriction:
    """A preload feature at the usual friction."""

    feature: float  # [s²]
    friction_excess: float | None  # above what the calibration lets expect at the estimated preload [N·m]
    usual_friction: float  # which that is [N·m]
    amplification: float  # of an error of 1/f² [-]


def without_friction_excess(
    feature: float, conditions: Conditions, calibration: Calibration, witnesses: WitnessValues
) -> WithoutFriction:
    r"""Solve the preload feature g at the usual friction from the one that was measured.

    .. math:: g + k_F\,\bigl(T_f - \hat T_f(g)\bigr) = g_\mathrm{measured}

    The usual friction follows the preload that is being estimated, so an error of 1/f² grows by
    :math:`(1 - (k_F/k_3)\,d\hat T_f/d\theta)^{-1}`.
    """
    witness, k_f = calibration.witness(WitnessName.FRICTION_TORQUE), calibration.friction
    torque = witnesses.get(WitnessName.FRICTION_TORQUE)
    if witness is None or k_f is None:
        return WithoutFriction(feature, None, 0.0, 1.0)
    if torque is None:
        return WithoutFriction(feature, None, witness.expected(_usual_setting(feature, conditions, calibration)), 1.0)
    at, excess = feature, 0.0
    for _ in range(_FRICTION_STEPS):
        excess = torque - witness.expected(_usual_setting(at, conditions, calibration))
        before, at = at, max(feature - k_f.value * excess, _LEAST_FEATURE * feature)
        if abs(at - before) < _FRICTION_SETTLED * feature:
            break
    return WithoutFriction(at, excess, torque - excess, friction_amplification(at, conditions, calibration))


def friction_amplification(feature: float, conditions: Conditions, calibration: Calibration) -> float:
    """Return by how much an error of 1/f² grows where the friction torque is known, at a preload feature [s²]."""
    witness, k_f = calibration.witness(WitnessName.FRICTION_TORQUE), calibration.friction
    if witness is None or k_f is None:
        return 1.0
    slope = witness.slope_in_theta(_usual_setting(feature, conditions, calibration))
    return 1.0 / max(1.0 - k_f.value * slope / calibration.coefficients.k3, 0.2)


def _usual_setting(feature: float, conditions: Conditions, calibration: Calibration) -> Setting:
    """Return where friction is usual: a preload beyond what is calibrated has no usual friction of its own."""
    estimated, calibrated = preload_from_feature(feature, calibration.coefficients), calibration.preload
    preload = min(max(estimated, calibrated.lower), _MOST_PRELOAD * calibrated.upper)
    return calibration.setting(conditions, preload)


def _risen(feature: Estimate, conditions: Conditions, calibration: Calibration) -> tuple[Doubt, ...]:
    """Return the doubt about a preload above all calibrated ones, unless somebody says to have set it."""
    k3 = calibration.coefficients.k3
    theta = Estimate(feature.value / k3, feature.standard_uncertainty / k3, feature.degrees_of_freedom)
    highest = float(np.cbrt(1.0 / calibration.preload.upper))
    doubt = None if conditions.preload is not None else preload_risen(theta, highest)
    return () if doubt is None else (doubt,)


def _friction_excess(corrected: WithoutFriction, noise: Deviation | None) -> FrictionExcess:
    """Put what friction torque and noise say beside each other.

    What no torque explains around the mode is mostly friction that acts on the table, in the guides, and in proportion
    to it: were bearing and nut to have changed alike, the torque would have changed by the same share.
    """
    usual = corrected.usual_friction
    if noise is None:
        return FrictionExcess(usual, corrected.friction_excess, None)
    unexplained = usual * math.expm1(noise.logarithm)
    uncertainty = (usual + unexplained) * noise.standard_uncertainty
    return FrictionExcess(usual, corrected.friction_excess, Estimate(unexplained, uncertainty))


def place_reading(conditions: Conditions, estimate: PreloadEstimate, calibration: Calibration) -> PlaceReading:
    """Return what a measurement contributes to a comparison of the places of its session.

    What the places share (the day, payload, temperature, friction) does not make them differ: frequency, scatter and
    what the calibration does not know of this place against the middle of its travel count alone, enlarged for the few
    readings that it knows them from; of a temperature, what it does to one place and not to another. ln(preload) is
    three times as uncertain as the feature.
    """
    shares, feature = estimate.shares, estimate.feature
    own = feature.standard_uncertainty * math.sqrt(max(shares.frequency + shares.reproducibility, 0.0))
    _, warmer = calibration.excess(conditions)
    own = math.hypot(own, _TEMPERATURE_BY_PLACE * calibration.influence.temperature * warmer)
    middle = replace(conditions, position=0.5 * (calibration.position.lower + calibration.position.upper))
    of_place = systematic_uncertainty_between(feature.value, conditions, [middle], calibration)
    few = float(scipy.special.stdtrit(feature.degrees_of_freedom, TEST_LEVEL) / scipy.special.ndtri(TEST_LEVEL))
    theta = calibration.coefficients.k3 * float(np.cbrt(1.0 / estimate.preload))
    return PlaceReading(conditions.position, math.log(estimate.preload), 3.0 * few * math.hypot(own, of_place) / theta)


def _fieller_interval(feature: float, calibration: Calibration, budget: UncertaintyBudget) -> Interval:
    """Solve the inequality of Fieller's theorem, a quadratic in θ; a preload of ∞ is θ = 0, of 0 is θ = ∞."""
    covariance = calibration.parameters.covariance
    gradient = budget.gradient
    t2 = float(scipy.special.stdtrit(budget.degrees_of_freedom, 0.5 + LEVEL / 2.0)) ** 2
    k3 = calibration.coefficients.k3
    # quadratic·θ² − 2·linear·θ + constant ≤ 0
    quadratic = k3**2 - t2 * float(covariance[2, 2])
    linear = feature * k3 - t2 * float(covariance[2] @ gradient)
    constant = feature**2 - t2 * (budget.random + float(gradient @ covariance @ gradient))
    if quadratic <= 0.0:  # k3 itself could be zero at this t: every preload agrees with the data
        return Interval(0.0, math.inf, IntervalKind.COVERAGE, LEVEL)
    root = math.sqrt(max(0.0, linear**2 - quadratic * constant))  # ≥ 0: θ = feature/k3 always agrees
    low, high = (linear - root) / quadratic, (linear + root) / quadratic
    return Interval(high**-3.0, low**-3.0 if low > 0.0 else math.inf, IntervalKind.COVERAGE, LEVEL)


def new_each_time(frequency: Estimate, random_uncertainty: float | None) -> float:
    """Return the part of a frequency's standard uncertainty that is new in each measurement [-]."""
    if random_uncertainty is None or frequency.standard_uncertainty == 0.0:
        return 1.0
    return min(random_uncertainty / frequency.standard_uncertainty, 1.0)


def refuse_other_channels(
    calibration: Calibration,
    source: ExcitationSource | None,
    quantity: ExcitationQuantity | None,
    response: ResponseQuantity | None,
) -> Rejection | None:
    """Refuse another excitation, for torque at the screw, motor torque and force see different poles; or response."""
    calibrated = calibration.excitation_quantity
    if quantity is not None and calibrated is not None and quantity != calibrated:
        return Rejection(
            RejectionReason.EXCITATION_SOURCE_MISMATCH,
            f"the calibration holds for a {calibrated} as excitation; got {quantity}",
        )
    if source is not None and source != calibration.excitation_source:
        return Rejection(
            RejectionReason.EXCITATION_SOURCE_MISMATCH,
            f"the calibration is for excitation source {calibration.excitation_source or 'not stated'}; got {source}",
        )
    if None not in (response, calibration.response_quantity) and response != calibration.response_quantity:
        return Rejection(
            RejectionReason.EXCITATION_SOURCE_MISMATCH,
            f"the calibration holds for a {calibration.response_quantity} as response; got {response}",
        )
    return None


def _refuse_place(position: float, calibrated: ValidRange) -> Rejection | None:
    """Refuse a place that Eq. (8) is not carried on to: 2 m for 0.2 m would make a healthy 300 N read about 0 N."""
    lower, upper = calibrated.lower, calibrated.upper
    if calibrated.covers(position, margin=max(upper - lower, _FAR_OFF)):
        return None
    return Rejection(
        RejectionReason.OUTSIDE_CALIBRATION,
        f"expected a position near the calibrated {1e3 * lower:g} to {1e3 * upper:g} mm from the fixed bearing; "
        f"got {1e3 * position:g} mm",
    )


def _refuse_payload(conditions: Conditions, calibration: Calibration) -> Rejection | None:
    """Refuse a payload that cannot be corrected: 1 kg more would make a healthy 300 N read about 100 N."""
    excess, _ = calibration.excess(conditions)
    if excess == 0.0 or INVERSE_MOVING_MASS in calibration.parameter_names:
        return None
    return Rejection(
        RejectionReason.OUTSIDE_CALIBRATION,
        f"payload {conditions.payload_mass:g} kg differs from the calibration's {calibration.reference_payload:g} kg "
        "and its moving mass is not known: calibrate with two payloads, or declare the moving mass",
    )


def _outside(preload: Interval, conditions: Conditions, calibration: Calibration) -> tuple[str, ...]:
    """Name what lies outside the calibrated range; a preload does if nothing of its interval lies inside."""
    travel = calibration.position.upper - calibration.position.lower
    inside = {
        "position": calibration.position.covers(conditions.position, margin=POSITION_MARGIN * travel),
        "preload": preload.lower <= calibration.preload.upper and preload.upper >= calibration.preload.lower,
        "payload": conditions.payload_mass is None
        or INVERSE_MOVING_MASS in calibration.declared  # declared as a law, not within a range
        or calibration.payload.covers(conditions.payload_mass),
        "temperature": conditions.temperature is None
        or calibration.temperature is None
        or calibration.temperature.covers(conditions.temperature, margin=TEMPERATURE_RESOLUTION),
    }
    return tuple(name for name, ok in inside.items() if not ok)


def _assumptions(conditions: Conditions, calibration: Calibration, source: ExcitationSource | None) -> tuple[str, ...]:
    assumed = []
    if source is None and calibration.excitation_source is not None:
        assumed.append(f"excitation source not stated: taken as the calibration's {calibration.excitation_source}")
    if conditions.payload_mass is None and INVERSE_MOVING_MASS in calibration.parameter_names:
        assumed.append(f"payload not stated: taken as the calibration's {calibration.reference_payload:g} kg")
    if calibration.reference_temperature is not None and conditions.temperature is None:
        assumed.append(f"temperature not stated: taken as the calibration's {calibration.reference_temperature:.1f} °C")
    if conditions.temperature is not None and calibration.reference_temperature is None:
        assumed.append("temperature stated but not corrected: the calibration states none")
    elif TEMPERATURE_COEFFICIENT in calibration.declared:
        _, excess = calibration.excess(conditions)
        if abs(excess) > TEMPERATURE_RESOLUTION:
            assumed.append(
                f"temperature {excess:+.1f} K from the calibration's, which has seen one only: widened for it"
            )
    return tuple(assumed)


@dataclass(frozen=True, slots=True)
class PreloadLadder:
    r"""The terms between a frequency and its preload.

    .. math:: g = \frac{1}{f^2} - \text{payload} - \text{temperature} - k_1 x^2 - k_2 x - k_4 - \text{friction},
        \qquad \mathrm{preload} = (k_3 / g)^3

    Eq. (8) of Nguyen et al. (2018), with the corrections of :mod:`monitor_core.preload.feature` before it.
    """

    frequency: float  # [Hz]
    inverse_square: float  # 1/f² as measured [s²]
    payload: float  # what a payload other than the calibration's adds to 1/f² [s²]
    temperature: float  # what a temperature other than the calibration's adds [s²]
    quadratic: float  # k1·x² [s²]
    linear: float  # k2·x [s²]
    constant: float  # k4 [s²]
    friction: float  # what friction other than the usual adds [s²]
    feature: float  # what is left: of the preload alone [s²]
    preload: float  # [N]

    @property
    def position(self) -> float:
        """What the position explains of 1/f²: k1·x² + k2·x + k4 [s²]."""
        return self.quadratic + self.linear + self.constant


def preload_ladder(
    frequency: float, conditions: Conditions, calibration: Calibration, *, feature: float | None = None
) -> PreloadLadder:
    """Return the terms between an axial natural frequency [Hz] and its preload.

    ``feature`` is the preload feature of the estimate that is explained [s²]: what it lacks to the other terms is the
    correction for friction. Without it the friction is taken as the usual. Raises ``OutsideValidityError`` where no
    preload gives the frequency.
    """
    k, x = calibration.coefficients, conditions.position
    payload_excess, temperature_excess = calibration.excess(conditions)
    inverse_square = frequency**-2.0
    factor = float(payload_factor(payload_excess, calibration.influence.inverse_moving_mass))
    payload = inverse_square - inverse_square / factor
    temperature = calibration.influence.temperature * temperature_excess
    at_usual = inverse_square - payload - temperature - float(position_part(x, k))
    left = at_usual if feature is None else feature
    return PreloadLadder(
        frequency=frequency,
        inverse_square=inverse_square,
        payload=payload,
        temperature=temperature,
        quadratic=k.k1 * x**2,
        linear=k.k2 * x,
        constant=k.k4,
        friction=at_usual - left,
        feature=left,
        preload=preload_from_feature(left, k),
    )
