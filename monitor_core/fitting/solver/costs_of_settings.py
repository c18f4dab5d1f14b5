"""Say what each setting of a fit costs by itself, under its physics or under others near by."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.fitting.solver.hypothesis_fit import Fitted


def fitted_numbers(fitted: Fitted[Physics]) -> npt.NDArray[np.intp]:
    """Return which settings were fitted, shape (n_fitted_settings,)."""
    return np.flatnonzero(np.logical_or.reduceat(fitted.fitted, fitted.around.whitened_by.starts))


def costs_of_settings(fitted: Fitted[Physics], physics: Physics) -> FloatArray:
    """Return χ² of each setting that was fitted, whitened by its own condition errors alone, (n_fitted_settings,).

    Raises OutsideValidityError where the model has no answer.
    """
    return summed_by_setting(fitted, np.where(fitted.fitted, squares_of_values(fitted, physics), 0.0))


def squares_of_values(fitted: Fitted[Physics], physics: Physics) -> FloatArray:
    """Return what each value adds to that χ², or would where it was not fitted, shape (n_values,).

    Raises OutsideValidityError where the model has no answer.
    """
    whitened = replace(fitted.around.whitened_by, common=None)(fitted.around.misfit(physics))
    return np.asarray(whitened**2)


def summed_by_setting(fitted: Fitted[Physics], squares: FloatArray) -> FloatArray:
    """Return the sums over the values of each setting that was fitted, shape (n_fitted_settings,)."""
    of_settings = np.add.reduceat(squares, fitted.around.whitened_by.starts)
    return np.asarray(of_settings[fitted_numbers(fitted)])
