r"""Judge every record by itself: how far it is from a model, and how far with another tag or gain.

With the misfit m of a record, the deviations :math:`\sigma` of its values and the change S of the misfit by its
condition errors, χ² of a record under given physics is

.. math::

    \chi^2 = r^T (I + T^T T)^{-1} r, \qquad r = m/\sigma, \qquad T = S/\sigma

A direction g with an unknown amount, such as a gain, takes :math:`(g^T C^{-1} m)^2 / (g^T C^{-1} g)` of it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison

#: From the median of absolute deviations to the standard deviation of a normal distribution.
_NORMAL = 1.4826
#: When likely errors are the same, in standard deviations; and beyond which one is taken as linear.
_SAME, _LIKELY = 0.05, 5.0


@dataclass(frozen=True, slots=True, eq=False)
class RecordCosts:
    """The misfits of all records under one model, each with the condition errors that are likely for it."""

    setting: npt.NDArray[np.intp]  # of each value, shape (n_values,)
    scaled: FloatArray  # misfit in standard deviations, shape (n_values,)
    deviation: FloatArray  # shape (n_values,)
    directions: FloatArray  # T, shape (n_errors, n_values)
    inverse: FloatArray  # (I + T T^T)^-1 of each record, shape (n_settings, n_errors, n_errors)

    @property
    def chi_squared(self) -> FloatArray:
        """χ² of each record, shape (n_settings,)."""
        return self._product(self.scaled, self.scaled)

    @property
    def n_values(self) -> FloatArray:
        """How many values a record has, shape (n_settings,)."""
        return np.bincount(self.setting).astype(np.float64)

    def taken_by(self, change: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what an unknown amount of a change of the misfit, (n_values,), takes of χ², the amount, its deviation.

        The shapes are (n_settings,); the amount of a record that the change does not move is 0, its deviation infinite.
        """
        along = change / self.deviation
        slope, information = self._product(along, self.scaled), self._product(along, along)
        known = information > 0.0
        safe = np.where(known, information, 1.0)
        amount = np.where(known, -slope / safe, 0.0)
        return np.where(known, slope**2 / safe, 0.0), amount, np.where(known, safe**-0.5, np.inf)

    def likely_errors(self) -> FloatArray:
        """Return the most likely condition errors, in the deviations that they scatter by, (n_settings, n_errors)."""
        along = np.stack([np.bincount(self.setting, weights=row * self.scaled) for row in self.directions], axis=-1)
        return np.asarray(-np.einsum("skl,sl->sk", self.inverse, along))

    def _product(self, first: FloatArray, second: FloatArray) -> FloatArray:
        plain = np.bincount(self.setting, weights=first * second)
        a, b = (
            np.stack([np.bincount(self.setting, weights=row * values) for row in self.directions], axis=-1)
            for values in (first, second)
        )
        return np.asarray(plain - np.einsum("sk,skl,sl->s", a, self.inverse, b))


def record_costs(
    comparison: Comparison[Physics], physics: Physics, scatter: FloatArray, n_rounds: int = 4
) -> RecordCosts:
    """Return the misfits of all records, linearised around the condition errors that are likely for each.

    ``scatter`` is by how much condition errors scatter in the tolerances that are assumed, shape (n_errors,).
    In each of ``n_rounds`` the likely errors and the misfit around them are found anew.
    """
    layout = comparison.layout
    deviation, setting = layout.standard_deviation, layout.setting
    errors = np.zeros((len(layout.settings), scatter.size))
    for _ in range(n_rounds):
        try:
            around = comparison.shifted(errors)
            misfit = around.misfit(physics)
        except OutsideValidityError:
            errors = np.zeros_like(errors)
            around = comparison
            misfit = around.misfit(physics)
        change = around.condition_errors(physics, misfit)
        scaled = (misfit - np.sum(change * errors[setting].T, axis=0)) / deviation
        directions = change * scatter[:, None] / deviation
        grams = np.array([[np.bincount(setting, weights=row * other) for other in directions] for row in directions])
        inverse = np.linalg.inv(np.eye(scatter.size) + np.moveaxis(grams, -1, 0))
        costs = RecordCosts(setting, scaled, deviation, directions, inverse)
        likely = np.clip(costs.likely_errors(), -_LIKELY, _LIKELY) * scatter
        if np.max(np.abs(likely - errors), initial=0.0) < _SAME:
            break
        errors = likely
    return costs


def scatter_of(pulls: FloatArray) -> FloatArray:
    """Return by how much each kind of condition error scatters, 1 at the least, as the bulk of the records shows it.

    ``pulls`` have shape (n_settings, n_errors); a single one that is far out does not count for it.
    """
    scatter = [
        _NORMAL * float(np.median(np.abs(column[np.isfinite(column)]))) if np.any(np.isfinite(column)) else 1.0
        for column in pulls.T
    ]
    return np.maximum(scatter, 1.0)


def least_along(
    cost: Callable[[FloatArray], FloatArray], grid: FloatArray, n_halvings: int
) -> tuple[FloatArray, FloatArray]:
    """Return where along a grid the costs of all records are least, and the costs there, shape (n_settings,) both.

    ``cost`` takes a value for each record and answers with its cost, shape (n_settings,); ``grid`` has shape
    (n_values, n_settings), rising. The grid is halved so many times around the best value of each record.
    """
    costs = np.array([cost(row) for row in grid])
    columns = np.arange(grid.shape[1])
    best = np.argmin(costs, axis=0)
    at, least = grid[best, columns], costs[best, columns]
    below = at - grid[np.maximum(best - 1, 0), columns]
    step = np.maximum(below, grid[np.minimum(best + 1, len(grid) - 1), columns] - at)
    for _ in range(n_halvings):
        step = 0.5 * step
        low, high = (np.clip(at + side * step, grid[0], grid[-1]) for side in (-1.0, 1.0))
        of_low, of_high = cost(low), cost(high)
        lower = np.where(of_low < of_high, low, high)
        at = np.where(np.minimum(of_low, of_high) < least, lower, at)
        least = np.minimum(np.minimum(of_low, of_high), least)
    return at, least
