"""Records of numbers with their uncertainty, and the intervals around them (GUM / VIM words)."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError


class IntervalKind(StrEnum):
    """Which question an interval answers."""

    CONFIDENCE = "confidence"  #: where the mean of the population lies
    PREDICTION = "prediction"  #: where the next measurement will lie
    TOLERANCE = "tolerance"  #: where a stated share of the population lies
    COVERAGE = "coverage"  #: where the measurand lies, all known uncertainties included (GUM)


@dataclass(frozen=True, slots=True)
class Interval:
    """An interval that says which kind it is and how often it covers."""

    lower: float
    upper: float
    kind: IntervalKind
    level: float = 0.95

    def __post_init__(self) -> None:
        if not self.lower <= self.upper:
            raise OutsideValidityError(f"lower must not exceed upper; got [{self.lower}, {self.upper}]")
        if not 0.0 < self.level < 1.0:
            raise OutsideValidityError(f"level must lie between 0 and 1; got {self.level}")

    def covers(self, value: float) -> bool:
        """Tell whether a value lies inside, bounds included."""
        return self.lower <= value <= self.upper


def decimals_of(uncertainty: float) -> int:
    """Return the decimals that show two significant digits of an uncertainty (GUM, 7.2.6); below 0: tens, hundreds.

    Examples
    --------
    >>> decimals_of(0.0996), decimals_of(13.2), decimals_of(1340.0)
    (2, 0, -2)
    """
    return 1 - int(f"{uncertainty:.1e}".partition("e")[2])


def plus_minus(value: float, uncertainty: float) -> str:
    """Write a value with its uncertainty, of whichever level: two significant digits of that (GUM, 7.2.6).

    Where the uncertainty is 0 or not known the value stands alone, with three digits; where it is less than a computed
    number can be off, with six.

    Examples
    --------
    >>> plus_minus(204.04, 1.42), plus_minus(200.4, 13.3), plus_minus(-1234.0, 160.0)
    ('204.0 ± 1.4', '200 ± 13', '-1230 ± 160')
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0.0 and math.isfinite(value)):
        return f"{value:.3g}"
    if uncertainty <= _ROUNDING * abs(value):
        return f"{value:.6g}"
    decimals = decimals_of(uncertainty)
    if decimals > _MOST_DECIMALS:
        digits = max(decimals + math.floor(math.log10(abs(value))), 0) if value else 0
        return f"{value:.{digits}e} ± {uncertainty:.1e}"
    value, uncertainty = (round(number, decimals) + 0.0 for number in (value, uncertainty))  # no minus before a zero
    return f"{value:.{max(decimals, 0)}f} ± {uncertainty:.{max(decimals, 0)}f}"


#: Of a value that is computed, relative [-].
_ROUNDING = 1e-12
#: More than these are written with a power of ten.
_MOST_DECIMALS = 6


def enlargement(degrees_of_freedom: float) -> float:
    """Return by what an uncertainty of few degrees of freedom is enlarged, so that 1.96 times it covers 95 % [-]."""
    return float(scipy.special.stdtrit(degrees_of_freedom, 0.975) / scipy.special.ndtri(0.975))


def beyond_others(rows: FloatArray, covariance: FloatArray, also: FloatArray | float = 0.0) -> float:
    r"""Return how much less is known of the last of some values than of any other, each against the mean of the others.

    Values are :math:`r_i^\mathsf{T}\theta` with the covariance of θ, shape (n_parameters, n_parameters), and rows
    r of shape (n_values, n_parameters); ``also`` joins the variances. Returned is a standard uncertainty, 0 at least.
    """
    apart = rows - rows[:-1].mean(axis=0)
    variance = np.einsum("ci,ij,cj->c", apart, covariance, apart) + also
    *others, last = np.sqrt(np.maximum(variance, 0.0)).tolist()
    return float(max(0.0, last - max(others)))


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard uncertainty and the degrees of freedom behind it."""

    value: float
    standard_uncertainty: float
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise OutsideValidityError(f"value must be finite; got {self.value}")
        if not self.standard_uncertainty >= 0.0:
            raise OutsideValidityError(f"standard_uncertainty must not be negative; got {self.standard_uncertainty}")
        if not self.degrees_of_freedom > 0.0:
            raise OutsideValidityError(f"degrees_of_freedom must be positive; got {self.degrees_of_freedom}")

    @property
    def expanded_uncertainty(self) -> float:
        """Half the width of the interval that covers 95 %: Student's t times the standard uncertainty (GUM, G.3)."""
        return float(scipy.special.stdtrit(self.degrees_of_freedom, 0.975)) * self.standard_uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class VectorEstimate:
    """Several values with their joint covariance."""

    values: FloatArray  # shape (n,)
    covariance: FloatArray  # shape (n, n)
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", read_only(self.values))
        object.__setattr__(self, "covariance", read_only(self.covariance))
        n = self.values.shape[0]
        if self.covariance.shape != (n, n):
            raise OutsideValidityError(f"covariance must have shape ({n}, {n}); got {self.covariance.shape}")

    @property
    def standard_uncertainties(self) -> npt.NDArray[np.float64]:
        """Square roots of the diagonal, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))
