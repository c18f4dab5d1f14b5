"""Find starts of fits with an effect substituted for a pulled parameter, or for another effect.

A parameter that has been pulled far from what is stated may stand in for an effect: the two may add up to the same
along a valley that is too long and bent for a fit to go through. And once an effect has brought the model to the data,
others may do as well that screening from far away has missed.
"""

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening.projection import Projection
from monitor_core.effects.effect import Effect, EffectParameter, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.hypothesis import is_size, searched_coordinates
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Standard deviations: a parameter so far from what is stated may stand in for an effect.
_PULLED = 3.0
_SMALLEST, _LARGEST = 0.1, 1e4  # sizes that are tried, in scales: a range may have no end
_FINE = 1.25  # ratio of sizes: some size then brings modes near to where the parameter has brought them
_COARSE, _FINER = 2.0, (2.0**0.5, 2.0**0.25, 2.0**0.125)  # the same, and then about the best of them


def substitute_parameter(fitted: Fitted[Physics], effect: Effect[Physics]) -> FloatArray | None:
    """Return the coordinates of a fit with an effect substituted for the parameter that is pulled furthest.

    The effect has the size that fits best, and the parameter is as stated. None where no parameter is pulled far except
    one that the effect itself frees, where the effect has a frequency of its own, or where the model has no answer with
    it.
    """
    hypothesis = fitted.hypothesis.with_effect(effect)
    there = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
    pulls = np.abs(there[: hypothesis.n_uncertain])
    if effect.frequency is not None or np.max(pulls, initial=0.0) < _PULLED:
        return None
    there[np.argmax(pulls)] = 0.0

    def cost(trial: FloatArray) -> float:
        standardised = fitted.around.residuals(hypothesis.physics(trial))
        return float(np.sum(standardised[fitted.fitted] ** 2))

    size_at = there.size - len(effect.parameters)
    least, best = _best(there, size_at, _sizes(effect, effect.parameters[0], _FINE), cost)
    return best if math.isfinite(least) else None


def substitute_effect(
    found: Fitted[Physics], effect: Effect[Physics], other: Effect[Physics]
) -> tuple[float, FloatArray]:
    """Return by how much χ² rises with another effect substituted for a found effect, and where.

    The rise is that at the best of the sizes of the other effect, what is left taken up linearly. It is infinite where
    the model has no answer, and for an effect with a frequency of its own, of which a few sizes tell nothing. The
    coordinates are of the hypothesis with the other effect as its last.
    """
    hypothesis = found.hypothesis.without(effect.key).with_effect(other)
    there = hypothesis.carried_over(found.hypothesis, found.coordinates)
    if other.frequency is not None:
        return math.inf, there
    projection = Projection(found, without=effect)
    here = projection.residuals(found.standardised)

    def rise(trial: FloatArray) -> float:
        left = projection.residuals(found.around.residuals(hypothesis.physics(trial)))
        return float(left @ left - here @ here)

    first = there.size - len(other.parameters)
    least, best = math.inf, there
    for at, parameter in enumerate(other.parameters, first):
        if not is_size(parameter):
            continue
        found_there = _best(there, at, _sizes(other, parameter, _COARSE), rise)
        low, high = searched_coordinates(other, parameter)
        for factor in _FINER:
            size = found_there[1][at]
            around = [finer for finer in (size * factor, size / factor) if low <= finer <= high]
            found_there = min(found_there, _best(found_there[1], at, around, rise), key=lambda pair: pair[0])
        least, best = min((least, best), found_there, key=lambda pair: pair[0])
    return least, best


def _best(
    at: FloatArray, index: int, values: Iterable[float], cost: Callable[[FloatArray], float]
) -> tuple[float, FloatArray]:
    """Return the least cost of values of one coordinate, and where; infinite, at ``at``, where there is no answer."""
    least, best = math.inf, at
    for value in values:
        trial = at.copy()
        trial[index] = value
        try:
            here = cost(trial)
        except OutsideValidityError:
            continue
        if here < least:
            least, best = here, trial
    return least, best


def _sizes(effect: Effect[Physics], parameter: EffectParameter, ratio: float) -> Iterator[float]:
    low, high = searched_coordinates(effect, parameter)
    largest = min(max(-low, high), _LARGEST)
    for size in np.geomspace(_SMALLEST, largest, math.ceil(math.log(largest / _SMALLEST, ratio)) + 1).tolist():
        yield from (signed for signed in (size, -size) if low <= signed <= high)
