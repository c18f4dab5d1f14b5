"""Local least squares of a problem within its bounds, and the linear uncertainty of what comes out.

The linear algebra is scaled: bounded steps, the directions of the Jacobian, and its covariance.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import MonitorCoreError, NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds, Problem
from monitor_core.uncertainty import VectorEstimate

#: Relative singular value of the column-scaled Jacobian below which nothing is known along a direction. The variance
#: there is finite, so that it drops out of what does not depend on it, and is larger than any that is of use.
_UNSEEN = 1e-10


def bounded_step(
    jacobian: FloatArray, residuals: FloatArray, lowest: FloatArray, highest: FloatArray
) -> tuple[FloatArray, float]:
    """Return the step within bounds that minimises |r + J s|², and by how much it would fall."""
    scale = _column_scale(jacobian)
    p = scale.size
    # So little damping moves no determined direction; without it an unseen one runs to a bound for nothing.
    damped = np.vstack([jacobian / scale, 1e-8 * np.eye(p)])
    target = np.concatenate([-residuals, np.zeros(p)])
    step = scipy.optimize.lsq_linear(damped, target, (lowest * scale, highest * scale), method="bvls").x / scale
    left = residuals + jacobian @ step
    return step, max(float(residuals @ residuals - left @ left), 0.0)


def _column_scale(jacobian: FloatArray) -> FloatArray:
    """Return the lengths of the columns, those without influence as the least length that counts; shape (p,)."""
    length: FloatArray = np.linalg.norm(jacobian, axis=0)
    if not (length > 0.0).any():
        raise NotIdentifiableError("the objective is flat: no coordinate moves any residual")
    at_least: FloatArray = np.maximum(length, _UNSEEN * length.max())
    return at_least


def scaled_directions(jacobian: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return column scale, singular values and, as rows, directions of the column-scaled Jacobian."""
    scale = _column_scale(jacobian)
    _, singular, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    return scale, np.maximum(singular, _UNSEEN * singular[0]), directions


def inverse_information(jacobian: FloatArray) -> FloatArray:
    """Return (JᵀJ)⁻¹ from the singular values, shape (n_parameters, n_parameters)."""
    scale, singular, directions = scaled_directions(jacobian)
    half = directions.T / singular / scale[:, np.newaxis]
    covariance: FloatArray = half @ half.T
    return covariance


#: A fit has converged when the linearised residuals promise a fall of χ² below this part of one standard uncertainty:
#: the coordinates then stand within a thousandth of their standard uncertainty, seen along any direction.
CONVERGED_BELOW = 1e-6

#: Where polishing stops: ten million times closer than judged, so that digits are limited by rounding alone.
_POLISHED_BELOW = 1e-14
_POLISHING_ROUNDS = 20

#: As near to a bound as this, in parts of the width of the bounds (or of the coordinate), is at it.
_AT_BOUND = 1e-7


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How a local fit is made."""

    uncertainties_stated: bool = True  #: residuals are in units of stated uncertainties; else their scatter is used
    max_evaluations: int = 500  #: of the residuals, in the search for the minimum; polishing adds a few
    tolerance: float = 1e-10  #: relative change of χ², step and gradient at which the search for the minimum stops [-]


@dataclass(frozen=True, slots=True, eq=False)
class LocalFit:
    """A minimum of χ² and what is known around it."""

    names: tuple[str, ...]
    coordinates: VectorEstimate  # as if there were no bounds: a bound is no measurement
    residuals: FloatArray  # at the minimum, shape (n_residuals,) [-]
    jacobian: FloatArray  # at the minimum, shape (n_residuals, n_parameters)
    chi_squared: float  # sum of squares of the residuals [-]
    residual_variance: float  # s² where uncertainties are not stated; 1 where they are [-]
    at_lower: tuple[str, ...]  # coordinates that stand at their lower bound
    at_upper: tuple[str, ...]
    expected_decrease: float  # of χ² by one more linearised step within the bounds [-]
    converged: bool
    n_evaluations: int  # of the residuals

    def __post_init__(self) -> None:
        object.__setattr__(self, "residuals", read_only(self.residuals))
        object.__setattr__(self, "jacobian", read_only(self.jacobian))

    @property
    def degrees_of_freedom(self) -> int:
        """Residuals less coordinates, whatever stands at a bound."""
        return self.residuals.size - len(self.names)

    @property
    def uncertainties_stated(self) -> bool:
        """Whether the covariance rests on stated uncertainties and not on the scatter of the residuals."""
        return math.isinf(self.coordinates.degrees_of_freedom)

    def standard_uncertainty_of(self, gradient: FloatArray) -> float:
        """Return the standard uncertainty of a quantity with this gradient to the coordinates, shape (n_parameters,).

        From the singular values and not from the covariance, whose digits are lost where a direction is unseen: what
        does not move along such a direction keeps its small uncertainty.
        """
        scale, singular, directions = scaled_directions(self.jacobian)
        along = directions @ (gradient / scale) / singular
        return math.sqrt(self.residual_variance) * float(np.linalg.norm(along))


def fit_local(problem: Problem, bounds: Bounds, start: FloatArray, settings: FitSettings | None = None) -> LocalFit:
    r"""Find the minimum of :math:`\chi^2 = \sum r_i^2` within bounds that a start of shape (n_parameters,) leads to.

    A trust region reflective search [1]_ with columns scaled by the Jacobian, then linearised steps within the bounds
    (bounded-variable least squares [2]_), which end on a bound where the search only comes near it. Steps to where the
    model has no answer (residuals not finite, or an error of the core) are refused and shortened. Covariance

    .. math::

        (J^T J)^{-1} \quad\text{or}\quad s^2 (J^T J)^{-1}, \qquad s^2 = \frac{\chi^2}{n - p}

    where the uncertainties of the data are stated or not. Where the data do not determine every coordinate their
    variance is very large, which :func:`~monitor_core.identification.identifiability.assess` puts into words.
    ``converged`` says whether the linearised decrease of χ² that is left is below 1e-6 of the residual variance.

    Raises NotIdentifiableError if there are fewer residuals than coordinates (or as many, where their scatter is to be
    estimated), or if no coordinate moves any residual at the minimum; OutsideValidityError if the start is outside the
    bounds, or if residuals or Jacobian are not finite where they are needed.

    References
    ----------
    .. [1] M. A. Branch, T. F. Coleman, Y. Li, SIAM J. Sci. Comput. 21 (1999) 1-23.
    .. [2] P. B. Stark, R. L. Parker, Computational Statistics 10 (1995) 129-141.
    """
    settings = settings or FitSettings()
    objective = _Objective(problem, bounds, np.asarray(start, dtype=np.float64), settings)
    try:
        result = scipy.optimize.least_squares(
            objective.residuals,
            objective.start,
            jac=objective.jacobian,
            bounds=(bounds.lower, bounds.upper),
            x_scale="jac",
            ftol=settings.tolerance,
            xtol=settings.tolerance,
            gtol=settings.tolerance,
            max_nfev=settings.max_evaluations,
        )
    except np.linalg.LinAlgError as error:
        raise OutsideValidityError(f"the Jacobian cannot be decomposed on the way from this start: {error}") from error
    return _polished(objective, bounds, _onto_bounds(np.clip(result.x, bounds.lower, bounds.upper), bounds))


class _Objective:
    """Residuals that are counted, and infinite where the model has no answer; refuses what cannot be fitted."""

    def __init__(self, problem: Problem, bounds: Bounds, start: FloatArray, settings: FitSettings) -> None:
        n_parameters = len(problem.names)
        if start.shape != (n_parameters,) or bounds.lower.shape != (n_parameters,):
            raise OutsideValidityError(
                f"start and bounds must have one value per coordinate; got {start.size} and {bounds.lower.size} "
                f"for {n_parameters}"
            )
        if not ((start >= bounds.lower) & (start <= bounds.upper)).all():
            raise OutsideValidityError(f"a start must lie within the bounds; got {start.tolist()}")
        self.problem, self.start, self.settings, self.n_evaluations = problem, start, settings, 1
        first = problem.residuals(start)
        needed = n_parameters + (not settings.uncertainties_stated)
        if first.size < needed:
            raise NotIdentifiableError(f"{n_parameters} coordinates need at least {needed} residuals; got {first.size}")
        if not np.abs(first).max() < 1e150:
            raise OutsideValidityError("the model must have finite residuals at the start; got some that are not")
        self.n_residuals = first.size

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        self.n_evaluations += 1
        try:
            residuals = self.problem.residuals(coordinates)
        except MonitorCoreError:
            return np.full(self.n_residuals, np.inf)
        # Beyond 1e150 the sum of squares overflows: as good as no answer.
        return residuals if np.max(np.abs(residuals), initial=0.0) < 1e150 else np.full(self.n_residuals, np.inf)

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        jacobian = self.problem.jacobian(coordinates)
        if not np.isfinite(jacobian).all():
            raise OutsideValidityError(f"the Jacobian must be finite; it is not at {coordinates.tolist()}")
        return jacobian

    def variance(self, residuals: FloatArray) -> float:
        if self.settings.uncertainties_stated:
            return 1.0
        # Never quite 0, so that correlations are left where the model meets the data exactly.
        return max(float(residuals @ residuals), 1e-200) / (residuals.size - len(self.problem.names))


def _polished(objective: _Objective, bounds: Bounds, coordinates: FloatArray) -> LocalFit:
    """Take linearised steps until they promise nothing, and state the fit there."""
    residuals = objective.residuals(coordinates)
    for _ in range(_POLISHING_ROUNDS):
        jacobian = objective.jacobian(coordinates)
        step, decrease = bounded_step(jacobian, residuals, bounds.lower - coordinates, bounds.upper - coordinates)
        if decrease <= _POLISHED_BELOW * objective.variance(residuals):
            break
        for shortened in (1.0, 0.5, 0.1, 0.01):
            trial = _onto_bounds(coordinates + shortened * step, bounds)
            there = objective.residuals(trial)
            if there @ there < residuals @ residuals:
                coordinates, residuals = trial, there
                break
        else:
            break  # rounding, or a minimum that the linearised step overlooks
    jacobian = objective.jacobian(coordinates)
    step, decrease = bounded_step(jacobian, residuals, bounds.lower - coordinates, bounds.upper - coordinates)
    variance = objective.variance(residuals)
    rounding = bool((np.abs(step) <= 1e-10 * np.abs(coordinates)).all())  # residuals of 0 have no scale of their own
    names = objective.problem.names
    near = _AT_BOUND * np.minimum(bounds.upper - bounds.lower, np.maximum(1.0, np.abs(coordinates)))
    return LocalFit(
        names=names,
        coordinates=VectorEstimate(
            coordinates,
            variance * inverse_information(jacobian),
            math.inf if objective.settings.uncertainties_stated else residuals.size - len(names),
        ),
        residuals=residuals,
        jacobian=jacobian,
        chi_squared=float(residuals @ residuals),
        residual_variance=variance,
        at_lower=tuple(np.array(names)[coordinates - bounds.lower <= near].tolist()),
        at_upper=tuple(np.array(names)[bounds.upper - coordinates <= near].tolist()),
        expected_decrease=decrease,
        converged=decrease <= CONVERGED_BELOW * variance or rounding,
        n_evaluations=objective.n_evaluations,
    )


def _onto_bounds(coordinates: FloatArray, bounds: Bounds) -> FloatArray:
    """Put what a step to the bound leaves off it by rounding exactly on it."""
    width = np.minimum(bounds.upper - bounds.lower, np.maximum(1.0, np.abs(coordinates)))
    onto = np.where(coordinates - bounds.lower <= 1e-12 * width, bounds.lower, coordinates)
    return np.where(bounds.upper - onto <= 1e-12 * width, bounds.upper, onto)
