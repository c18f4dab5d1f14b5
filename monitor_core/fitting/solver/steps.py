r"""Find the minimum of a sum of squares next to a start, within bounds, by damped steps (Levenberg and Marquardt).

A step s minimises :math:`|J s + r|^2 + \mu |D s|^2` within the bounds, with the norms D of the columns of J: it follows
at once what the residuals r determine well, and what they hardly determine as far as they agree. The damping μ follows
the ratio of the fall of the sum to that foretold (H. B. Nielsen, Damping Parameter in Marquardt's Method,
IMM-REP-1999-05, Technical University of Denmark, 1999).

Residuals that are linearised anew at each step are not quite those that their derivatives belong to. So a search may
come to where steps that foretell a little fail however short they are, and ends there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Generic

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.problem import prior_jacobian, prior_residuals
from monitor_core.fitting.solver.derivatives import residual_jacobian
from monitor_core.fitting.solver.linearised import Linearised

#: Damping by how far a step came: at least this share of it is kept; a step that fails makes it larger, ever faster.
_KEPT, _LARGER = 0.2, 4.0
_MOST_DAMPING = 1e12
#: How many steps fail until a fall foretold that is this small is not sought any more, relatively.
_FAILURES, _SMALL = 3, 1e-3


@dataclass(frozen=True, slots=True)
class Patience:
    """How a search begins and when it ends."""

    most_evaluations: int  # of the residuals
    flat: float  # fall of the sum, relatively, with which it ends: by a step, or foretold for one that failed
    damping: float = 0.001  # to begin with: 1 and more where a start is far from the minimum


def minimum_by_damped_steps(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    patience: Patience,
) -> FloatArray:
    """Return the coordinates of the minimum, shape (n_coordinates,), or those it came to.

    ``residuals`` at coordinates have shape (n_residuals,), finite at the start within the bounds and infinite where a
    search must not go; the ``jacobian`` has shape (n_residuals, n_coordinates), and is asked for where it is used only.
    """
    coordinates, here = start, residuals(start)
    square, n_left, damping, failures = float(here @ here), patience.most_evaluations - 1, patience.damping, 0
    around = None
    while n_left > 0 and damping < _MOST_DAMPING:
        around = around or _Around.of(jacobian(coordinates), here)
        step, foretold = around.step(damping, (bounds[0] - coordinates, bounds[1] - coordinates))
        if not foretold > 0.0:
            break
        trial = np.clip(coordinates + step, *bounds)
        there = residuals(trial)
        n_left -= 1
        fall = square - float(there @ there)
        if fall > 0.0:
            coordinates, here, around, failures = trial, there, None, 0
            square -= fall
            damping *= max(_KEPT, 1.0 - (2.0 * fall / foretold - 1.0) ** 3)
            if fall < patience.flat * square:
                break
            continue
        failures += 1
        if foretold < (_SMALL if failures >= _FAILURES else patience.flat) * square:
            break
        damping *= _LARGER * 2.0 ** (failures - 1)
    return coordinates


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """Residuals as they are linear around some coordinates, reduced to as many as there are coordinates."""

    slopes: FloatArray  # upper triangle of J/D, shape (n_coordinates, n_coordinates)
    residuals: FloatArray  # shape (n_coordinates,)
    scale: FloatArray  # D, shape (n_coordinates,)

    @classmethod
    def of(cls, jacobian: FloatArray, residuals: FloatArray) -> "_Around":
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        directions, triangle = np.linalg.qr(jacobian / scale)
        return cls(triangle, directions.T @ residuals, scale)

    def step(self, damping: float, bounds: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, float]:
        """Return the damped step within the bounds of a step, and by how much the sum of squares would fall."""
        n = self.scale.size
        damped = np.vstack([self.slopes, np.sqrt(damping) * np.eye(n)])
        target = np.concatenate([-self.residuals, np.zeros(n)])
        lower, upper = (end * self.scale for end in bounds)
        step = np.clip(scipy.optimize.lsq_linear(damped, target, (lower, upper), method="bvls").x, lower, upper)
        left = self.residuals + self.slopes @ step
        return step / self.scale, float(self.residuals @ self.residuals - left @ left)


_PATIENCE, _FASTER = 10, 3.0  # steps before a search may be given up, and how much faster than now it might yet become
#: Phases wrap, so a misfit in logarithms is bounded; anything larger is no fit at all.
_LARGEST = 1e6


class GivenUpError(Exception):
    """A search is no longer worth it."""

    def __init__(self, coordinates: FloatArray) -> None:
        super().__init__("the search creeps towards a minimum that is no better than another one")
        self.coordinates = coordinates  # the best so far


class Pace:
    """Watch the costs that a search comes by, and leave it where it creeps and cannot beat a cost any more."""

    def __init__(self, patience: Patience, to_beat: float = math.inf) -> None:
        self.patience = patience
        self._left = patience.most_evaluations
        self._to_beat = to_beat
        self._best: list[float] = []  # costs, each lower than the one before
        self._at = np.zeros(0)

    def require(self, cost: Callable[[], float], coordinates: FloatArray) -> None:
        """Take the next cost down; raises GivenUpError."""
        if math.isinf(self._to_beat):
            return
        self._left -= 1
        here = cost()
        if not self._best or here < self._best[-1]:
            self._best.append(here)
            self._at = coordinates.copy()
        if len(self._best) > _PATIENCE:
            step = (self._best[-1 - _PATIENCE // 2] - self._best[-1]) / (_PATIENCE // 2)
            if self._best[-1] - _FASTER * step * self._left > self._to_beat:
                raise GivenUpError(self._at)


def remembered(
    around: Callable[[FloatArray], Linearised[Physics]], start: FloatArray, at_start: Linearised[Physics]
) -> Callable[[FloatArray], Linearised[Physics]]:
    """Return the same, computed once where a search has taken its last step, or one that was too long."""
    of_start = start.tobytes()
    linearised_at = lru_cache(maxsize=2)(lambda key: at_start if key == of_start else around(np.frombuffer(key)))
    return lambda coordinates: linearised_at(coordinates.tobytes())


class Steps(Generic[Physics]):
    """Residuals and their derivatives along a search, linearised anew at each step."""

    def __init__(
        self,
        around: Callable[[FloatArray], Linearised[Physics]],
        hypothesis: Hypothesis[Physics],
        chosen: BoolArray,
        pace: Pace,
    ) -> None:
        self._around, self._hypothesis, self._chosen, self._pace = around, hypothesis, chosen, pace
        self._of_prior = prior_jacobian(hypothesis.priors)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the residuals of the chosen values and the priors, infinite where the search must not go."""
        nowhere = np.full(np.count_nonzero(self._chosen) + len(self._of_prior), np.inf)
        try:
            around = self._around(coordinates)
        except OutsideValidityError:
            return nowhere  # the search shortens its step
        whitened = around.whitened_by(around.here)[self._chosen]
        if not np.max(np.abs(whitened)) < _LARGEST:
            return nowhere
        values = np.concatenate([whitened, prior_residuals(self._hypothesis.priors, coordinates)])
        square = float(values @ values)
        self._pace.require(lambda: square + around.whitened_by.log_determinant(self._chosen), coordinates)
        return values

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals."""
        of_values = residual_jacobian(self._around(coordinates), self._hypothesis, coordinates)
        return np.vstack([of_values[self._chosen], self._of_prior])


def nearest_minimum(
    around: Callable[[FloatArray], Linearised[Physics]],
    hypothesis: Hypothesis[Physics],
    start: FloatArray,
    chosen: BoolArray,
    pace: Pace,
) -> FloatArray:
    """Return the coordinates of the minimum next to a start.

    Raises GivenUpError on the way to a minimum that is no better than what is ``to_beat``.
    """
    steps = Steps(around, hypothesis, chosen, pace)
    if not np.all(np.isfinite(steps.residuals(start))):
        return start  # too far from the data for a slope to mean anything
    return minimum_by_damped_steps(steps.residuals, steps.jacobian, start, hypothesis.bounds, pace.patience)
