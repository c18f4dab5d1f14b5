r"""Tell a resonance that stays from one that wanders: no effect of the catalogue is at another frequency elsewhere.

What wanders with the position or the preload is taken for a resonance where it stands at some settings, and for a
second one where it stands at others: each explains a part of the settings only. So the own frequency f of every effect
is freed at each setting, everything else as it was found,

.. math:: \Delta\chi^2 = \sum_s \left( \chi^2_s(f) - \min_\theta \chi^2_s(f e^\theta) \right)

which counts by the evidence scale of the fit, at the price of one unknown for each setting. Where something else is
missing, too, the frequency of a resonance that stays takes up little of that.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.verdict.outcome import Remainder, remainder_of
from monitor_core.effects.effect import Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import evidence_scale
from monitor_core.fitting.solver.costs_of_settings import costs_of_settings
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: θ: a resonance is narrow, so that no step may lie far from the next, and what wanders goes far.
_STEPS = np.concatenate([np.arange(0.01, 0.1, 0.01), np.arange(0.1, 0.3, 0.02), np.arange(0.3, 0.75, 0.05)])
_LN_FACTORS = np.concatenate([-_STEPS[::-1], _STEPS])
#: Of the misfit that is left, what a resonance that wanders takes up by its frequency alone.
_LEAST_OF_REMAINDER = 0.5
#: The same where no other effect need be sought beside it.
_ALMOST_ALL = 0.8


@dataclass(frozen=True, slots=True)
class Wandering:
    """A resonance that would be at another frequency at each setting."""

    lowest: float  # of the settings [Hz]
    highest: float  # [Hz]
    taken: float  # of χ², by a frequency of its own at each setting
    delta_bic: float  # for that


def wandering(
    final: Fitted[Physics],
    effects: Iterable[tuple[Effect[Physics], float]],
    remainder: Remainder,
) -> dict[str, Wandering]:
    """Return by its key each effect whose own frequency wanders; with an effect comes the evidence for it, a ΔBIC.

    Where something is left, what wanders takes up most of that. Where nothing is, it explains more than the effect,
    which stood where it passes by: a small absorber that wanders leaves no more than a healthy axis does.
    """
    if not has_lines(final.comparison.layout):
        return {}
    left, wanders = remainder.is_left(), dict[str, Wandering]()
    most = evidence_scale(final).factor * final.cost  # all that a fit leaves
    for effect, evidence in effects:
        least = final.comparison.least_delta_bic if left else max(evidence, final.comparison.least_delta_bic)
        if effect.frequency is None or least > most:
            continue
        of_effect = wandering_of(final, effect)
        if of_effect.delta_bic > least and of_effect.taken > _LEAST_OF_REMAINDER * remainder.misfit:
            wanders[effect.key] = of_effect
    return wanders


def leaves_only_wandering(fitted: Fitted[Physics]) -> bool:
    """Return whether almost all that a fit leaves goes with a frequency of its own that wanders."""
    remainder = remainder_of(fitted)
    if not remainder.is_left():
        return False
    wanders = wandering(fitted, ((effect, math.inf) for effect in fitted.hypothesis.effects), remainder)
    return any(each.taken > _ALMOST_ALL * remainder.misfit for each in wanders.values())


def wandering_of(fitted: Fitted[Physics], effect: Effect[Physics]) -> Wandering:
    """Return what a frequency of its own at each setting would do for an effect that has one."""
    own, unknowns = effect.frequency, fitted.hypothesis.unknowns
    if own is None:
        raise OutsideValidityError(f"only an effect with a frequency of its own may wander; got {effect.key}")
    names = [(of.key, parameter.name) for of, parameter in unknowns]
    index = fitted.hypothesis.n_uncertain + names.index((effect.key, own.name))
    here = own.null + own.scale * float(fitted.coordinates[index])
    costs = {here: costs_of_settings(fitted, fitted.physics())}
    for frequency in (here * np.exp(_LN_FACTORS)).tolist():
        cost = _costs(fitted, index, (frequency - own.null) / own.scale)
        if cost is not None:
            costs[frequency] = cost
    tried, table = np.array(list(costs)), np.array(list(costs.values()))
    best, scale = tried[np.argmin(table, axis=0)], evidence_scale(fitted)
    taken = float(np.sum(costs[here] - np.min(table, axis=0)))
    evidence = scale.factor * taken - scale.penalty(best.size - 1)
    return Wandering(float(np.min(best)), float(np.max(best)), taken, evidence)


def _costs(fitted: Fitted[Physics], index: int, coordinate: float) -> FloatArray | None:
    moved = fitted.coordinates.copy()
    moved[index] = coordinate
    try:
        return costs_of_settings(fitted, fitted.hypothesis.physics(moved))
    except OutsideValidityError:
        return None
