"""Derivatives by differences, for functions without a closed form of theirs."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray

_Number = TypeVar("_Number", np.float64, np.complex128)


def central_differences(
    function: Callable[[FloatArray], npt.NDArray[_Number]], coordinates: FloatArray, step: float
) -> npt.NDArray[_Number]:
    r"""Return the derivatives of a function from four points of each coordinate, shape (n_parameters, n_values).

    .. math::

        y' = \frac{8 (y_{+h} - y_{-h}) - (y_{+2h} - y_{-2h})}{12 h} + O(h^4)

    with the step h in decades. Two points reach 1e-8, which is not enough: joints in series (bearing, bracket,
    coupling) are not told apart by any natural frequency, and errors of 1e-8 pass for what tells them apart. The
    standard uncertainty of a predicted frequency of Nguyen's axis then comes out a third too large.
    """
    slopes = []
    for direction in step * np.eye(coordinates.size):
        near = function(coordinates + direction) - function(coordinates - direction)
        far = function(coordinates + 2.0 * direction) - function(coordinates - 2.0 * direction)
        slopes.append((8.0 * near - far) / (12.0 * step))
    return np.array(slopes)
