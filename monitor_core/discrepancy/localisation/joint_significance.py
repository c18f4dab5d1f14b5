"""Test residuals jointly at one level: their size, their order, their trends and their signatures.

They are standard normal and independent where the model is right. Each p-value holds by itself; :func:`holm` makes them
hold together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.localisation.misfit_kind import Signature, explained
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import CONDITIONS, Grouping, Indices, levels_of

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
    return np.asarray(scipy.special.chdtrc(n, statistic))


def _two_sided(standardised: float) -> float:
    return float(2.0 * scipy.special.ndtr(-standardised))


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
            yield float(scipy.stats.binom.cdf(np.count_nonzero(products < 0.0), products.size, 0.5))
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
    ranks = scipy.stats.rankdata(levels[usable])
    if ranks.size < 3 or np.ptp(ranks) == 0.0:
        return 1.0
    spread = 2.0 / (9.0 * n[usable])
    sizes = scipy.stats.rankdata((np.cbrt(squares[usable] / n[usable]) - 1.0 + spread) / np.sqrt(spread))
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
    ranks, t, w = scipy.stats.rankdata(levels[usable]), along[usable], squares[usable]
    if ranks.size < 2 or np.ptp(ranks) == 0.0:
        return 1.0
    a = ranks - np.average(ranks, weights=w)
    return _two_sided(abs(a @ t) / np.sqrt(a**2 @ w))


#: Probability of any place at all where the model is right.
LEVEL = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class ResidualsUnderTest:
    """Residuals that are independent and standard normal where the model is right, and which of them count."""

    layout: Layout
    previous: Indices  # in the series, −1 for none, shape (n_values,)
    groupings: tuple[Grouping, ...]
    signatures: tuple[Signature, ...]  # the given ones first
    n_given: int
    residuals: FloatArray
    counts: BoolArray


@dataclass(frozen=True, slots=True)
class JointTest:
    """What all tests together say."""

    p_value: float  # the smallest, corrected
    in_groups: bool  # whether a group is too large, and not only the whole
    trends: tuple[ConditionAxis, ...]


def run_joint_tests(tested: ResidualsUnderTest) -> JointTest:
    """Run all tests at once and correct their p-values for their number."""
    residuals, of, layout = tested.residuals, tested.counts, tested.layout
    p_values = [float(chi_squared_p_value(np.sum(residuals[of] ** 2), int(np.count_nonzero(of))))]
    p_values += order_p_values(residuals, tested.previous, of)
    given = tested.signatures[: tested.n_given]
    for signature in given:
        gain, n_directions = explained(signature.rows[:, of], residuals[of])
        p_values.append(float(chi_squared_p_value(gain, max(n_directions, 1))))
    first_group = len(p_values)
    for grouping in tested.groupings:
        p_values += group_p_values(grouping, residuals, of).tolist()
    first_trend = len(p_values)
    trends = []
    for axis in CONDITIONS:
        levels = levels_of(layout, axis)
        for p_value in _trend_p_values(tested, given, levels):
            p_values.append(p_value)
            trends.append(axis)
    corrected = holm(p_values)
    significant = corrected[first_trend:] <= LEVEL
    return JointTest(
        p_value=float(np.min(corrected)),
        in_groups=bool(np.any(corrected[first_group:first_trend] <= LEVEL)),
        trends=tuple(dict.fromkeys(axis for axis, so in zip(trends, significant, strict=True) if so)),
    )


def _trend_p_values(tested: ResidualsUnderTest, given: Sequence[Signature], levels: FloatArray) -> Iterator[float]:
    """Yield p-values of sizes, and of amounts of the given signatures, that go with a condition."""
    if np.unique(levels[np.isfinite(levels)]).size < 2:
        return
    setting, n_settings = tested.layout.setting[tested.counts], levels.size
    residuals = tested.residuals[tested.counts]

    def per_setting(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(setting, weights=values, minlength=n_settings), dtype=np.float64)

    yield size_trend_p_value(levels, per_setting(residuals**2), per_setting(np.ones_like(residuals)))
    for signature in given:
        for row in signature.rows[:, tested.counts]:
            yield amount_trend_p_value(levels, per_setting(row * residuals), per_setting(row**2))
