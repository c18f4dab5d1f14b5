"""Differentiate the misfit of a hypothesis by its coordinates, by finite differences."""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.linearised import Linearised

_STEP = 1e-4  # of a coordinate


def residual_jacobian(
    around: Linearised[Physics], hypothesis: Hypothesis[Physics], coordinates: FloatArray, *, central: bool = False
) -> FloatArray:
    """Return the derivatives of the residuals where they are linearised, shape (n_values, n_coordinates)."""
    if not coordinates.size:
        return np.zeros((around.here.size, 0))
    take = derivative if central else one_sided_derivative
    columns = [take(around, hypothesis, coordinates, around.here, index) for index in range(coordinates.size)]
    whitened: FloatArray = around.whitened_by(np.array(columns)).T
    return whitened


def derivative(
    around: Linearised[Physics],
    hypothesis: Hypothesis[Physics],
    coordinates: FloatArray,
    misfit: FloatArray,
    index: int,
) -> FloatArray:
    """Return the derivative of the misfit with respect to one coordinate, shape (n_values,).

    It is a central difference, so that what other coordinates can take up of it cancels to rounding. It is one-sided
    where the model has no answer on the other side.
    """
    sides = []
    for step in (_STEP, -_STEP):
        try:
            sides.append((step, _moved_misfit(around, hypothesis, coordinates, index, step)))
        except OutsideValidityError:
            sides.append((0.0, misfit))
    (ahead, there), (behind, back) = sides
    if ahead == behind:
        return np.zeros_like(misfit)
    return around.comparison.layout.difference(there, back) / (ahead - behind)


def one_sided_derivative(
    around: Linearised[Physics],
    hypothesis: Hypothesis[Physics],
    coordinates: FloatArray,
    misfit: FloatArray,
    index: int,
) -> FloatArray:
    """Return a cheaper derivative, good enough on the way to a minimum, shape (n_values,)."""
    step = _STEP if coordinates[index] + _STEP <= hypothesis.bounds[1][index] else -_STEP
    try:
        there = _moved_misfit(around, hypothesis, coordinates, index, step)
    except OutsideValidityError:
        return derivative(around, hypothesis, coordinates, misfit, index)
    return around.comparison.layout.difference(there, misfit) / step


def _moved_misfit(
    around: Linearised[Physics], hypothesis: Hypothesis[Physics], coordinates: FloatArray, index: int, step: float
) -> FloatArray:
    moved = coordinates.copy()
    moved[index] += step
    return around.misfit(hypothesis.physics(moved))
