"""Take the steps of least squares to the minimum next to a start, linearised anew at each of them."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Generic

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.free_parameter import prior_jacobian, prior_residuals
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.damped_steps import Patience, minimum_by_damped_steps
from monitor_core.fitting.solver.derivatives import residual_jacobian
from monitor_core.fitting.solver.linearised import Linearised

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
    known = lru_cache(maxsize=2)(lambda key: at_start if key == of_start else around(np.frombuffer(key)))
    return lambda coordinates: known(coordinates.tobytes())


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
        found = np.concatenate([whitened, prior_residuals(self._hypothesis.priors, coordinates)])
        square = float(found @ found)
        self._pace.require(lambda: square + around.whitened_by.log_determinant(self._chosen), coordinates)
        return found

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
