r"""Least squares within bounds in a region of trust (Levenberg, Marquardt, Moré), and what is known of the minimum.

A step s minimises :math:`|J s + r|^2` within the bounds [1]_ and with :math:`|D s|` no longer than the residuals r have
turned out to go as their derivatives J foretell [2]_. It follows at once what they determine well, and what they hardly
determine as far as they agree; it ends on a bound, and not near it. D are the norms of the columns of J, which forget
larger ones of steps before slowly: a coordinate that ceases to matter on a plateau is not thrown about there.

Residuals that are linearised anew at each step are not quite those that their derivatives belong to. So a search may
come to where steps that foretell a little fail however short they are, and ends there.

References
----------
.. [1] P. B. Stark, R. L. Parker, Computational Statistics 10 (1995) 129-141.
.. [2] J. J. Moré, The Levenberg-Marquardt algorithm: implementation and theory, LNM 630 (1978) 105-116.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import MonitorCoreError, NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds, Problem
from monitor_core.uncertainty import VectorEstimate

#: A step that falls by less than so much of what was foretold, or by more: the next may be a quarter as long, or twice.
_LESS, _MORE = 0.25, 0.75
#: What is kept of a larger norm of a column from step to step. With 0.5 one of 54 searches for certified values ends
#: elsewhere; with 1 a fit of peaks that hardly show a damping creeps.
_KEPT = 0.7
#: So little damping, relative, moves no determined direction; without it an unseen one runs to a bound for nothing.
_LEAST_DAMPING = 1e-16
#: Within which share the length of a step need meet what is trusted, and how many trials find it.
_NEAR, _TRIALS = 0.05, 12
#: How many steps fail until a fall that may be foretold for nothing is not sought any more.
_FAILURES = 3
_SHORTEST = 1e-16  # step, of the coordinates


@dataclass(frozen=True, slots=True)
class Patience:
    """How a search begins and when it ends."""

    most_evaluations: int  # of the residuals
    flat: float  # fall of the sum, relatively, with which it ends: by a step, or foretold for one that failed
    for_nothing: float = 0.0  # fall, relatively, that residuals may foretell which are linearised anew at each step


def minimum(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    patience: Patience,
) -> FloatArray:
    """Return the coordinates of the minimum next to a start, shape (n_coordinates,), or those it came to.

    ``residuals`` at coordinates have shape (n_residuals,), finite at the start within the bounds and infinite where a
    search must not go; the ``jacobian`` has shape (n_residuals, n_coordinates), and is asked for where it is used only.
    """
    coordinates, here = start, residuals(start)
    square, n_left, failures, trusted = float(here @ here), patience.most_evaluations - 1, 0, math.inf
    around, scale = None, np.zeros(start.size)
    while n_left > 0:
        if around is None:
            around = _Around.of(jacobian(coordinates), here, _KEPT * scale)
            scale = around.scale
            if coordinates is start:
                trusted = float(np.linalg.norm(scale * start)) or math.inf
        trial, length, foretold = around.step(coordinates, trusted, bounds)
        if not foretold > 0.0:
            break
        there = residuals(trial)
        n_left -= 1
        fall = square - float(there @ there)
        if not fall > _LESS * foretold:
            trusted = _LESS * length
        elif fall > _MORE * foretold:
            trusted = max(trusted, 2.0 * length)
        if fall > 0.0:
            coordinates, here, around, failures = trial, there, None, 0
            square -= fall
            if fall < patience.flat * square:
                break
            continue
        failures += 1
        if foretold < max(patience.flat, patience.for_nothing * (failures >= _FAILURES)) * square:
            break
        if length <= _SHORTEST * np.linalg.norm(scale * coordinates):
            break
    return coordinates


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """Residuals as they are linear around some coordinates, along the directions of J/D."""

    residuals: FloatArray  # along the directions, shape (n_coordinates,)
    singular: FloatArray  # shape (n_coordinates,)
    directions: FloatArray  # as rows, shape (n_coordinates, n_coordinates)
    scale: FloatArray  # D, shape (n_coordinates,)

    @classmethod
    def of(cls, jacobian: FloatArray, residuals: FloatArray, least_scale: FloatArray) -> "_Around":
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), least_scale)
        scale[scale == 0.0] = 1.0
        base, triangle = np.linalg.qr(jacobian / scale)
        left, singular, directions = np.linalg.svd(triangle, full_matrices=False)
        return cls(left.T @ (base.T @ residuals), singular, directions, scale)

    def step(
        self, coordinates: FloatArray, trusted: float, bounds: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, float, float]:
        """Return where the step leads, its length in D, and by how much the sum of squares would fall."""
        damping, slopes = self._damping(trusted), self.singular[:, None] * self.directions
        step = -self.directions.T @ (self.singular * self.residuals / (self.singular**2 + damping))
        end = coordinates + step / self.scale
        if np.any(end < bounds[0]) or np.any(end > bounds[1]):
            n = self.scale.size
            damped = np.vstack([slopes, math.sqrt(damping) * np.eye(n)])
            room = [(bound - coordinates) * self.scale for bound in bounds]
            bounded = scipy.optimize.lsq_linear(damped, np.append(-self.residuals, np.zeros(n)), room, method="bvls")
            step = bounded.x
            end = np.clip(coordinates + step / self.scale, *bounds)
            end = np.where(bounded.active_mask < 0, bounds[0], np.where(bounded.active_mask > 0, bounds[1], end))
        left = self.residuals + slopes @ step
        return end, float(np.linalg.norm(step)), float(self.residuals @ self.residuals - left @ left)

    def _damping(self, trusted: float) -> float:
        """Return μ of a step that is as long as is trusted, or next to none where that step is shorter."""
        squares, pull = self.singular**2, self.singular * self.residuals
        least = max(_LEAST_DAMPING * float(squares[0]), 1e-300)
        if np.linalg.norm(pull / (squares + least)) <= trusted:
            return least
        low, high = least, max(float(np.linalg.norm(pull)) / trusted, 2.0 * least)
        damping = max(1e-3 * high, low)
        for _ in range(_TRIALS):
            step = pull / (squares + damping)
            length = float(np.linalg.norm(step))
            if abs(length - trusted) < _NEAR * trusted:
                break
            low, high = (low, damping) if length < trusted else (damping, high)
            # Newton's step for 1/length, which is nearly linear in μ
            damping += length**2 * (length - trusted) / (trusted * float(np.sum(step**2 / (squares + damping))))
            if not low < damping < high:
                damping = math.sqrt(low * high)
        return damping


#: Relative singular value of the column-scaled Jacobian below which nothing is known along a direction. The variance
#: there is finite, so that it drops out of what does not depend on it, and is larger than any that is of use.
_UNSEEN = 1e-10


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


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How a local fit is made."""

    uncertainties_stated: bool = True  #: residuals are in units of stated uncertainties; else their scatter is used
    patience: Patience = Patience(500, flat=1e-12)  #: of the search


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

    Steps to where the model has no answer (residuals not finite, or an error of the core) are refused and shortened.
    Covariance

    .. math::

        (J^T J)^{-1} \quad\text{or}\quad s^2 (J^T J)^{-1}, \qquad s^2 = \frac{\chi^2}{n - p}

    where the uncertainties of the data are stated or not. Where the data do not determine every coordinate their
    variance is very large, which :func:`~monitor_core.identification.identifiability.assess` puts into words.
    ``converged`` says whether the linearised decrease of χ² that is left is below 1e-6 of the residual variance.

    Raises NotIdentifiableError if there are fewer residuals than coordinates (or as many, where their scatter is to be
    estimated), or if no coordinate moves any residual at the minimum; OutsideValidityError if the start is outside the
    bounds, or if residuals or Jacobian are not finite where they are needed.
    """
    settings = settings or FitSettings()
    objective = _Objective(problem, bounds, np.asarray(start, dtype=np.float64), settings)
    ends, names = (bounds.lower, bounds.upper), problem.names
    coordinates = minimum(objective.residuals, objective.jacobian, objective.start, ends, settings.patience)
    residuals, jacobian = objective.residuals(coordinates), objective.jacobian(coordinates)
    _column_scale(jacobian)
    there, _, decrease = _Around.of(jacobian, residuals, np.zeros(len(names))).step(coordinates, math.inf, ends)
    variance = objective.variance(residuals)
    rounding = bool((np.abs(there - coordinates) <= 1e-10 * np.abs(coordinates)).all())  # residuals of 0 have no scale
    return LocalFit(
        names=names,
        coordinates=VectorEstimate(
            coordinates,
            variance * inverse_information(jacobian),
            math.inf if settings.uncertainties_stated else residuals.size - len(names),
        ),
        residuals=residuals,
        jacobian=jacobian,
        chi_squared=float(residuals @ residuals),
        residual_variance=variance,
        at_lower=tuple(np.array(names)[coordinates == bounds.lower].tolist()),
        at_upper=tuple(np.array(names)[coordinates == bounds.upper].tolist()),
        expected_decrease=max(decrease, 0.0),
        converged=decrease <= CONVERGED_BELOW * variance or rounding,
        n_evaluations=objective.n_evaluations,
    )


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
