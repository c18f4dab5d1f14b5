"""Narrow a misfit to the place that holds it: the fewest groups that separate it from the rest."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.fitting.conditions.groups import Grouping

#: A neighbour belongs to the place if it has this share of the mean square of the worst: half of its amplitude.
_BELONGS = 0.25
#: Probability at which the groups of a place and the others are said to differ.
_DIFFERS = 1e-3


def narrow(groupings: Sequence[Grouping], squares: FloatArray, of: BoolArray) -> dict[int, list[int]]:
    """Return the groups, by index of their grouping, that hold the misfit; groupings that do not matter are left out.

    The grouping that separates the misfit best from the rest comes first; each of the next is tested within it.
    ``squares`` are those of residuals that are standard normal where the model is right; those ``of`` are tested.
    """
    chosen: dict[int, list[int]] = {}
    while True:
        inside = within(groupings, chosen, of)
        options = {
            index: _worst_groups(grouping, squares, inside)
            for index, grouping in enumerate(groupings)
            if index not in chosen
        }
        gain, index = max(((gain, index) for index, (gain, _) in options.items()), default=(0.0, -1))
        if gain <= 0.0:
            return chosen
        chosen[index] = options[index][1]


def within(groupings: Sequence[Grouping], chosen: Mapping[int, Sequence[int]], of: BoolArray) -> BoolArray:
    """Return which of some values are in the chosen groups of every grouping, shape (n_values,)."""
    place = of.copy()
    for index, groups in chosen.items():
        place &= groupings[index].holds(groups)
    return place


def _worst_groups(grouping: Grouping, squares: FloatArray, of: BoolArray) -> tuple[float, list[int]]:
    r"""Return the groups that hold the misfit and how clearly they differ from the rest, 0 if they do not.

    The measure is the gain of log-likelihood by two variances in place of one,
    :math:`\frac{1}{2} (n \ln s^2 - n_{in} \ln s_{in}^2 - n_{out} \ln s_{out}^2)`, none of them below 1.
    """
    n, sums = (grouping.sums(values, of) for values in (np.ones_like(squares), squares))
    present = np.flatnonzero(n > 0.0)
    excess = sums[present] / n[present] - 1.0
    worst = int(np.argmax(excess * np.sqrt(n[present])))
    belongs = excess >= _BELONGS * excess[worst]
    if grouping.ordered:
        gaps = np.flatnonzero(~belongs)
        first = np.max(gaps[gaps < worst], initial=-1) + 1
        end = np.min(gaps[gaps > worst], initial=belongs.size)
        belongs = (np.arange(belongs.size) >= first) & (np.arange(belongs.size) < end)
    groups = present[belongs].tolist()
    inside = of & grouping.holds(groups)
    parts = [squares[of], squares[inside], squares[of & ~inside]]
    if excess[worst] <= 0.0 or not parts[2].size:
        return 0.0, groups
    whole, hot, rest = (max(float(np.mean(part)), 1.0) for part in parts)
    if stats.f.sf(hot / rest, parts[1].size, parts[2].size) > _DIFFERS:
        return 0.0, groups
    terms = [part.size * np.log(variance) for part, variance in zip(parts, (whole, hot, rest), strict=True)]
    return 0.5 * float(terms[0] - terms[1] - terms[2]), groups
