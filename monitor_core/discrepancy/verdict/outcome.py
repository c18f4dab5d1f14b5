r"""Decide the outcome of a search: named, equivalent, partial, none or unknown.

A resonance that wanders is no effect of the catalogue: what wanders with the position or the preload is taken for a
resonance where it stands at some settings, and for a second one where it stands at others. So the own frequency f of
every effect is freed at each setting, everything else as it was found,

.. math:: \Delta\chi^2 = \sum_s \left( \chi^2_s(f) - \min_\theta \chi^2_s(f e^\theta) \right)

which counts by the evidence scale of the fit, at the price of one unknown for each setting. Where something else is
missing, too, the frequency of a resonance that stays takes up little of that.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.discrepancy.localisation import ranks_of
from monitor_core.discrepancy.search.workspace import PULLS_OF_TOLERANCES, STRAINED, are_pulled, variances_of_pulls
from monitor_core.discrepancy.verdict.classes import EquivalenceClass
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines, levels_of
from monitor_core.fitting.evidence import evidence_scale
from monitor_core.fitting.hold_out import JudgedGap, judged_gap
from monitor_core.fitting.solver.costs_of_settings import squares_along, summed_by_setting
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Probability below which it is no chance that errors of settings differ with a condition, of all that are looked at;
#: and of how many settings an order says something.
_BY_CHANCE, _FEWEST = 1e-3, 6


#: Variance of the pulls of settings: 2.2 at most on healthy machines; more is a drift, or an effect in disguise.
PULLS = 3.0
#: Where something is left, what was found must explain this share of the misfit; otherwise it may only stand in for the
#: true effect.
LEAST_SHARE = 0.95


def follow_conditions(fitted: Fitted[Physics]) -> bool:
    """Return whether the errors of settings go with how the axis was set, or with time, as no tolerance does.

    An analysis of variance of each kind of error over the levels of each condition, and its correlation with the order
    in which the settings were measured. Of so many looks one may come out by chance (Bonferroni).
    """
    looks = list(_chances(fitted))
    return bool(looks) and len(looks) * min(looks) < _BY_CHANCE


def _chances(fitted: Fitted[Physics]) -> Iterator[float]:
    """Yield the probability of each look at the errors of settings, were they independent of conditions and time."""
    layout = fitted.comparison.layout
    errors = fitted.around.whitened_by.pulls(fitted.misfit)
    for name, column in zip(fitted.comparison.condition_error_names, errors.T, strict=True):
        if name.startswith("gain"):
            continue
        known = np.isfinite(column)
        order = np.flatnonzero(known)
        if order.size > _FEWEST:
            yield _chance_of_order(column[known])
        for axis in ConditionAxis:
            of_setting = levels_of(layout, axis)
            groups = [column[known & (of_setting == level)] for level in np.unique(of_setting[known])]
            groups = [group for group in groups if group.size]
            if 1 < len(groups) < np.count_nonzero(known):
                yield _chance_of_groups(groups)


def _chance_of_order(values: FloatArray) -> float:
    """Return the probability of Spearman's correlation with the order of values, were there none."""
    correlation = float(np.corrcoef(np.arange(values.size), ranks_of(values))[0, 1])
    freedom = values.size - 2
    t = abs(correlation) * math.sqrt(freedom / max((1.0 - correlation) * (1.0 + correlation), 1e-300))
    return float(2.0 * scipy.special.stdtr(freedom, -t))


def _chance_of_groups(groups: Sequence[FloatArray]) -> float:
    """Return the probability of the variance between groups over that within, were they of one mean."""
    all_of_them, n_groups = np.concatenate(groups), len(groups)
    within = sum(float(np.sum((group - group.mean()) ** 2)) for group in groups)
    between = float(np.sum((all_of_them - all_of_them.mean()) ** 2)) - within
    freedom = all_of_them.size - n_groups
    ratio = between / (n_groups - 1) / max(within / freedom, 1e-300)
    return float(scipy.special.fdtrc(n_groups - 1, freedom, ratio))


@dataclass(frozen=True, slots=True, eq=False)
class Remainder:
    """What a fit leaves."""

    gap: JudgedGap
    pulls: Mapping[str, float]  # variances by kind of condition error, from :func:`variances_of_pulls`
    misfit: float  # beyond that of healthy axes, of residuals and of pulls, in χ²
    strain: float = 0.0  # the largest pull of a declared parameter, in σ
    of_settings: float = 0.0  # of this misfit, by the pulls of settings

    def is_pulled(self, allowed: float = PULLS) -> bool:
        """Return whether condition errors scatter more than is allowed."""
        return are_pulled(self.pulls, allowed)

    def misfit_under(self, allowed: float) -> float:
        """Return the misfit that is left: not that of settings whose tolerances are taken to be too small."""
        forgiven = allowed >= PULLS_OF_TOLERANCES and not self.is_pulled(allowed)
        return self.misfit - self.of_settings if forgiven else self.misfit

    def is_left(self, allowed: float = PULLS) -> bool:
        """Return whether anything is left that a healthy axis would not leave."""
        return self.gap.exceeds_healthy or self.is_pulled(allowed) or self.strain > STRAINED


def remainder_of(fitted: Fitted[Physics], *, counts_strain: bool = False) -> Remainder:
    r"""Return what a fit leaves.

    Of its misfit, what is beyond that of healthy axes is

    .. math::

        R = \chi^2 \left( 1 - \left( \frac{limit}{gap} \right)^2 \right) + n_{settings} \sum_k (s_k^2 - 1)
            + \sum_j p_j^2

    with the excess of the gap over what healthy axes leave, and of the variances of the pulls over one, both only where
    there is any. With ``counts_strain`` pulls :math:`p_j` of declared parameters beyond belief count, too: what has
    pulled them is missing beside what was found, or they are not as stated.
    """
    gap, pulls = judged_gap(fitted), variances_of_pulls(fitted)
    chi_squared = float(np.sum(fitted.standardised[fitted.fitted] ** 2))
    excess = 1.0 - (gap.most_of_healthy / gap.in_floors) ** 2 if gap.exceeds_healthy else 0.0
    excesses = sum(max(value - 1.0, 0.0) for name, value in pulls.items() if not name.startswith("gain"))
    of_settings = len(fitted.comparison.layout.settings) * excesses
    declared = np.abs(fitted.coordinates[: fitted.hypothesis.n_uncertain])
    strains = declared if counts_strain else np.zeros(0)
    misfit = chi_squared * excess + of_settings + float(np.sum(strains[strains > STRAINED] ** 2))
    return Remainder(gap, pulls, misfit, float(np.max(strains, initial=0.0)), of_settings)


def outcome_of(
    classes: Sequence[EquivalenceClass[Physics]],
    remainder: Remainder,
    *,
    explained: float,
    allowed: float = PULLS,
) -> Outcome:
    """Return the outcome, by what all accepted effects leave and by the share of :func:`explained_share`.

    ``allowed`` is the variance of the pulls of settings that counts as their scatter.
    """
    left = remainder.is_left(allowed)
    if not classes:
        return Outcome.UNKNOWN if left else Outcome.NONE
    plausible = [group for group in classes if group.is_plausible]
    if not plausible or (left and explained < LEAST_SHARE):
        return Outcome.UNKNOWN
    stand_ins = [group.representative.delta_bic for group in classes if not group.is_plausible]
    if sum(stand_ins) > sum(group.representative.delta_bic for group in plausible):
        return Outcome.UNKNOWN  # what has a name explains less than what stands in for something else
    if remainder.gap.exceeds_healthy and all(group.look_alikes for group in classes):
        return Outcome.UNKNOWN  # a model that lacks something distinguishes look-alikes by chance
    if left or len(plausible) < len(classes):
        return Outcome.PARTIAL
    return Outcome.EQUIVALENT if any(group.others for group in classes) else Outcome.NAMED


def names_nothing(baseline: Fitted[Physics], final: Fitted[Physics]) -> bool:
    """Return whether a fit leaves so much that none of its effects gets its name, whatever else would do."""
    remainder = remainder_of(final)
    explained = explained_share(baseline, final, remainder.misfit)
    left = remainder.gap.exceeds_healthy or (remainder.is_pulled() and follow_conditions(final))
    return left and explained < LEAST_SHARE


def explained_share(baseline: Fitted[Physics], final: Fitted[Physics], left: float) -> float:
    """Return the share :math:`(C_0 - C_1)/(C_0 - C_1 + R)` of the misfit that is gone, with costs C before and after.

    R, ``left``, is the misfit of :class:`Remainder`.
    """
    gained = baseline.cost - final.cost
    return gained / (gained + left) if gained > 0.0 else 0.0


#: θ: a resonance is narrow, so that no step may lie far from the next, and what wanders goes far.
_STEPS = np.concatenate([np.arange(0.01, 0.1, 0.01), np.arange(0.1, 0.3, 0.02), np.arange(0.3, 0.75, 0.05)])
_LN_FACTORS = np.concatenate([-_STEPS[::-1], _STEPS])
#: Of the misfit that is left, what a resonance that wanders takes up by its frequency alone.
_MOST_OF_REMAINDER = 0.5
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
        if of_effect.delta_bic > least and of_effect.taken > _MOST_OF_REMAINDER * remainder.misfit:
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

    def physics_at(frequency: float) -> Physics:
        moved = fitted.coordinates.copy()
        moved[index] = (frequency - own.null) / own.scale
        return fitted.hypothesis.physics(moved)

    tried, squares = squares_along(fitted, here * np.exp(np.append(0.0, _LN_FACTORS)), physics_at)
    table = np.array([summed_by_setting(fitted, np.where(fitted.fitted, each, 0.0)) for each in squares])
    best, scale = tried[np.argmin(table, axis=0)], evidence_scale(fitted)
    taken = float(np.sum(table[0] - np.min(table, axis=0)))
    evidence = scale.factor * taken - scale.penalty(best.size - 1)
    return Wandering(float(np.min(best)), float(np.max(best)), taken, evidence)
