"""A start of a fit with an effect in the place of a parameter that has been pulled far from what is stated.

The two may add up to the same along a valley too long and bent for a fit to go through.
"""

import math
from collections.abc import Iterator
from typing import TypeVar

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.effect import Effect
from monitor_core.discrepancy.effects import PREFIX
from monitor_core.discrepancy.hypothesis import is_size, searched_coordinates
from monitor_core.discrepancy.searching.fit import Fitted
from monitor_core.discrepancy.searching.scan import resonance_of
from monitor_core.errors import OutsideValidityError

Physics = TypeVar("Physics")

#: Standard deviations: a parameter so far from what is stated may stand in for an effect.
_PULLED = 3.0
_SMALLEST, _LARGEST = 0.1, 1e4  # sizes that are tried, in scales: a range may have no end
_FINE = 1.25  # ratio of sizes of which one brings modes near to where the parameter has brought them


def instead(fitted: Fitted[Physics], effect: Effect[Physics]) -> FloatArray | None:
    """Return the coordinates of a fit with an effect in the place of the parameter that is pulled furthest.

    Parameters
    ----------
    fitted : Fitted
        Without the effect.
    effect : Effect

    Returns
    -------
    ndarray, shape (n_coordinates,), or None
        With the size that fits best and the parameter as stated. None where no parameter is pulled far, where the
        effect resonates or frees a parameter itself, or where the model has no answer with it.
    """
    hypothesis = fitted.hypothesis.with_effect(effect)
    pulls = np.abs(fitted.coordinates[: fitted.hypothesis.n_uncertain])
    frees = effect.key.removeprefix(PREFIX) in fitted.hypothesis.uncertain
    if frees or resonance_of(effect) is not None or np.max(pulls, initial=0.0) < _PULLED:
        return None
    there = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
    there[np.argmax(pulls)] = 0.0
    size_at = there.size - len(effect.parameters) + next(n for n, one in enumerate(effect.parameters) if is_size(one))
    best, least = None, math.inf
    for size in _sizes(effect):
        trial = there.copy()
        trial[size_at] = size
        try:
            standardised = fitted.around.residuals(hypothesis.physics(trial))
        except OutsideValidityError:
            continue
        cost = float(np.sum(standardised[fitted.fitted] ** 2))
        if cost < least:
            best, least = trial, cost
    return best


def _sizes(effect: Effect[Physics]) -> Iterator[float]:
    low, high = searched_coordinates(effect, next(one for one in effect.parameters if is_size(one)))
    largest = min(max(-low, high), _LARGEST)
    for size in np.geomspace(_SMALLEST, largest, math.ceil(math.log(largest / _SMALLEST, _FINE)) + 1).tolist():
        yield from (signed for signed in (size, -size) if low <= signed <= high)
