"""Test residuals jointly at one level: their size, their order, their trends and their signatures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.localisation.misfit_kind import Signature, explained
from monitor_core.discrepancy.localisation.misfit_tests import (
    amount_trend_p_value,
    chi_squared_p_value,
    group_p_values,
    holm,
    order_p_values,
    size_trend_p_value,
)
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import CONDITIONS, Grouping, Indices, levels_of

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
