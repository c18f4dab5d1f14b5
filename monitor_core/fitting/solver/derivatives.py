"""Differentiate the misfit of a hypothesis by its coordinates.

Where a comparison knows the slopes of its misfit, only the physics is moved; elsewhere the misfit, too: by finite
differences.
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasSlopes
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.linearised import Linearised
from monitor_core.models.extended import Move

_STEP = 1e-4  # of a coordinate


def residual_jacobian(
    around: Linearised[Physics], hypothesis: Hypothesis[Physics], coordinates: FloatArray, *, central: bool = False
) -> FloatArray:
    """Return the derivatives of the residuals where they are linearised, shape (n_values, n_coordinates)."""
    if not coordinates.size:
        return np.zeros((around.here.size, 0))
    take = derivative if central else one_sided_derivative
    slopes = _slopes(around, hypothesis, coordinates, central=central)
    columns = [
        take(around, hypothesis, coordinates, around.here, index) if slope is None else slope
        for index, slope in enumerate(slopes)
    ]
    whitened: FloatArray = around.whitened_by(np.array(columns)).T
    return whitened


def _slopes(
    around: Linearised[Physics], hypothesis: Hypothesis[Physics], coordinates: FloatArray, *, central: bool
) -> Sequence[FloatArray | None]:
    """Return the derivatives that the comparison knows."""
    comparison, columns = around.comparison, list[FloatArray | None]([None] * coordinates.size)
    if not isinstance(comparison, HasSlopes):
        return columns
    here, upper = hypothesis.physics(coordinates), hypothesis.bounds[1]
    moves: dict[int, Move[Physics]] = {}
    for index in range(coordinates.size):
        with suppress(OutsideValidityError):
            if central:
                ends = (-_STEP, _STEP)
            else:
                ends = (0.0, _STEP) if coordinates[index] + _STEP <= upper[index] else (-_STEP, 0.0)
            behind, ahead = (_moved(hypothesis, coordinates, index, step) if step else here for step in ends)
            moves[index] = Move(behind, ahead, ends[1] - ends[0])
    try:
        slopes = comparison.slopes(here, list(moves.values()))
    except OutsideValidityError:
        return columns
    for index, slope in zip(moves, slopes, strict=True):
        columns[index] = slope
    return columns


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
    return around.misfit(_moved(hypothesis, coordinates, index, step))


def _moved(hypothesis: Hypothesis[Physics], coordinates: FloatArray, index: int, step: float) -> Physics:
    moved = coordinates.copy()
    moved[index] += step
    return hypothesis.physics(moved)
