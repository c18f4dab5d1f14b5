"""Judge a fit on the values that it did not see, and whether it leaves more than scatter."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import BoolArray
from monitor_core.effects.effect import Physics
from monitor_core.fitting.comparison import Comparison, Layout
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.solver.hypothesis_fit import Fitted, HeldOut

#: Gap in floors. Healthy cases stay within 1 % of one floor where the form error was learnt.
REMAINDER = 1.08
_HEALTHY_SHARE = 0.99  # of healthy axes whose gap on independent values is taken for no more than scatter


def fitted_values(layout: Layout) -> BoolArray:
    """Return the values a fit sees: all but a single fold, or all where folds are left out in turn."""
    return ~layout.held_out[0] if len(layout.held_out) == 1 else np.ones(layout.n_values, dtype=np.bool_)


def gain(before: HeldOut | None, after: HeldOut | None, scale: EvidenceScale) -> float:
    """Return the gain of log-likelihood on values that neither fit saw, NaN without any."""
    if before is None or after is None:
        return math.nan
    first, second = before.standardised[before.chosen], after.standardised[after.chosen]
    return 0.5 * scale.factor * float(first @ first - second @ second)


def expected_gain(before: HeldOut, after: HeldOut, scale: EvidenceScale) -> float:
    """Return what the gain would be on average if the second of two hypotheses were the truth."""
    change = (before.standardised - after.standardised)[before.chosen]
    return 0.5 * scale.factor * float(change @ change)


def gap_of(comparison: Comparison[Physics], held_out: HeldOut | None) -> float:
    """Return the gap on held-out values, NaN without any."""
    return math.nan if held_out is None else comparison.gap(held_out.misfit, held_out.standardised, held_out.chosen)


@dataclass(frozen=True, slots=True)
class JudgedGap:
    """The gap of a fit against what a healthy axis may leave."""

    fit: float  # on the values that were fitted, in the unit of the comparison
    held_out: float  # on those that were not; NaN without any
    in_floors: float  # the larger of both, in noise floors [-]
    most_of_healthy: float  # what a healthy axis may leave, in noise floors [-]

    @property
    def exceeds_healthy(self) -> bool:
        """Whether the gap is larger than that of a healthy axis."""
        return self.in_floors > self.most_of_healthy


def judged_gap(fitted: Fitted[Physics]) -> JudgedGap:
    """Return the gap of a fit on the values it saw and on those it did not.

    What a healthy axis may leave is judged by the held-out values where there are any: the rms of few values scatters
    by itself.
    """
    gap, held_out = fitted.gap, gap_of(fitted.comparison, fitted.held_out)
    judged = fitted.fitted if fitted.held_out is None else fitted.held_out.chosen
    n_judged = int(np.count_nonzero(judged))
    most = max(REMAINDER, math.sqrt(2.0 * float(scipy.special.gammaincinv(n_judged / 2.0, _HEALTHY_SHARE)) / n_judged))
    return JudgedGap(gap, held_out, float(np.nanmax([gap, held_out])) / fitted.comparison.noise_floor, most)
