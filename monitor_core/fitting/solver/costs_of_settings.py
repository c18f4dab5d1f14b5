"""Say what each setting of a fit costs by itself, under its physics or under others near by."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.solver.hypothesis_fit import Fitted


def fitted_numbers(fitted: Fitted[Physics]) -> npt.NDArray[np.intp]:
    """Return which settings were fitted, shape (n_fitted_settings,)."""
    return np.flatnonzero(np.logical_or.reduceat(fitted.fitted, fitted.around.whitened_by.starts))


def squares_along(
    fitted: Fitted[Physics], grid: FloatArray, physics_at: Callable[[float], Physics]
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the values of a grid at which the model has an answer, and what each value of the data adds to χ² there.

    It is whitened by the condition errors of its own setting alone, those that were not fitted alike.
    """
    answered, squares = list[float](), list[FloatArray]()
    for value in grid.tolist():
        with suppress(OutsideValidityError):
            squares.append(squares_of_values(fitted, physics_at(value)))
            answered.append(value)
    return np.array(answered), squares


def squares_of_values(fitted: Fitted[Physics], physics: Physics) -> FloatArray:
    """Return what each value adds to χ², or would where it was not fitted, shape (n_values,).

    Raises OutsideValidityError where the model has no answer.
    """
    whitened = replace(fitted.around.whitened_by, common=None)(fitted.around.misfit(physics))
    return np.asarray(whitened**2)


def summed_by_setting(fitted: Fitted[Physics], squares: FloatArray) -> FloatArray:
    """Return the sums over the values of each setting that was fitted, shape (n_fitted_settings,)."""
    of_settings = np.add.reduceat(squares, fitted.around.whitened_by.starts)
    return np.asarray(of_settings[fitted_numbers(fitted)])
