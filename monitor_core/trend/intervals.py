"""Compute intervals of repeated readings: of their mean, of the next reading, of the population.

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


def prediction_interval_of_next(readings: Sequence[float] | FloatArray, level: float = 0.95) -> Interval:
    r"""Return the prediction interval of the next reading of the same population.

    .. math::

        \bar x \pm t^* \, s \sqrt{1 + 1/n}

    Eq. (4.1) of [1]_. A single new reading is to be judged with this one, never with the interval of the mean.

    References
    ----------
    .. [1] W. Q. Meeker, G. J. Hahn, L. A. Escobar, Statistical Intervals, 2nd ed., Wiley, 2017.
    """
    return prediction_interval(*_moments(readings), level)


def prediction_interval(mean: float, scatter: float, n_readings: int, level: float = 0.95) -> Interval:
    """Return the prediction interval from mean, standard deviation and number of the readings."""
    half = _student_t(n_readings - 1, level) * scatter * math.sqrt(1.0 + 1.0 / n_readings)
    return Interval(mean - half, mean + half, IntervalKind.PREDICTION, level)


def tolerance_interval_of_population(
    readings: Sequence[float] | FloatArray, share: float = 0.95, level: float = 0.95
) -> Interval:
    """Return an interval that holds a stated share of a normal population, with a stated confidence: its level."""
    mean, scatter, n = _moments(readings)
    half = tolerance_factor(n, share, level) * scatter
    return Interval(mean - half, mean + half, IntervalKind.TOLERANCE, level)


def tolerance_factor(n_readings: int, share: float = 0.95, level: float = 0.95) -> float:
    r"""Return the exact two-sided tolerance factor of a normal population with unknown mean and variance.

    Solves, for the factor :math:`k`,

    .. math::

        \int P\!\left(\chi^2_{n-1} > \frac{(n-1)\,\chi^2_{1;p}(z^2/n)}{k^2}\right) \varphi(z)\,dz = \gamma

    Eq. (2.3.4) of [1]_, with :math:`p` the share and :math:`\gamma` the confidence: half of the interval in sample
    standard deviations. ``OutsideValidityError`` for fewer than two readings, or if share or level do not lie between 0
    and 1.

    Examples
    --------
    Table of [1]_ for n = 20, 95 % of the population with 95 % confidence:

    >>> round(tolerance_factor(20), 3)
    2.76

    References
    ----------
    .. [1] K. Krishnamoorthy, T. Mathew, Statistical Tolerance Regions, Wiley, 2009.
    """
    if n_readings < 2:
        raise OutsideValidityError(f"an interval needs at least 2 readings; got {n_readings}")
    if not (0.0 < share < 1.0 and 0.0 < level < 1.0):
        raise OutsideValidityError(f"share and level must lie between 0 and 1; got {share} and {level}")
    z, weights = scipy.special.roots_hermitenorm(60)
    weights = weights / weights.sum()
    # p-quantile of the non-central χ² with one degree of freedom: half-width that holds the share around an off centre
    half_width_squared = scipy.special.chndtrix(share, 1.0, z**2 / n_readings)

    def shortfall(factor: float) -> float:
        survival = scipy.special.chdtrc(n_readings - 1.0, (n_readings - 1.0) * half_width_squared / factor**2)
        return float(weights @ survival) - level

    upper = 10.0
    while shortfall(upper) < 0.0:
        upper *= 10.0
    return float(scipy.optimize.brentq(shortfall, 1e-3, upper, xtol=1e-10))


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
