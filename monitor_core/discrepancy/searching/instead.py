"""Starts of fits with an effect in the place of something that may stand in for it.

Of a parameter that has been pulled far from what is stated: the two may add up to the same along a valley too long and
bent for a fit to go through. And of another effect, once that one has brought the model to the data: looks from far
away pass by effects that would do as well.
"""

import math
from collections.abc import Iterator
from typing import TypeVar

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.effect import Effect, EffectParameter
from monitor_core.discrepancy.effects import PREFIX
from monitor_core.discrepancy.hypothesis import is_size, searched_coordinates
from monitor_core.discrepancy.searching.fit import Fitted
from monitor_core.discrepancy.searching.scan import Projection
from monitor_core.errors import OutsideValidityError

Physics = TypeVar("Physics")

#: Standard deviations: a parameter so far from what is stated may stand in for an effect.
_PULLED = 3.0
_SMALLEST, _LARGEST = 0.1, 1e4  # sizes that are tried, in scales: a range may have no end
_FINE = 1.25  # ratio of sizes of which one brings modes near to where the parameter has brought them
_COARSE, _FINER = 2.0, (2.0**0.5, 2.0**0.25, 2.0**0.125)  # the same, and then about the best of them


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
    if frees or effect.resonance is not None or np.max(pulls, initial=0.0) < _PULLED:
        return None
    there = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
    there[np.argmax(pulls)] = 0.0
    size_at = there.size - len(effect.parameters) + _size_of(effect)[0]
    best, least = None, math.inf
    for size in _sizes(effect, _FINE):
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


def in_place_of(found: Fitted[Physics], effect: Effect[Physics], other: Effect[Physics]) -> tuple[float, FloatArray]:
    """Return by how much χ² rises with another effect in the place of one that was found, and where.

    Parameters
    ----------
    found : Fitted
        With the effect.
    effect, other : Effect

    Returns
    -------
    float
        Rise of χ² at the best size of the other effect, what is left taken up linearly; infinite where the model has no
        answer.
    ndarray, shape (n_coordinates,)
        Coordinates there, of the hypothesis with the other effect as its last.
    """
    hypothesis = found.hypothesis.without(effect.key).with_effect(other)
    there = hypothesis.carried_over(found.hypothesis, found.coordinates)
    place, size_parameter = _size_of(other)
    size_at = there.size - len(other.parameters) + place
    projection = Projection(found, without=effect)
    here = projection.residuals(found.standardised)

    def tried(size: float) -> tuple[float, FloatArray]:
        trial = there.copy()
        trial[size_at] = size
        try:
            left = projection.residuals(found.around.residuals(hypothesis.physics(trial)))
        except OutsideValidityError:
            return math.inf, trial
        return float(left @ left - here @ here), trial

    best = min((tried(size) for size in _sizes(other, _COARSE)), key=lambda pair: pair[0], default=(math.inf, there))
    low, high = searched_coordinates(other, size_parameter)
    for factor in _FINER:
        around = [best[1][size_at] * factor, best[1][size_at] / factor]
        best = min(best, *(tried(size) for size in around if low <= size <= high), key=lambda pair: pair[0])
    return best


def _size_of(effect: Effect[Physics]) -> tuple[int, EffectParameter]:
    """Return the first size among the parameters of an effect, with its place."""
    return next((place, one) for place, one in enumerate(effect.parameters) if is_size(one))


def _sizes(effect: Effect[Physics], ratio: float) -> Iterator[float]:
    low, high = searched_coordinates(effect, _size_of(effect)[1])
    largest = min(max(-low, high), _LARGEST)
    for size in np.geomspace(_SMALLEST, largest, math.ceil(math.log(largest / _SMALLEST, ratio)) + 1).tolist():
        yield from (signed for signed in (size, -size) if low <= signed <= high)
