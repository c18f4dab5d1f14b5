"""Compute the confidence interval of the mean of repeated readings, and compare two groups of them as the paper does.

Readings are independent, in any unit, shape (n_readings,); an interval is in the same unit. Fewer than two readings, or
one that is not finite, raise ``OutsideValidityError``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.uncertainty import Interval, IntervalKind


def confidence_interval_of_mean(readings: Sequence[float] | FloatArray, level: float = 0.95) -> Interval:
    r"""Return the confidence interval of the mean of a population, from a sample of it.

    .. math::

        \bar x \pm t^* \, s / \sqrt n

    Eq. (10) of Nguyen et al. (2018). For n = 20 the paper takes t* = 2.086, which belongs to 20 degrees of freedom. The
    n − 1 = 19 that its own text asks for give 2.093.

    Examples
    --------
    Twenty readings with mean 0 and standard deviation √20 have a half-width of t* itself:

    >>> readings = np.array([-1.0, 1.0] * 10) * math.sqrt(19.0)
    >>> round(confidence_interval_of_mean(readings).upper, 3)
    2.093
    """
    mean, scatter, n = _moments(readings)
    half = _student_t(n - 1, level) * scatter / math.sqrt(n)
    return Interval(mean - half, mean + half, IntervalKind.CONFIDENCE, level)


@dataclass(frozen=True, slots=True)
class PaperRule:
    """The paper's comparison of two groups of readings, by their confidence intervals of the mean."""

    baseline: Interval
    current: Interval

    @property
    def distinguished(self) -> bool:
        """Whether the two intervals do not overlap."""
        return self.baseline.upper < self.current.lower or self.current.upper < self.baseline.lower


def paper_rule(
    baseline_readings: Sequence[float] | FloatArray, current_readings: Sequence[float] | FloatArray, level: float = 0.95
) -> PaperRule:
    """Tell two preload levels apart as the paper does: their 95 % intervals of the mean must not overlap.

    Section 4 and Fig. 8 of Nguyen et al. (2018), with n = 20 readings in each group. This is what people see, not an
    alarm: the readings of a session share the scatter from day to day, so that groups of one and the same preload are
    told apart far more often than in 5 % of all cases.
    """
    return PaperRule(
        confidence_interval_of_mean(baseline_readings, level), confidence_interval_of_mean(current_readings, level)
    )


def _moments(readings: Sequence[float] | FloatArray) -> tuple[float, float, int]:
    values = np.asarray(readings, dtype=np.float64)
    if values.ndim != 1 or values.size < 2:
        raise OutsideValidityError(f"an interval needs at least 2 readings in a row; got shape {values.shape}")
    if not np.isfinite(values).all():
        raise OutsideValidityError("readings must be finite; got NaN or infinity")
    return float(values.mean()), float(values.std(ddof=1)), values.size


def _student_t(degrees_of_freedom: int, level: float) -> float:
    if not 0.0 < level < 1.0:
        raise OutsideValidityError(f"level must lie between 0 and 1; got {level}")
    return float(scipy.special.stdtrit(degrees_of_freedom, 0.5 * (1.0 + level)))
