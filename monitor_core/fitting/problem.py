"""What a fit needs of a problem: residuals in units of their uncertainty, and their derivatives.

Derivatives by differences, for functions without a closed form of theirs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Where each coordinate of a fit may lie."""

    lower: FloatArray  # shape (n_parameters,)
    upper: FloatArray  # shape (n_parameters,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", read_only(self.lower))
        object.__setattr__(self, "upper", read_only(self.upper))
        if self.lower.shape != self.upper.shape or self.lower.ndim != 1 or not (self.lower < self.upper).all():
            raise OutsideValidityError("lower bounds must lie below upper bounds, one of each per parameter")


class Problem(Protocol):
    """Residuals of a model against data, in coordinates that a fit may move freely.

    The coordinates are the fit's own (decimal logarithms of stiffnesses and dampings, or the parameters as they are):
    a fit knows nothing of them but their number. Residuals are divided by the standard uncertainty of the datum, so
    that their sum of squares is a χ² where the uncertainties are stated.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates, in order."""
        ...

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the weighted residuals, shape (n_residuals,) [-]."""
        ...

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return their derivatives, shape (n_residuals, n_parameters)."""
        ...


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
