"""What a fit needs of a problem: residuals in units of their uncertainty, and their derivatives."""

from dataclasses import dataclass
from typing import Protocol

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
