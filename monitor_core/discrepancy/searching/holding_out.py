"""What a hypothesis is worth where it was not fitted."""

from typing import TypeVar

import numpy as np

from monitor_core.arrays import BoolArray
from monitor_core.discrepancy.comparing.comparison import Comparison, Layout
from monitor_core.discrepancy.searching.evidence import Yardstick
from monitor_core.discrepancy.searching.fit import HeldOut

Physics = TypeVar("Physics")


def fitted_values(layout: Layout) -> BoolArray:
    """Return the values a fit sees: all but a single fold, or all where folds are left out in turn."""
    return ~layout.held_out[0] if len(layout.held_out) == 1 else np.ones(layout.n_values, dtype=np.bool_)


def gain(before: HeldOut, after: HeldOut, by: Yardstick) -> float:
    """Return the gain of log-likelihood on values that neither fit saw."""
    first, second = before.standardised[before.chosen], after.standardised[after.chosen]
    return 0.5 * by.factor * float(first @ first - second @ second)


def promised_gain(before: HeldOut, after: HeldOut, by: Yardstick) -> float:
    """Return what the gain would be on average if the second of two hypotheses were the truth."""
    change = (before.standardised - after.standardised)[before.chosen]
    return 0.5 * by.factor * float(change @ change)


def gap_of(comparison: Comparison[Physics], one: HeldOut | None) -> float:
    """Return the gap on held-out values, NaN without any."""
    return float("nan") if one is None else comparison.gap(one.misfit, one.standardised, one.chosen)
