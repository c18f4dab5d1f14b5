"""Decide the outcome of a search: named, equivalent, partial, none or unknown."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.discrepancy.explanation import Outcome
from monitor_core.discrepancy.search.search import findings, strain
from monitor_core.discrepancy.search.workspace import PULLS_OF_TOLERANCES, STRAINED, are_pulled, variances_of_pulls
from monitor_core.discrepancy.verdict.classes import EquivalenceClass
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.fitting.conditions.groups import levels_of
from monitor_core.fitting.hold_out import JudgedGap, judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Probability below which it is no chance that errors of settings differ with a condition, of all that are looked at;
#: and of how many settings an order says something.
_BY_CHANCE, _FEWEST = 1e-3, 6


#: Variance of the pulls of settings: 2.2 at most on healthy machines; more is a drift, or an effect in disguise.
PULLS = 3.0
#: Where something is left, what was found must explain this share of the misfit; otherwise it may only stand in for the
#: true effect. And an effect that explains less of what is left, besides others, may be a part of it in disguise.
LEAST_SHARE, _LEAST_OF_REMAINDER = 0.95, 0.25


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
            yield float(scipy.stats.spearmanr(order, column[known]).pvalue)
        for axis in ConditionAxis:
            of_setting = levels_of(layout, axis)
            groups = [column[known & (of_setting == level)] for level in np.unique(of_setting[known])]
            groups = [group for group in groups if group.size]
            if 1 < len(groups) < np.count_nonzero(known):
                yield float(scipy.stats.f_oneway(*groups).pvalue)


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


def hidden_in_remainder(
    baseline: Fitted[Physics],
    final: Fitted[Physics],
    without: Callable[[Fitted[Physics], Effect[Physics]], Fitted[Physics]],
) -> Effect[Physics] | None:
    """Return the effect that explains least, if what is found leaves so much that it may be a part of that.

    ``without`` returns the fit without one of the effects. None is returned where the effects together do not explain
    enough to be believed: then nothing is named in any case.
    """
    effects, remainder = findings(final), remainder_of(final)
    if len(effects) < 2 or not remainder.is_left():
        return None
    if explained_share(baseline, final, remainder.misfit) < LEAST_SHARE:
        return None
    fits = [(without(final, effect), effect) for effect in effects]
    # what relieves a declared parameter of a strain is needed, however small beside what is left
    dispensable = [(lesser, effect) for lesser, effect in fits if strain(final, lesser) <= STRAINED]
    if not dispensable:
        return None
    least, effect = min(
        ((lesser.cost - final.cost, effect) for lesser, effect in dispensable), key=lambda pair: pair[0]
    )
    return effect if least < _LEAST_OF_REMAINDER * remainder.misfit else None
