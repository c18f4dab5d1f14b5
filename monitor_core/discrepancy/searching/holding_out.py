"""What a hypothesis is worth where it was not fitted."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.comparing.comparison import Comparison, Layout
from monitor_core.discrepancy.searching.evidence import Yardstick
from monitor_core.discrepancy.searching.fit import Fitted, fit
from monitor_core.errors import OutsideValidityError

Physics = TypeVar("Physics")


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals of values from fits that did not see them."""

    chosen: BoolArray  # which values were held out, shape (n_values,)
    misfit: FloatArray  # shape (n_values,); meaningful where chosen
    standardised: FloatArray  # shape (n_values,); meaningful where chosen


def fitted_values(layout: Layout) -> BoolArray:
    """Return the values a fit sees: all but a single fold, or all where folds are left out in turn."""
    return ~layout.held_out[0] if len(layout.held_out) == 1 else np.ones(layout.n_values, dtype=np.bool_)


def hold_out(fitted: Fitted[Physics]) -> HeldOut | None:
    """Return the residuals of held-out values; each of several folds is left out of a fit of its own.

    None where nothing is held out.
    """
    folds = fitted.comparison.layout.held_out
    if not folds:
        return None
    if len(folds) == 1:
        return HeldOut(folds[0], fitted.misfit, fitted.standardised)
    misfit, standardised = np.zeros_like(fitted.misfit), np.zeros_like(fitted.misfit)
    for fold in folds:
        without = _refitted(fitted, ~fold)
        misfit[fold], standardised[fold] = without.misfit[fold], without.standardised[fold]
    return HeldOut(np.any(folds, axis=0), misfit, standardised)


def _refitted(fitted: Fitted[Physics], chosen: BoolArray) -> Fitted[Physics]:
    try:
        return fit(fitted.comparison, fitted.hypothesis, fitted.coordinates, chosen)
    except OutsideValidityError:
        return fitted


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
