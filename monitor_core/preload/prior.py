"""State what is known of k1…k4 before an axis is measured, and join readings with it or refuse them.

It is predicted from joints, or an earlier calibration; readings that contradict it are refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload.calibration import (
    COEFFICIENT_NAMES,
    Calibration,
    ModalReading,
    ValidRange,
    Weighting,
    declared_influences,
    feature_design,
    known_parameters,
    refuse_blind_mode,
)
from monitor_core.preload.feature import (
    TEMPERATURE_RESOLUTION,
    UNKNOWN_TEMPERATURE_COEFFICIENT,
    PreloadFeatureCoefficients,
)
from monitor_core.preload.regression import (
    CoefficientFit,
    ReadingColumns,
    ReadingRows,
    excess_variance,
    weighted_least_squares,
)
from monitor_core.preload.witnesses import Witness
from monitor_core.recording import ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.uncertainty import Estimate, VectorEstimate

#: Eigenvalue of the correlations below which a combination of the coefficients counts as exactly known, and how far
#: below zero rounding may take one.
_EXACT, _ROUNDING = 1e-13, 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class CoefficientPrior:
    """k1…k4 of Eq. (8) of Nguyen et al. (2018) with covariance, and how readings scatter about them.

    Covariance and reproducibility rest on the same scatter, known with the stated degrees of freedom; infinite where
    both are stated and not estimated. A prediction from a model adds the misfit of Eq. (8) to that model to the scatter
    between measurements (root of the sum of squares) for its reproducibility.
    """

    coefficients: VectorEstimate  # k1…k4 at the payload and temperature below, SI units
    reproducibility: float  # scatter between measurements beyond their own stated uncertainty [Hz]
    position: ValidRange  # [m]
    preload: ValidRange  # [N]
    source: str  # where it comes from, in words
    payload: float = 0.0  # [kg]
    temperature: float | None = None  # [°C]; None: not stated
    excitation_source: ExcitationSource | None = None  # None: not stated
    excitation_quantity: ExcitationQuantity | None = None
    response_quantity: ResponseQuantity | None = None
    witnesses: tuple[Witness, ...] = ()  # what is usual of the axis, where it was measured before
    friction: Estimate | None = None  # what friction torque adds to 1/f² [s²/(N·m)]
    between_sessions: float = 0.0  # what another day changes of a frequency, relative standard uncertainty [-]

    def __post_init__(self) -> None:
        values, covariance = self.coefficients.values, self.coefficients.covariance
        if values.shape != (4,):
            raise OutsideValidityError(f"a prior must have four coefficients, k1 to k4; got {values.size}")
        PreloadFeatureCoefficients(*values.tolist())  # refuses a k3 that is not positive
        diagonal = np.diag(covariance)
        if not (np.isfinite(covariance).all() and np.all(diagonal >= 0.0) and np.any(diagonal > 0.0)):
            raise OutsideValidityError(
                "a prior must state finite variances of its coefficients, one of them positive at least; "
                f"got {', '.join(f'{v:.3g}' for v in diagonal)}"
            )
        if self._variances_and_axes[0][0] < -_ROUNDING:
            raise OutsideValidityError("the covariance of a prior must have no negative variance in any direction")
        if not (math.isfinite(self.reproducibility) and self.reproducibility >= 0.0):
            raise OutsideValidityError(
                f"the reproducibility of a prior must not be negative; got {self.reproducibility} Hz"
            )

    @property
    def spread(self) -> FloatArray:
        """F with covariance = F·Fᵀ, shape (4, n_uncertain): fewer columns where a combination is exactly known."""
        variances, axes = self._variances_and_axes
        uncertain = variances > _EXACT * variances[-1]
        return np.asarray(axes[:, uncertain] * np.sqrt(variances[uncertain]))

    @property
    def _variances_and_axes(self) -> tuple[FloatArray, FloatArray]:
        """Of the correlations, rising, with the axes in units of the coefficients: C = A·diag(v)·Aᵀ."""
        covariance = self.coefficients.covariance
        scale = np.sqrt(np.diag(covariance))
        scale = np.where(scale > 0.0, scale, 1.0)
        variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
        return variances, scale[:, np.newaxis] * axes


def prior_from_calibration(calibration: Calibration, source: str) -> CoefficientPrior:
    """Take k1…k4 of an earlier calibration for a prior.

    Its moving mass and temperature coefficient are left behind. Where its readings did not state their uncertainty the
    reproducibility holds that too, and counts it twice for readings that do: intervals are rather too wide.
    """
    k = len(COEFFICIENT_NAMES)
    parameters = calibration.parameters
    return CoefficientPrior(
        coefficients=VectorEstimate(
            parameters.values[:k], parameters.covariance[:k, :k], parameters.degrees_of_freedom
        ),
        reproducibility=calibration.reproducibility,
        position=calibration.position,
        preload=calibration.preload,
        source=source,
        payload=calibration.reference_payload,
        temperature=calibration.reference_temperature,
        excitation_source=calibration.excitation_source,
        excitation_quantity=calibration.excitation_quantity,
        response_quantity=calibration.response_quantity,
        witnesses=calibration.witnesses,
        friction=calibration.friction,
        between_sessions=calibration.between_sessions,
    )


def refuse_other_conditions(
    prior: CoefficientPrior,
    readings: ReadingColumns,
    source: ExcitationSource | None,
    quantity: ExcitationQuantity | None,
    response: ResponseQuantity | None,
) -> None:
    """Raise OutsideValidityError where readings are of other conditions or channels than the prior."""
    lowest = float(readings.payload.min())
    if lowest != prior.payload:
        raise OutsideValidityError(
            f"the prior holds for a payload of {prior.payload:g} kg, which must be the lowest of the readings; "
            f"got {lowest:g} kg"
        )
    for what, stated, of_prior in (
        ("excitation", source, prior.excitation_source),
        ("excitation", quantity, prior.excitation_quantity),
        ("response", response, prior.response_quantity),
    ):
        if None not in (stated, of_prior) and stated != of_prior:
            raise OutsideValidityError(f"the prior holds for the {what} '{of_prior}'; got readings of '{stated}'")
    if readings.temperature is None or prior.temperature is None:
        return
    mean = float(readings.temperature.mean())
    if abs(mean - prior.temperature) > TEMPERATURE_RESOLUTION:
        raise OutsideValidityError(
            f"the prior holds at {prior.temperature:.1f} °C; expected readings within {TEMPERATURE_RESOLUTION:g} K of "
            f"it on average, got {mean:.1f} °C"
        )


def log_preload(preload: Estimate) -> Estimate:
    """Return ln(P/N) of a preload [N] that is known to a share of itself [-]."""
    return Estimate(math.log(preload.value), preload.standard_uncertainty / preload.value)


def with_unset_preload(
    prior: CoefficientPrior, readings: Sequence[ModalReading], log_preload: Estimate
) -> CoefficientPrior:
    r"""Join readings under one preload that nobody set on purpose, and of which only a range is known.

    .. math:: y = X(P_0)\,k - \tfrac13 k_3 P_0^{-1/3}\,\delta + e, \qquad \delta = \ln P/P_0

    with the deviation :math:`\delta` common to all readings: what they tell of the axis is its level; which part of it
    is the preload's stays as the prior has it, and no number is better known in newtons than the preload was.

    Parameters
    ----------
    prior : CoefficientPrior
        What is known of k1…k4.
    readings : sequence of ModalReading
        One at least, without payload; a preload of their conditions is not looked at.
    log_preload : Estimate
        ln(preload/N) of the nut, with its standard uncertainty [-].

    Returns
    -------
    CoefficientPrior
        Posterior of linear Gaussian equations.

    Raises
    ------
    NotIdentifiableError
        If readings contradict the prior at the 0.1 % point of χ², or there is none.
    OutsideValidityError
        If they carry a payload.
    """
    if not readings:
        raise NotIdentifiableError("a calibration of a drive model needs one reading at least, or none and no preload")
    conditions = [reading.conditions for reading in readings]
    if heavy := [c.payload_mass for c in conditions if c.payload_mass]:
        raise OutsideValidityError(
            f"readings under a preload that nobody set must carry no payload; got {heavy[0]:g} kg"
        )
    x, y = np.array([c.position for c in conditions]), np.array([reading.frequency for reading in readings])
    theta = math.exp(-log_preload.value / 3.0)
    design = feature_design(x, np.full(x.size, theta**-3.0))
    k, covariance = prior.coefficients.values, prior.coefficients.covariance
    stated = np.array([reading.frequency_std or 0.0 for reading in readings]) ** 2
    scatter = (2.0 * y**-3.0) ** 2 * (stated + prior.reproducibility**2)
    common = (k[2] * theta / 3.0 * log_preload.standard_uncertainty) ** 2
    common += (2.0 * float(np.mean(y**-2.0)) * prior.between_sessions) ** 2  # all are of one day
    of_readings = design @ covariance @ design.T + np.diag(scatter) + common
    off = y**-2.0 - design @ k
    scale = float(np.mean(y**-2.0))
    gain = np.linalg.solve(of_readings / scale**2, design @ covariance / scale**2).T
    _refuse_contradiction(prior, float(off / scale @ np.linalg.solve(of_readings / scale**2, off / scale)), y.size)
    joined = covariance - gain @ design @ covariance
    typical, factor = math.exp(log_preload.value), math.exp(1.96 * log_preload.standard_uncertainty)
    temperatures = [c.temperature for c in conditions if c.temperature is not None]
    return replace(
        prior,
        coefficients=VectorEstimate(k + gain @ off, 0.5 * (joined + joined.T), prior.coefficients.degrees_of_freedom),
        temperature=float(np.mean(temperatures)) if len(temperatures) == y.size else None,
        source=f"{prior.source}, {y.size} readings at a preload of {typical:.3g} N within a factor of {factor:.2g}",
    )


def calibration_from_prior(prior: CoefficientPrior, *, moving_mass: Estimate | None = None) -> Calibration:
    """Return the calibration of an axis that has no reading of known preload.

    The reproducibility of the prior is all that is known of the scatter of a reading, so intervals and minimum
    detectable loss are no better than it. ``moving_mass`` is the effective mass that moves without payload [kg].
    ``NotIdentifiableError`` if k3 is not positive beyond its 95 % uncertainty.
    """
    coefficients = prior.coefficients
    refuse_blind_mode(coefficients)
    temperature_coefficient = None
    if prior.temperature is not None:
        middle = [0.5 * (valid.lower + valid.upper) for valid in (prior.position, prior.preload)]
        typical = float(feature_design(np.array(middle[:1]), np.array(middle[1:]))[0] @ coefficients.values)
        temperature_coefficient = Estimate(0.0, UNKNOWN_TEMPERATURE_COEFFICIENT * typical)
    declared = declared_influences(moving_mass, temperature_coefficient, prior.payload)
    parameters, names = known_parameters(coefficients, COEFFICIENT_NAMES, declared)
    return Calibration(
        parameters=parameters,
        parameter_names=names,
        declared=tuple(declared),
        reproducibility=prior.reproducibility,
        residual_sd=prior.reproducibility,
        residual_rms=None,
        residual_max=None,
        condition_number=1.0,
        leave_one_position_out=(),
        weighting=Weighting.NONE,
        n_readings=0,
        position=prior.position,
        preload=prior.preload,
        payload=ValidRange(prior.payload, prior.payload),
        temperature=None if prior.temperature is None else ValidRange(prior.temperature, prior.temperature),
        reference_payload=prior.payload,
        reference_temperature=prior.temperature,
        excitation_source=prior.excitation_source,
        excitation_quantity=prior.excitation_quantity,
        response_quantity=prior.response_quantity,
        prior=prior.source,
        witnesses=prior.witnesses,
        friction=prior.friction,
        between_sessions=prior.between_sessions,
    )


#: Readings that a true prior would give less often than this contradict it.
CONTRADICTION = 1e-3
#: Degrees of freedom below which readings, all spent on the coefficients, say nothing of their scatter: rounding.
_SPENT = 1e-9


def fit_with_prior(prior: CoefficientPrior, rows: ReadingRows, weighting: Weighting) -> CoefficientFit:
    r"""Join readings with what was known of k1…k4 before: generalised least squares with the prior as extra rows.

    .. math::

        \min_z \sum_i \frac{w_i^2 (y_i - X_i \beta)^2}{\tau^2} + z^T z, \qquad \beta = \beta_0 + F z, \quad F F^T = C_0

    with :math:`\tau^2` the mean square that the prior expects of a weighted reading. A covariance :math:`C_0` that
    leaves some combination exactly known is no obstacle in this form.

    The columns are those of k1…k4, then of what the prior knows nothing of; the weights are as without a prior.
    ``NotIdentifiableError`` if the readings contradict the prior, or do not determine what it knows nothing of;
    ``OutsideValidityError`` if neither prior nor readings state any scatter.

    The readings bring :math:`\nu_1 = \sum (1 - h_i)` degrees of freedom, h their leverage in the joint fit: n − p where
    the prior says nothing, n where it says all. Their scatter is pooled with that of the prior by degrees of freedom,
    :math:`c^2 = (\nu_0 c_0^2 + \nu_1 c_1^2)/(\nu_0 + \nu_1)`, and :math:`\nu_0 + \nu_1` are those of the result. The
    prior's covariance rests on its scatter, so it follows the pooled one by the same factor; with infinite
    :math:`\nu_0` both stay as stated.

    Readings contradict the prior where the sum above exceeds what a true prior gives once in a thousand: the 0.1 %
    point of χ², or n times that of F(n, ν₀) for a scatter that is itself known with ν₀ degrees of freedom.
    """
    n, n_unknown = rows.design.shape[0], rows.design.shape[1] - len(COEFFICIENT_NAMES)
    expected = _expected_square(prior, rows)
    spread = prior.spread
    n_prior = spread.shape[1]
    basis = scipy.linalg.block_diag(spread, np.eye(n_unknown))
    start = np.append(prior.coefficients.values, np.zeros(n_unknown))
    fit = weighted_least_squares(
        np.vstack([rows.design @ basis, np.eye(n_prior, basis.shape[1])]),
        np.append(rows.inverse_square - rows.design @ start, np.zeros(n_prior)),
        np.append(rows.weight, np.full(n_prior, math.sqrt(expected))),
    )
    z, residual, leverage = fit.parameters.values, fit.residual[:n], fit.leverage[:n]
    squares = float(np.sum((rows.weight * residual) ** 2))
    _refuse_contradiction(prior, squares / expected + float(np.sum(z[:n_prior] ** 2)), n - n_unknown)

    own = float(np.sum(1.0 - leverage))  # ν₁
    dof = prior.coefficients.degrees_of_freedom + own
    c_squared = prior.reproducibility**2
    if own > _SPENT:
        c_squared += own / dof * (excess_variance(rows, residual, leverage) - c_squared)
    reproducibility = math.sqrt(max(0.0, c_squared))
    if weighting is Weighting.STD:
        variance = rows.slope**2 * (rows.stated**2 + reproducibility**2)
    else:
        variance = np.full(n, expected + (squares - own * expected) / dof)
    followed = float(np.mean(rows.weight**2 * variance)) / expected
    to_parameters = basis @ fit.estimator
    covariance = (to_parameters * np.append(variance, np.full(n_prior, followed))) @ to_parameters.T
    return CoefficientFit(VectorEstimate(start + basis @ z, covariance, dof), reproducibility, fit.condition_number)


def _expected_square(prior: CoefficientPrior, rows: ReadingRows) -> float:
    """Return τ², what the prior expects of the square of a weighted residual."""
    square = float(np.mean((rows.weight * rows.slope) ** 2 * (rows.stated**2 + prior.reproducibility**2)))
    if not square > 0.0:
        raise OutsideValidityError(
            "a prior without scatter needs readings that state theirs; got a reproducibility of 0 Hz and no "
            "frequency_std"
        )
    return square


def _refuse_contradiction(prior: CoefficientPrior, chi_squared: float, n: int) -> None:
    dof = prior.coefficients.degrees_of_freedom
    limit = (
        scipy.special.chdtri(n, CONTRADICTION)
        if math.isinf(dof)
        else n * scipy.special.fdtri(n, dof, 1.0 - CONTRADICTION)
    )
    if chi_squared > limit:
        raise NotIdentifiableError(
            f"the readings contradict the prior ({prior.source}): χ² of what separates them must be at most "
            f"{limit:.1f} for {n} degrees of freedom; got {chi_squared:.1f}. Check both, or calibrate without the prior"
        )
