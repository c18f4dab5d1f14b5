"""Test residuals that are standard normal and independent where the model is right: size, order, trend, direction.

Each p-value holds by itself; :func:`holm` makes them hold together.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special, stats

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.fitting.conditions.groups import Grouping, Indices

_LAGS = 10
#: With fewer pairs of neighbours the sum of their products is far from normal.
_FEWEST_PAIRS = 50


def holm(p_values: Sequence[float]) -> FloatArray:
    """Return p-values corrected for their number (Holm 1979), in the order given, shape (n_tests,)."""
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)
    stepped = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def chi_squared_p_value(statistic: FloatArray | float, n: FloatArray | int) -> FloatArray:
    """Return the probability of a larger sum of n squares; SciPy's distribution takes ten times as long to say it."""
    return np.asarray(special.chdtrc(n, statistic))


def _two_sided(standardised: float) -> float:
    return float(2.0 * special.ndtr(-standardised))


def group_p_values(grouping: Grouping, residuals: FloatArray, of: BoolArray) -> FloatArray:
    """Return the p-value of a too large sum of squares (χ²) of each group that has values."""
    n = grouping.sums(np.ones_like(residuals), of)
    squares = grouping.sums(residuals**2, of)
    return chi_squared_p_value(squares[n > 0.0], n[n > 0.0])


def order_p_values(residuals: FloatArray, previous: Indices, of: BoolArray) -> Iterator[float]:
    r"""Yield p-values of residuals that follow one another along their series: runs, and whiteness.

    The medians are known, so that signs of neighbours differ as a fair coin falls, and few changes, that is long runs,
    have an exact binomial probability. Whiteness is tested with the statistic of Ljung and Box (1978) over ten lags,

    .. math:: Q = \sum_l r_l^2 N_l, \qquad r_l = \frac{\sum e_t e_{t-l} / N_l}{\sum e_t^2 / n}

    with :math:`N_l` pairs over all series. ``previous`` is the value before each one in its series, −1 for none; those
    ``of`` are tested.
    """
    here = np.flatnonzero(of)
    if not np.any(residuals[here]):
        return
    there, q, mean_square = here, 0.0, float(np.mean(residuals[here] ** 2))
    for lag in range(1, _LAGS + 1):
        follows = previous[there] >= 0
        here, there = here[follows], previous[there[follows]]
        both = of[there]
        products = residuals[here[both]] * residuals[there[both]]
        if lag == 1 and products.size:
            yield float(stats.binom.cdf(np.count_nonzero(products < 0.0), products.size, 0.5))
        if products.size < _FEWEST_PAIRS:
            return
        q += float(np.sum(products)) ** 2 / (products.size * mean_square**2)
    yield float(chi_squared_p_value(q, _LAGS))


def size_trend_p_value(levels: FloatArray, squares: FloatArray, n: FloatArray) -> float:
    r"""Return the p-value of a rank correlation of the sizes of residuals with a condition.

    Sums of squares are first brought to one distribution by their cube root (Wilson and Hilferty 1931), since settings
    have different numbers of values, ``n``. Spearman's coefficient times :math:`\sqrt{n - 1}` is nearly standard
    normal, with ties too, and bounded, so that few settings never show a trend by luck. All arrays have shape
    (n_settings,); a level is NaN where it is not stated.
    """
    usable = np.isfinite(levels) & (n > 0.0)
    ranks = stats.rankdata(levels[usable])
    if ranks.size < 3 or np.ptp(ranks) == 0.0:
        return 1.0
    spread = 2.0 / (9.0 * n[usable])
    sizes = stats.rankdata((np.cbrt(squares[usable] / n[usable]) - 1.0 + spread) / np.sqrt(spread))
    if np.ptp(sizes) == 0.0:
        return 1.0
    coefficient = float(np.corrcoef(ranks, sizes)[0, 1])
    return _two_sided(abs(coefficient) * np.sqrt(ranks.size - 1.0))


def amount_trend_p_value(levels: FloatArray, along: FloatArray, squares: FloatArray) -> float:
    r"""Return the p-value of an amount of a signature that goes with the ranks of a condition.

    With :math:`t = \sum s e` (``along``) and :math:`w = \sum s^2` (``squares``) of each setting and the ranks a less
    their mean weighted with w, :math:`\sum a t / \sqrt{\sum a^2 w}` is exactly standard normal and blind to an amount
    that is the same everywhere. Shapes and levels are as in :func:`size_trend_p_value`.
    """
    usable = np.isfinite(levels) & (squares > 0.0)
    ranks, t, w = stats.rankdata(levels[usable]), along[usable], squares[usable]
    if ranks.size < 2 or np.ptp(ranks) == 0.0:
        return 1.0
    a = ranks - np.average(ranks, weights=w)
    return _two_sided(abs(a @ t) / np.sqrt(a**2 @ w))
