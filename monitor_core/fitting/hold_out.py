"""What a hypothesis is worth where it was not fitted, and whether it leaves more than scatter."""

import math
from typing import TypeVar

import numpy as np
from scipy.stats import chi2

from monitor_core.arrays import BoolArray
from monitor_core.fitting.comparison import Comparison, Layout
from monitor_core.fitting.evidence import Yardstick
from monitor_core.fitting.solver.hypothesis_fit import Fitted, HeldOut

Physics = TypeVar("Physics")

#: Gap in floors. Healthy cases stay within 1 % of one floor where the form error was learnt.
REMAINDER = 1.08
_HEALTHY_SHARE = 0.99  # of healthy axes whose gap on independent values is taken for no more than scatter


def fitted_values(layout: Layout) -> BoolArray:
    """Return the values a fit sees: all but a single fold, or all where folds are left out in turn."""
    return ~layout.held_out[0] if len(layout.held_out) == 1 else np.ones(layout.n_values, dtype=np.bool_)


def gain(before: HeldOut | None, after: HeldOut | None, by: Yardstick) -> float:
    """Return the gain of log-likelihood on values that neither fit saw, NaN without any."""
    if before is None or after is None:
        return math.nan
    first, second = before.standardised[before.chosen], after.standardised[after.chosen]
    return 0.5 * by.factor * float(first @ first - second @ second)


def promised_gain(before: HeldOut, after: HeldOut, by: Yardstick) -> float:
    """Return what the gain would be on average if the second of two hypotheses were the truth."""
    change = (before.standardised - after.standardised)[before.chosen]
    return 0.5 * by.factor * float(change @ change)


def gap_of(comparison: Comparison[Physics], one: HeldOut | None) -> float:
    """Return the gap on held-out values, NaN without any."""
    return float("nan") if one is None else comparison.gap(one.misfit, one.standardised, one.chosen)


def judged_values(fitted: Fitted[Physics]) -> BoolArray:
    """Return the values that count: those held out, or those fitted where none are, shape (n_values,)."""
    return fitted.fitted if fitted.held_out is None else fitted.held_out.chosen


def leaves_something(fitted: Fitted[Physics]) -> bool:
    """Tell whether a fit leaves a larger gap than a healthy axis would."""
    comparison = fitted.comparison
    gap = in_floors(comparison.noise_floor, fitted.gap, gap_of(comparison, fitted.held_out))
    return gap > most_of_healthy(int(np.count_nonzero(judged_values(fitted))))


def in_floors(noise_floor: float, of_fit: float, of_held_out: float) -> float:
    """Return a gap in noise floors, on the values where it is larger: those of the fit, or those held out."""
    return float(np.nanmax([of_fit, of_held_out])) / noise_floor


def most_of_healthy(n_judged: int) -> float:
    """Return the largest gap of healthy axes, in floors: the rms of few values scatters by itself."""
    return max(REMAINDER, math.sqrt(float(chi2.ppf(_HEALTHY_SHARE, n_judged)) / n_judged))
