"""Fit the natural frequency of a drive as a polynomial over one of its conditions. Sun et al. (2022), section 4."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd

#: Places over the range at which the model is asked.
_PLACES = 101


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyLaw:
    """f ≈ Σ cᵢ xⁱ over a range; beyond it, it says nothing."""

    low: float
    high: float
    coefficients: FloatArray  # c₀ first [Hz per power of x]
    largest_residual: float  # over the range [Hz]

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", read_only(self.coefficients))


def frequency_law(
    model: DriveModel,
    conditions: Callable[[float], DriveConditions],
    between: tuple[float, float],
    degree: int,
    motor_end: MotorEnd | None = None,
) -> FrequencyLaw:
    """Fit the first elastic mode by least squares over evenly spaced values of x; ``conditions`` of each x.

    Fig. 7 of Sun et al. (2022): of degree 2 over the position, of degree 4 over the workpiece mass. Raises
    OutsideValidityError for a range without a width and for a model without an elastic mode; the model's own errors are
    raised.
    """
    low, high = between
    if not low < high:
        raise OutsideValidityError(f"expected a range from a lower to a higher value; got {low:g} to {high:g}")
    x = np.linspace(*between, _PLACES)
    modes = [model.natural_frequencies(conditions(value), motor_end) for value in x.tolist()]
    elastic = [[mode.frequency for mode in of_one if mode.frequency > 0.0] for of_one in modes]
    if not all(elastic):
        raise OutsideValidityError("expected a model with an elastic mode; got one of rigid-body modes alone")
    frequency = np.array([of_one[0] for of_one in elastic])
    fitted = np.polynomial.Polynomial.fit(x, frequency, degree)
    coefficients = np.asarray(fitted.convert().coef, dtype=np.float64)
    return FrequencyLaw(*between, coefficients, float(np.abs(fitted(x) - frequency).max()))
