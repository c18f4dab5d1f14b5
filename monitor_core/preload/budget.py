"""Compute the uncertainty budget of the preload feature: errors new in each measurement, and errors all share.

All functions raise ``OutsideValidityError`` if a payload is below the reference by more than the moving mass.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.preload.calibration import (
    COEFFICIENT_NAMES,
    INVERSE_MOVING_MASS,
    TEMPERATURE_COEFFICIENT,
    Calibration,
)
from monitor_core.preload.feature import correction_sensitivities, from_reference, position_part
from monitor_core.preload.witnesses import Deviation
from monitor_core.recording import Conditions
from monitor_core.uncertainty import Estimate, Interval

#: One number or many.
Real = TypeVar("Real", float, FloatArray)


@dataclass(frozen=True, slots=True)
class VarianceShares:
    """Where the variance of the preload, as θ = preload^(−1/3), comes from; the shares add up to 1.

    Covariances between the sources are split evenly, so a source that compensates another may have a negative share.
    """

    frequency: float  # stated uncertainty of this frequency
    reproducibility: float  # scatter between measurements beyond it
    calibration: float  # k1…k4
    payload: float  # µ, and a payload that is not stated or lies beyond the calibrated ones
    temperature: float  # k_T, and a structure that lags behind its thermometer
    friction: float = 0.0  # k_F, and where on the axis the friction acts
    between_session: float = 0.0  # what another day changes


#: Share of a temperature's distance from the calibration's by which the structure lags behind it (standard uncertainty,
#: declared): a thermometer in the air leads by much of it.
TEMPERATURE_LAG = 0.45
#: Of a thermometer as the temperature of what stretches, wherever it reads (standard uncertainty, declared): an offset
#: of 1 K, and as much by which the structure still follows yesterday's air [K].
THERMOMETER = 1.5
#: Of a correction for friction, the standard uncertainty by where the friction acts: in the guides it moves the mode by
#: two to three times as much as in bearing and nut, and a calibration has hardly seen the one without the other
#: (declared).
FRICTION_SHARE = 1.0
#: The same where the noise around the mode speaks for the guides, and how far it disagrees with the friction torque
#: counts by itself (declared): above the usual, and below, where noise from elsewhere hides what guides no longer make.
WITNESSED_FRICTION_SHARE = 0.25
WITNESSED_FRICTION_SHARE_BELOW = 0.5
#: Of a stated position, standard uncertainty: home switch, mounting of the scale, where the table was said to be [m].
POSITION_TAG = 2e-3
#: Of the logarithm of the payload's factor on 1/f², per calibrated payload by which it lies beyond (declared).
PAYLOAD_EXTRAPOLATION = 0.1


@dataclass(frozen=True, slots=True)
class FrictionExcess:
    """Friction beyond the usual, as two witnesses tell it."""

    torque: float  # friction torque above the usual [N·m]
    unexplained: Estimate | None  # the same, were all to have grown as the noise around the mode; None: not known


@dataclass(frozen=True, slots=True)
class Months:
    """Variances of g − θ·k3 that no session of calibration shows: declared, GUM type B, all in s⁴."""

    between_session: float = 0.0
    friction: float = 0.0
    temperature: float = 0.0
    payload: float = 0.0

    @property
    def total(self) -> float:
        """Variance of all of them."""
        return self.between_session + self.friction + self.temperature + self.payload


def months_after(
    inverse_square: float,
    conditions: Conditions,
    calibration: Calibration,
    *,
    friction: FrictionExcess | None = None,
    mass: Deviation | None = None,
) -> Months:
    """Return what the months after a calibration may have done to a measured 1/f² [s²].

    ``friction`` is what speaks of it beyond the usual, ``None`` where nothing does; ``mass`` how the residue differs
    from what the calibration lets expect, ``None`` where it is not known: of a payload that is not stated it tells how
    large it is.
    """
    payload, temperature = calibration.excess(conditions)
    sensitivity = correction_sensitivities(inverse_square, payload, temperature, calibration.influence)
    at_reference = inverse_square * float(sensitivity.inverse_square)
    if calibration.between_sessions == 0.0:  # the readings come from as many days as later measurements
        return Months()
    k = calibration.coefficients
    slope = 2.0 * k.k1 * conditions.position + k.k2
    of_friction = 0.0
    if calibration.friction is not None and friction is not None:
        of_friction = _friction_variance(calibration.friction, friction)
    return Months(
        between_session=(2.0 * at_reference * calibration.between_sessions) ** 2 + (slope * POSITION_TAG) ** 2,
        friction=of_friction,
        temperature=0.0
        if conditions.temperature is None
        else (calibration.influence.temperature * math.hypot(THERMOMETER, TEMPERATURE_LAG * temperature)) ** 2,
        payload=(at_reference * _payload_error(conditions, calibration, mass)) ** 2,
    )


def _friction_variance(coefficient: Estimate, friction: FrictionExcess) -> float:
    """Return the variance of the correction for friction: of its coefficient, and of where the friction acts [s⁴]."""
    of_coefficient = coefficient.standard_uncertainty * friction.torque
    if friction.unexplained is None:
        return of_coefficient**2 + (FRICTION_SHARE * coefficient.value * friction.torque) ** 2
    # by as much as the two differ by chance alone they do not contradict each other
    apart = max((friction.unexplained.value - friction.torque) ** 2 - friction.unexplained.standard_uncertainty**2, 0.0)
    share = WITNESSED_FRICTION_SHARE if friction.torque > 0.0 else WITNESSED_FRICTION_SHARE_BELOW
    return of_coefficient**2 + coefficient.value**2 * (apart + (share * friction.torque) ** 2)


def _payload_error(conditions: Conditions, calibration: Calibration, mass: Deviation | None) -> float:
    """Return the standard uncertainty of 1/f², relative, of a payload not stated or beyond those calibrated [-]."""
    mu = calibration.influence.inverse_moving_mass
    if mu == 0.0:
        return 0.0
    largest = calibration.payload.upper - calibration.reference_payload
    if conditions.payload_mass is None:
        # the residue is a reciprocal mass: its logarithm falls as that of 1/f² rises
        if mass is not None:
            return math.hypot(mass.logarithm, mass.standard_uncertainty)
        return mu * largest / math.sqrt(3.0)
    beyond = max(conditions.payload_mass - calibration.payload.upper, 0.0)
    if INVERSE_MOVING_MASS in calibration.declared or beyond == 0.0:
        return 0.0
    return PAYLOAD_EXTRAPOLATION * math.log1p(mu * (largest + beyond)) * beyond / max(largest, beyond)


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyBudget:
    """Variances of g − θ·k3, whose root in θ is the preload: all in s⁴."""

    frequency: float
    reproducibility: float
    parameters: dict[str, float]  # of each calibration parameter, with half of its covariances
    gradient: FloatArray  # of the feature to the calibration parameters (k3 is none of them), see parameter_gradients
    degrees_of_freedom: float  # effective (Welch–Satterthwaite)
    months: "Months"  # what the months after the calibration bring

    @property
    def random(self) -> float:
        """Variance that is new in every measurement, or in every session."""
        return self.frequency + self.reproducibility + self.months.total

    @property
    def total(self) -> float:
        """Variance of all sources."""
        return self.random + sum(self.parameters.values())

    @property
    def shares(self) -> VarianceShares:
        """The budget in parts of its total; all zero where nothing is uncertain."""
        total = self.total or 1.0
        return VarianceShares(
            frequency=self.frequency / total,
            reproducibility=self.reproducibility / total,
            calibration=sum(self.parameters[name] for name in COEFFICIENT_NAMES) / total,
            payload=(self.parameters.get(INVERSE_MOVING_MASS, 0.0) + self.months.payload) / total,
            temperature=(self.parameters.get(TEMPERATURE_COEFFICIENT, 0.0) + self.months.temperature) / total,
            friction=self.months.friction / total,
            between_session=self.months.between_session / total,
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
    months: Months | None = None,
    amplification: float = 1.0,
) -> UncertaintyBudget:
    r"""Propagate the uncertainties of a measurement and of its calibration to :math:`g - \theta k_3` at θ = g/k3.

    Given are the axial natural frequency [Hz] and its preload feature g at the reference conditions [s²]. Scatter
    between measurements and the fitted parameters come from the same residuals: they count as one source in the
    effective degrees of freedom. Declared parameters are taken as known with theirs (GUM, type B), and so is what the
    months after the calibration bring. ``amplification`` is by how much an error of 1/f² grows where the correction for
    friction follows the preload that is estimated.
    """
    months = months or Months()
    payload, temperature = calibration.excess(conditions)
    f = frequency.value
    # |d(1/f² at reference)/df|
    sensitivity = correction_sensitivities(f**-2.0, payload, temperature, calibration.influence)
    slope = amplification * 2.0 / f**3 * float(sensitivity.inverse_square)
    gradient = amplification * parameter_gradients(feature, [conditions], calibration)[0]
    grown = amplification**2
    months = Months(
        grown * months.between_session, grown * months.friction, grown * months.temperature, grown * months.payload
    )
    with_k3 = gradient.copy()
    with_k3[calibration.parameter_names.index("k3")] = -feature / calibration.coefficients.k3
    allocation = with_k3 * (calibration.parameters.covariance @ with_k3)
    parameters = dict(zip(calibration.parameter_names, allocation.tolist(), strict=True))
    own = (slope * frequency.standard_uncertainty) ** 2
    between = (slope * calibration.reproducibility) ** 2
    if not calibration.uncertainty_stated:
        between = max(0.0, between - own)  # the scatter of the calibration holds the readings' own already
    total = own + between + months.total + float(allocation.sum())
    # the scatter between measurements is residual variance minus stated variance: it is no better known than the
    # residual variance as a whole, however much of it the stated uncertainties explain
    of_residuals = (slope * calibration.residual_sd) ** 2 + sum(
        v for name, v in parameters.items() if name not in (*calibration.declared, INVERSE_MOVING_MASS)
    )
    of_moving_mass = 0.0 if INVERSE_MOVING_MASS in calibration.declared else parameters.get(INVERSE_MOVING_MASS, 0.0)
    dof = _effective_degrees_of_freedom(
        total,
        (
            (own, frequency.degrees_of_freedom),
            (of_residuals, calibration.parameters.degrees_of_freedom),
            (of_moving_mass, calibration.moving_mass_dof),
        ),
    )
    return UncertaintyBudget(own, between, parameters, gradient, dof, months)


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
        enlarged = scipy.special.stdtrit(mu.degrees_of_freedom, 0.975) / scipy.special.ndtri(0.975)
        few[calibration.parameter_names.index(INVERSE_MOVING_MASS)] = enlarged
    covariance = calibration.parameters.covariance * np.outer(few, few)

    apart = gradients - np.mean(gradients[:-1], axis=0)
    *of_baseline, here = np.sqrt(np.maximum(np.einsum("ci,ij,cj->c", apart, covariance, apart), 0.0)).tolist()
    return float(max(0.0, here - max(of_baseline)))


def unexplained_scatter(learnt: Real, budgeted: Real) -> Real:
    """Return what the scatter between sessions has on top of what the budget of a measurement allows for.

    Both are standard deviations of the preload feature [s²]. A smaller scatter narrows nothing: what has been the same
    since the calibration (a mounting, a home switch) does not show in it.
    """
    unexplained: Real = np.sqrt(np.maximum(learnt**2 - budgeted**2, 0.0))
    return unexplained


def widened(interval: Interval, preload: float, feature: float, unexplained: float) -> Interval:
    r"""Return the coverage interval of a preload with so much more scatter of its feature.

    In :math:`\theta = \mathrm{preload}^{-1/3} = g/k_3`, where the feature g acts linearly, each half grows from h to
    :math:`\sqrt{h^2 + (z\,s/k_3)^2}` with z the normal quantile of the level: a part of type A, known from many
    sessions, joins the budget (GUM, 5.1.2). Preloads are in newtons, feature and scatter s in s².
    """
    if unexplained <= 0.0:
        return interval
    lower, upper = widened_ends((interval.lower, interval.upper), preload, feature, unexplained, interval.level)
    return Interval(float(lower), float(upper), interval.kind, interval.level)


def widened_ends(
    ends: tuple[Real, Real], preload: Real, feature: Real, unexplained: Real, level: float = 0.95
) -> tuple[FloatArray, FloatArray]:
    """Return both ends of one interval or of many as :func:`widened` has them; an open end is infinite [N]."""
    with np.errstate(divide="ignore"):  # an end at zero
        theta, most, least = np.cbrt(1.0 / preload), *(np.cbrt(np.divide(1.0, end)) for end in ends)
        reach = scipy.special.ndtri(0.5 * (1.0 + level)) * unexplained * theta / feature
        high, low = theta + np.hypot(most - theta, reach), theta - np.hypot(theta - least, reach)
        return np.asarray(high**-3.0), np.where((low <= 0.0) | (least == 0.0), np.inf, np.abs(low) ** -3.0)
