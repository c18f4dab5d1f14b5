"""Compute the uncertainty budget of the preload feature: errors new in each measurement, and errors all share.

All functions raise ``OutsideValidityError`` if a payload is below the reference by more than the moving mass.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.preload.calibration import (
    COEFFICIENT_NAMES,
    INVERSE_MOVING_MASS,
    TEMPERATURE_COEFFICIENT,
    Calibration,
)
from monitor_core.preload.feature import (
    UNKNOWN_TEMPERATURE_COEFFICIENT,
    USUAL_FRICTION_SHARE,
    correction_sensitivities,
    from_reference,
    position_part,
)
from monitor_core.preload.witnesses import Deviation
from monitor_core.recording import Conditions
from monitor_core.uncertainty import Estimate, Interval, beyond_others, enlargement

#: One number or many.
Real = TypeVar("Real", float, FloatArray)

Of = TypeVar("Of")


@dataclass(frozen=True, slots=True, kw_only=True)
class OfInfluences(Generic[Of]):
    """One entry for each influence quantity of a frequency: a record that forgets one does not type-check."""

    temperature: Of  # of the structure
    payload: Of
    position: Of
    friction: Of  # torque beyond the usual, and where it acts
    lubrication: Of  # where no window shows the friction
    between_session: Of  # how the nut is mounted, and what else another day changes
    direction: Of  # of the moves
    speed: Of
    excitation_level: Of
    sensor_gain: Of

    @property
    def by_name(self) -> dict[str, Of]:
        """The entries by the names of their quantities."""
        return {name: getattr(self, name) for name in OfInfluences.__slots__}


#: The quantities whose changes the sessions of an axis show by their scatter: a payload is another one in every
#: session, or the same in all.
SHOWN_BY_SESSIONS = tuple(name for name in OfInfluences.__slots__ if name != "payload")


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceShares(OfInfluences[float]):
    """Where the variance of the preload, as θ = preload^(−1/3), comes from; the shares add up to 1.

    Covariances between the sources are split evenly, so a source that compensates another may have a negative share.
    Payload and temperature are with µ and k_T.
    """

    frequency: float  # stated uncertainty of this frequency
    reproducibility: float  # scatter between measurements beyond it
    calibration: float  # k1…k4


#: Share of a temperature's distance from the calibration's by which the structure lags behind it (standard uncertainty,
#: declared): a thermometer in the air leads by much of it.
TEMPERATURE_LAG = 0.45
#: Of a thermometer as the temperature of what stretches, wherever it reads (standard uncertainty, declared): an offset
#: of 1 K, and as much by which the structure still follows yesterday's air [K].
THERMOMETER = 1.5
#: Of it, the offset: it is there in every session [K].
THERMOMETER_OFFSET = 1.0
#: A temperature that nobody states lies within so much of the calibration's, or within what the calibration has seen
#: (uniform, declared): a hall without air conditioning is 13 to 31 °C in the course of a year [K].
UNSTATED_TEMPERATURE = 9.0
#: Of a correction for friction, the standard uncertainty by where the friction acts: in the guides it moves the mode by
#: two to three times as much as in bearing and nut, and a calibration has hardly seen the one without the other
#: (declared).
FRICTION_SHARE = 1.0
#: The same where the noise around the mode speaks for the guides, and how far it disagrees with the friction torque
#: counts by itself (declared): above the usual, and below, where noise from elsewhere hides what guides no longer make.
WITNESSED_FRICTION_SHARE = 0.25
WITNESSED_FRICTION_SHARE_BELOW = 0.5
#: Of a friction torque that the windows do not show, between lubrications, relative (standard uncertainty, declared).
UNSEEN_FRICTION = 0.3
#: Of a stated position, standard uncertainty: home switch, mounting of the scale, where the table was said to be [m].
POSITION_TAG = 2e-3
#: Of what another day changes, the part that has lasted since the calibration: a mounting.
LASTING_MOUNTING = 0.5
#: Of a declared standard uncertainty: it is known to a quarter of itself (GUM, G.4.2) [-].
DECLARED_DEGREES_OF_FREEDOM = 8.0
#: A payload that nobody states, where neither payloads of the calibration nor the residue tell, of what moves (uniform,
#: declared) [-].
UNSTATED_PAYLOAD = 0.05
#: Of the logarithm of the largest calibrated payload's factor on 1/f², half way to it: 1/f² bends with the mass, and
#: few payloads show how (declared).
PAYLOAD_BEND = 0.01
#: Of the logarithm of the payload's factor on 1/f², per calibrated payload by which it lies beyond (declared).
PAYLOAD_EXTRAPOLATION = 0.1


@dataclass(frozen=True, slots=True)
class FrictionExcess:
    """Friction beyond the usual, as two witnesses tell it."""

    usual: float  # friction torque that the calibration lets expect [N·m]
    torque: float | None  # above it; None: the windows do not show it [N·m]
    unexplained: Estimate | None  # the same, were all to have grown as the noise around the mode; None: not known


#: No window, no friction torque.
NOT_SEEN = FrictionExcess(0.0, None, None)


@dataclass(frozen=True, slots=True)
class Influence:
    """What an influence quantity does to 1/f² at the reference conditions, and how well it is known."""

    sensitivity: float  # [s² per unit of the quantity]
    uncertainty: float  # standard, of the quantity as it is stated, or as it may be where nobody states it
    were_it_stated: float | None = None  # the same, were it stated; None: it is, or it cannot be
    lasting: float = 0.0  # of the uncertainty, what has been the same since the calibration: no later session shows it

    @property
    def variance(self) -> float:
        """Of 1/f² [s⁴]."""
        return (self.sensitivity * self.uncertainty) ** 2

    @property
    def shown(self) -> float:
        """Of the variance, what the sessions of an axis show by their scatter [s⁴]."""
        return self.sensitivity**2 * max(self.uncertainty**2 - self.lasting**2, 0.0)


#: A quantity that a frequency does not follow, or not beyond what its readings scatter by.
_NONE = Influence(0.0, 0.0)


def influences_of(
    inverse_square: float,
    conditions: Conditions,
    calibration: Calibration,
    *,
    friction: FrictionExcess = NOT_SEEN,
    mass: Deviation | None = None,
    amplification: float = 1.0,
) -> OfInfluences[Influence]:
    """Return what may have moved a measured 1/f² [s²] since the calibration, besides the preload.

    ``mass`` is how the residue differs from what the calibration lets expect, ``None`` where it is not known: of a
    payload that is not stated it tells how large it is. ``amplification`` is by how much an error of 1/f² grows where
    the correction for friction follows the preload that is estimated.

    What no session of calibration can show is declared (GUM, type B). Readings from as many days as later measurements
    have it in their scatter, except what was stated of them and is not stated now.
    """
    payload, temperature = calibration.excess(conditions)
    factor = float(correction_sensitivities(inverse_square, payload, temperature, calibration.influence).inverse_square)
    at_reference = amplification * factor * inverse_square
    of_days = 1.0 if calibration.between_sessions > 0.0 else 0.0
    k, k_f = calibration.coefficients, calibration.friction
    return OfInfluences(
        temperature=_temperature(conditions, calibration, inverse_square, amplification, of_days),
        payload=Influence(at_reference, *_payload(conditions, calibration, mass, of_days)),
        position=Influence(
            amplification * (2.0 * k.k1 * conditions.position + k.k2), of_days * POSITION_TAG, lasting=POSITION_TAG
        ),
        friction=Influence(amplification, of_days * _friction(k_f, friction)),
        lubrication=Influence(amplification, of_days * _unseen_friction(k_f, friction, inverse_square)),
        between_session=Influence(
            2.0 * at_reference, calibration.between_sessions, lasting=LASTING_MOUNTING * calibration.between_sessions
        ),
        # moves both ways, at the speed and the level of the axis, are in the scatter of the readings; what others do
        # is friction, and their witnesses doubt it
        direction=_NONE,
        speed=_NONE,
        excitation_level=_NONE,
        sensor_gain=_NONE,
    )


def lagging(change: float, thermometer: float = THERMOMETER) -> float:
    """Return the standard uncertainty of the temperature of a structure that follows a change, all in kelvin.

    The change is that from the calibration's temperature, unless a later one is known that the structure had.
    """
    return math.hypot(thermometer, TEMPERATURE_LAG * change)


def _temperature(
    conditions: Conditions, calibration: Calibration, inverse_square: float, amplification: float, of_days: float
) -> Influence:
    k_t, seen = calibration.parameter(TEMPERATURE_COEFFICIENT), calibration.temperature
    if k_t is None or seen is None:  # nothing is corrected, whatever is stated
        spread = of_days * UNSTATED_TEMPERATURE / 3.0**0.5
        return Influence(amplification * UNKNOWN_TEMPERATURE_COEFFICIENT * inverse_square, spread, lasting=spread)
    sensitivity = amplification * math.hypot(k_t.value, k_t.standard_uncertainty)
    _, excess = calibration.excess(conditions)
    if conditions.temperature is not None:
        return Influence(amplification * abs(k_t.value), of_days * lagging(excess), lasting=THERMOMETER_OFFSET)
    spread = max(UNSTATED_TEMPERATURE, 0.5 * (seen.upper - seen.lower)) / 3.0**0.5
    stated = of_days * lagging(spread)
    not_stated = math.hypot(spread, of_days * THERMOMETER)
    # seasons are learnt as such, and do not show in the scatter
    return Influence(sensitivity, not_stated, stated, lasting=not_stated)


def _payload(
    conditions: Conditions, calibration: Calibration, mass: Deviation | None, of_days: float
) -> tuple[float, float | None]:
    """Return the standard uncertainty of the logarithm of the payload's factor on 1/f², and were it stated [-]."""
    mu = calibration.influence.inverse_moving_mass
    largest = calibration.payload.upper - calibration.reference_payload
    if conditions.payload_mass is None:
        # the residue is a reciprocal mass: its logarithm falls as that of 1/f² rises
        varies = of_days or calibration.payload_stated
        if mass is not None and (mu > 0.0 or varies):
            return math.hypot(mass.logarithm, mass.standard_uncertainty), 0.0
        if not (mu * largest or varies):
            return 0.0, None  # nor was it for the readings: their scatter has what it does
        return (mu * largest or UNSTATED_PAYLOAD) / math.sqrt(3.0), 0.0
    beyond = max(conditions.payload_mass - calibration.payload.upper, 0.0)
    if mu == 0.0 or INVERSE_MOVING_MASS in calibration.declared or largest == 0.0:
        return 0.0, None
    if beyond == 0.0:
        way = (conditions.payload_mass - calibration.reference_payload) / largest
        return PAYLOAD_BEND * math.log1p(mu * largest) * 4.0 * way * (1.0 - way), None
    return PAYLOAD_EXTRAPOLATION * math.log1p(mu * (largest + beyond)) * beyond / max(largest, beyond), None


def _friction(coefficient: Estimate | None, friction: FrictionExcess) -> float:
    """Return the standard uncertainty of the correction for friction: of its coefficient, and of where it acts [s²]."""
    if coefficient is None or friction.torque is None:
        return 0.0
    of_coefficient = coefficient.standard_uncertainty * friction.torque
    if friction.unexplained is None:
        return math.hypot(of_coefficient, FRICTION_SHARE * coefficient.value * friction.torque)
    # by as much as the two differ by chance alone they do not contradict each other
    apart = max((friction.unexplained.value - friction.torque) ** 2 - friction.unexplained.standard_uncertainty**2, 0.0)
    share = WITNESSED_FRICTION_SHARE if friction.torque > 0.0 else WITNESSED_FRICTION_SHARE_BELOW
    return math.hypot(of_coefficient, coefficient.value * math.hypot(math.sqrt(apart), share * friction.torque))


def _unseen_friction(coefficient: Estimate | None, friction: FrictionExcess, inverse_square: float) -> float:
    """Return the standard uncertainty of 1/f² by a friction that the windows do not show [s²]."""
    if friction.torque is not None:
        return 0.0
    of_usual = USUAL_FRICTION_SHARE * inverse_square
    if coefficient is not None:
        of_usual = math.hypot(coefficient.value, coefficient.standard_uncertainty) * friction.usual
    return UNSEEN_FRICTION * of_usual


#: Parameters of the calibration whose uncertainty is that of an influence quantity.
_PARAMETERS = {"payload": INVERSE_MOVING_MASS, "temperature": TEMPERATURE_COEFFICIENT}


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyBudget:
    """Variances of g − θ·k3, whose root in θ is the preload: all in s⁴."""

    frequency: float
    reproducibility: float
    slope: float  # of the feature in the frequency, without sign [s²/Hz]
    parameters: dict[str, float]  # of each calibration parameter, with half of its covariances
    gradient: FloatArray  # of the feature to the calibration parameters (k3 is none of them), see parameter_gradients
    influences: OfInfluences[Influence]
    known: tuple[tuple[float, float], ...]  # variances that are known with so many degrees of freedom

    @property
    def random(self) -> float:
        """Variance that is new in every measurement, or in every session."""
        of_influences = sum(influence.variance for influence in self.influences.by_name.values())
        return float(self.frequency + self.reproducibility + of_influences)

    @property
    def shown(self) -> float:
        """Variance that the sessions of an axis show by their scatter, each the mean of its measurements."""
        influences = self.influences.by_name
        return float(sum(influences[name].shown for name in SHOWN_BY_SESSIONS))

    @property
    def total(self) -> float:
        """Variance of all sources."""
        return self.random + sum(self.parameters.values())

    @property
    def degrees_of_freedom(self) -> float:
        """Effective (Welch–Satterthwaite); what is declared is known for certain (GUM, type B)."""
        return _effective_degrees_of_freedom(self.total, self.known)

    @property
    def unstated(self) -> tuple[str, ...]:
        """The quantities that nobody has stated and that widen the interval."""
        entries = self.influences.by_name.items()
        return tuple(name for name, entry in entries if entry.were_it_stated is not None and entry.variance)

    def with_stated(self, names: Iterable[str]) -> "UncertaintyBudget":
        """Return the budget as it would be if these quantities were stated."""
        entries = {name: getattr(self.influences, name) for name in names}
        stated = {name: replace(e, uncertainty=e.were_it_stated, were_it_stated=None) for name, e in entries.items()}
        return replace(self, influences=replace(self.influences, **stated))

    @property
    def shares(self) -> VarianceShares:
        """The budget in parts of its total; all zero where nothing is uncertain."""
        total = self.total or 1.0
        of_parameters = {name: self.parameters.get(parameter, 0.0) for name, parameter in _PARAMETERS.items()}
        of_influences = {
            name: (influence.variance + of_parameters.get(name, 0.0)) / total
            for name, influence in self.influences.by_name.items()
        }
        return VarianceShares(
            frequency=self.frequency / total,
            reproducibility=self.reproducibility / total,
            calibration=sum(self.parameters[name] for name in COEFFICIENT_NAMES) / total,
            **of_influences,
        )


def parameter_gradients(feature: float, conditions: Sequence[Conditions], calibration: Calibration) -> FloatArray:
    """Differentiate the feature [s²] with respect to the parameters of the calibration, under several conditions.

    The feature is that at the reference conditions; k3 has no part in it. Shape (n_conditions, n_parameters), in the
    order of ``calibration.parameter_names`` [s² per unit of the parameter].
    """
    x = np.array([stated.position for stated in conditions])
    payload, temperature = np.array([calibration.excess(stated) for stated in conditions]).reshape(-1, 2).T
    influence = calibration.influence
    at_reference = feature + position_part(x, calibration.coefficients)
    measured = from_reference(at_reference, payload, temperature, influence)
    sensitivity = correction_sensitivities(measured, payload, temperature, influence)
    of = {
        "k1": -(x**2),
        "k2": -x,
        "k3": np.zeros_like(x),
        "k4": -np.ones_like(x),
        INVERSE_MOVING_MASS: sensitivity.inverse_moving_mass,
        TEMPERATURE_COEFFICIENT: sensitivity.temperature,
    }
    return np.column_stack([of[name] for name in calibration.parameter_names])


def uncertainty_budget(
    frequency: Estimate,
    feature: float,
    conditions: Conditions,
    calibration: Calibration,
    *,
    friction: FrictionExcess = NOT_SEEN,
    mass: Deviation | None = None,
    amplification: float = 1.0,
) -> UncertaintyBudget:
    r"""Propagate the uncertainties of a measurement and of its calibration to :math:`g - \theta k_3` at θ = g/k3.

    Given are the axial natural frequency [Hz] and its preload feature g at the reference conditions [s²]. Scatter
    between measurements and the fitted parameters come from the same residuals: they count as one source in the
    effective degrees of freedom. Declared parameters are taken as known with theirs (GUM, type B), and so is what the
    months after the calibration bring: friction, mass and amplification are those of :func:`influences_of`.
    """
    payload, temperature = calibration.excess(conditions)
    f = frequency.value
    # |d(1/f² at reference)/df|
    sensitivity = correction_sensitivities(f**-2.0, payload, temperature, calibration.influence)
    slope = amplification * 2.0 / f**3 * float(sensitivity.inverse_square)
    gradient = amplification * parameter_gradients(feature, [conditions], calibration)[0]
    parameters = _of_parameters(gradient, feature, calibration)
    own = (slope * frequency.standard_uncertainty) ** 2
    between = (slope * calibration.reproducibility) ** 2
    if not calibration.uncertainty_stated:
        between = max(0.0, between - own)  # the scatter of the calibration holds the readings' own already
    known = (
        (own, frequency.degrees_of_freedom),
        *_known_by_calibration((slope * calibration.residual_sd) ** 2, parameters, calibration),
    )
    influences = influences_of(
        f**-2.0, conditions, calibration, friction=friction, mass=mass, amplification=amplification
    )
    return UncertaintyBudget(own, between, slope, parameters, gradient, influences, known)


def _of_parameters(gradient: FloatArray, feature: float, calibration: Calibration) -> dict[str, float]:
    """Return the variance of g − θ·k3 by each parameter of the calibration, with half of its covariances [s⁴]."""
    with_k3 = gradient.copy()
    with_k3[calibration.parameter_names.index("k3")] = -feature / calibration.coefficients.k3
    allocation = with_k3 * (calibration.parameters.covariance @ with_k3)
    return dict(zip(calibration.parameter_names, allocation.tolist(), strict=True))


def _known_by_calibration(
    of_scatter: float, parameters: dict[str, float], calibration: Calibration
) -> tuple[tuple[float, float], ...]:
    """Return the variances that the residuals of a calibration know, with their degrees of freedom."""
    # the scatter between measurements is residual variance minus stated variance: it is no better known than the
    # residual variance as a whole, however much of it the stated uncertainties explain
    of_residuals = of_scatter + sum(
        v for name, v in parameters.items() if name not in (*calibration.declared, INVERSE_MOVING_MASS)
    )
    of_moving_mass = 0.0 if INVERSE_MOVING_MASS in calibration.declared else parameters.get(INVERSE_MOVING_MASS, 0.0)
    return (of_residuals, calibration.parameters.degrees_of_freedom), (of_moving_mass, calibration.moving_mass_dof)


def joint_weights(own: FloatArray, scatter: FloatArray, is_one_place: BoolArray) -> FloatArray:
    r"""Return the weights of the measurements of a session, each by its own information, shape (n_measurements,).

    .. math:: w = \frac{C^{-1} 1}{1^T C^{-1} 1}, \qquad C_{ij} = u_i^2\,\delta_{ij} + s^2\,[i, j\text{ of one place}]

    the best linear estimate with that covariance (Aitken, Proc. R. Soc. Edinburgh 55 (1936) 42-48). ``own`` is what is
    new in each measurement, ``scatter`` what the calibration leaves of a reading [s²]; ``is_one_place`` is symmetric.
    What all measurements have in common has no part in the weights: it hardly differs from place to place, and a best
    estimate that took the little difference at its word would weigh some of them negatively.
    """
    covariance = np.diag(own**2) + np.mean(scatter**2) * is_one_place
    information = np.linalg.solve(covariance, np.ones(own.size)).astype(np.float64)
    weights: FloatArray = information / information.sum()
    return weights


def joint_budget(
    feature: float,
    budgets: Sequence[UncertaintyBudget],
    *,
    weights: FloatArray,
    own_shares: FloatArray,
    is_one_place: BoolArray,
    calibration: Calibration,
) -> UncertaintyBudget:
    """Return the budget of the weighted mean of the features of a session, which measure one preload.

    Independent is what is new in each frequency, a share of its standard uncertainty each, and the scatter between
    places: at one place the readings of a calibration are off its law alike. Coefficients go in as they are, so that
    what they tilt between places cancels. Everything else (temperature, payload, mounting, friction, errors of the
    fitted model) is taken for the same at all places and of one sign, and averages out nowhere.
    """
    frequencies = weights * np.sqrt([budget.frequency for budget in budgets])
    independent, alike = (frequencies * own_shares) ** 2, float(frequencies @ np.sqrt(1.0 - own_shares**2)) ** 2
    scatter = weights * np.sqrt([budget.reproducibility for budget in budgets])
    slopes = weights * [budget.slope for budget in budgets]
    of_residuals = float(slopes @ is_one_place @ slopes) * calibration.residual_sd**2
    gradient: FloatArray = weights @ np.array([budget.gradient for budget in budgets])
    parameters = _of_parameters(gradient, feature, calibration)
    of_own = [(float(v), budget.known[0][1]) for v, budget in zip(independent, budgets, strict=True)]
    return UncertaintyBudget(
        frequency=float(independent.sum()) + alike,
        reproducibility=float(scatter @ is_one_place @ scatter),
        slope=float(slopes.sum()),
        parameters=parameters,
        gradient=gradient,
        influences=OfInfluences(
            **{
                name: _in_common([budget.influences.by_name[name] for budget in budgets], weights)
                for name in OfInfluences.__slots__
            }
        ),
        known=(
            *of_own,
            (alike, min(dof for _, dof in of_own)),
            *_known_by_calibration(of_residuals, parameters, calibration),
        ),
    )


def _in_common(influences: Sequence[Influence], weights: FloatArray) -> Influence:
    """Return an influence on a weighted mean, its quantity being off by as much, and as one, in all measurements."""
    sensitivities = weights * [abs(influence.sensitivity) for influence in influences]

    def mean(quantity: Callable[[Influence], float]) -> float:
        return float(sensitivities @ [quantity(influence) for influence in influences])

    is_unstated = any(influence.were_it_stated is not None for influence in influences)
    return Influence(
        1.0,
        mean(lambda of: of.uncertainty),
        mean(lambda of: of.uncertainty if of.were_it_stated is None else of.were_it_stated) if is_unstated else None,
        mean(lambda of: of.lasting),
    )


def _effective_degrees_of_freedom(total: float, sources: Sequence[tuple[float, float]]) -> float:
    """Apply Welch–Satterthwaite to (variance, degrees of freedom); at least the fewest of a source, its lower bound."""
    spread = sum(variance**2 / dof for variance, dof in sources)
    poorest = min((dof for variance, dof in sources if variance > 0.0), default=math.inf)
    return max(poorest, total**2 / spread) if spread > 0.0 else math.inf


def systematic_uncertainty_between(
    feature: float, conditions: Conditions, baseline_conditions: Sequence[Conditions], calibration: Calibration
) -> float:
    """Tell by how much the calibration may shift a feature beyond what it did to the healthy baseline.

    An error of k4 shifts both alike and cancels. What does not cancel are k1 and k2 between different positions, and
    the corrections of payload and temperature where they differ; no averaging over measurements removes it. As far as
    measurements of the baseline may be off as much, the scatter of the baseline has it already: only what may come on
    top is returned (the errors are those of the same coefficients, so they add up like amounts, not like variances).

    The feature, healthy or measured, is that at the reference conditions [s²]; it enters the payload correction only.
    Returned is the standard uncertainty of feature minus baseline [s²]: 0 under conditions like those of the baseline.
    """
    gradients = parameter_gradients(feature, [*baseline_conditions, conditions], calibration)

    # µ may rest on a few readings: enlarged so that 1.96 times the result covers 95 % all the same
    few = np.ones(len(calibration.parameter_names))
    if (mu := calibration.parameter(INVERSE_MOVING_MASS)) is not None:
        few[calibration.parameter_names.index(INVERSE_MOVING_MASS)] = enlargement(mu.degrees_of_freedom)
    return beyond_others(gradients, calibration.parameters.covariance * np.outer(few, few))


def with_history(declared: float, shown: float, degrees_of_freedom: float) -> float:
    r"""Return the scatter between sessions by what was declared of it and what an axis has shown, pooled.

    .. math:: \sigma^2 = \frac{\nu_0 \sigma_0^2 + \nu s^2}{\nu_0 + \nu}

    A random-effects model: the declared variance is that of many axes, known with :math:`\nu_0` degrees of freedom
    (:data:`DECLARED_DEGREES_OF_FREEDOM`), the shown one that of this axis. It widens as well as it narrows. Standard
    deviations of the preload feature [s²].
    """
    total = DECLARED_DEGREES_OF_FREEDOM + degrees_of_freedom
    return math.sqrt((DECLARED_DEGREES_OF_FREEDOM * declared**2 + degrees_of_freedom * shown**2) / total)


def excess_variance_of(scatter: Real, budgeted: Real) -> Real:
    """Return by how much the scatter between sessions has a larger variance than was budgeted; negative if less [s⁴].

    Both are standard deviations of the preload feature [s²].
    """
    excess: Real = scatter**2 - budgeted**2
    return excess


def widened(interval: Interval, preload: float, feature: float, excess: float) -> Interval:
    r"""Return the coverage interval of a preload whose feature has so much more variance, or less.

    In :math:`\theta = \mathrm{preload}^{-1/3} = g/k_3`, where the feature g acts linearly, each half h becomes
    :math:`\sqrt{h^2 + z^2\,e/k_3^2}` with z the normal quantile of the level and e the excess [s⁴]: a part of type A,
    known from many sessions, joins the budget or takes the place of what was declared (GUM, 5.1.2). Preloads are in
    newtons, the feature in s².
    """
    if excess == 0.0:
        return interval
    lower, upper = widened_ends((interval.lower, interval.upper), preload, feature, excess, interval.level)
    return Interval(float(lower), float(upper), interval.kind, interval.level)


def widened_ends(
    ends: tuple[Real, Real], preload: Real, feature: Real, excess: Real, level: float = 0.95
) -> tuple[FloatArray, FloatArray]:
    """Return both ends of one interval or of many as :func:`widened` has them; an open end is infinite [N]."""
    with np.errstate(divide="ignore", over="ignore"):  # an end at zero, or next to it
        theta, most, least = np.cbrt(1.0 / preload), *(np.cbrt(np.divide(1.0, end)) for end in ends)
        squared = scipy.special.ndtri(0.5 * (1.0 + level)) ** 2 * excess * (theta / feature) ** 2
        high = theta + np.sqrt(np.maximum((most - theta) ** 2 + squared, 0.0))
        low = theta - np.sqrt(np.maximum((theta - least) ** 2 + squared, 0.0))
        return np.asarray(high**-3.0), np.where((low <= 0.0) | (least == 0.0), np.inf, np.abs(low) ** -3.0)
