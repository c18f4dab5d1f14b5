"""What a search means: named, equivalent, partial, none or unknown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from monitor_core.discrepancy.explanation import GapPair, Outcome
from monitor_core.discrepancy.verdict.classes import EquivalenceClass
from monitor_core.effects.effect import Effect
from monitor_core.fitting.hold_out import gap_of, in_floors, judged_values, most_of_healthy
from monitor_core.fitting.solver.hypothesis_fit import Fitted

Physics = TypeVar("Physics")


@dataclass(frozen=True, slots=True)
class OutcomeSettings:
    """When something is left. The figures are set on simulated machines, see benchmarks/hidden_effects."""

    #: Where something is left, what was found must explain this share of the misfit, or it may stand for the true
    #: effect as well.
    least_share: float = 0.95
    #: Variance of the pulls of settings: 2.2 at most on healthy machines; more is a drift, or an effect in disguise.
    pulls: float = 3.0
    #: Of what is left: an effect that explains less, beside others, may be a part of it in disguise.
    least_of_remainder: float = 0.25


def variances_of_pulls(fitted: Fitted[Physics]) -> dict[str, float]:
    """Return the variance of each kind of setting error, 1 on average where all is right.

    About their mean: that all settings err alike is what a tolerance of the nut, or an offset, is for.
    """
    errors = fitted.around.whitened_by.pulls(fitted.misfit)
    found = {}
    for name, column in zip(fitted.comparison.setting_error_names, errors.T, strict=True):
        known = column[np.isfinite(column)]
        if known.size:
            found[name] = float(np.var(known))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Remainder:
    """What a fit leaves."""

    gap: GapPair
    in_floors: float  # the larger of both, in noise floors [-]
    most_of_healthy: float  # what a healthy axis may leave, in noise floors [-]
    pulls: Mapping[str, float]  # variances by kind of setting error, from :func:`variances_of_pulls`
    misfit: float  # beyond that of healthy axes, of residuals and of pulls, in χ²

    @property
    def misses(self) -> bool:
        """Whether the gap is larger than that of a healthy axis."""
        return self.in_floors > self.most_of_healthy

    def is_pulled(self, settings: OutcomeSettings) -> bool:
        """Tell whether errors of settings scatter more than what is known of them allows."""
        return any(value > settings.pulls for name, value in self.pulls.items() if not name.startswith("gain"))

    def is_left(self, settings: OutcomeSettings) -> bool:
        """Tell whether anything is left that a healthy axis would not leave."""
        return self.misses or self.is_pulled(settings)


def gap_pair(fitted: Fitted[Physics]) -> GapPair:
    """Return the gap of a fit on the values it saw and on those it did not."""
    return GapPair(fitted.gap, gap_of(fitted.comparison, fitted.held_out))


def remainder_of(fitted: Fitted[Physics]) -> Remainder:
    r"""Return what a fit leaves.

    Of its misfit, what is beyond that of healthy axes is

    .. math::

        R = \chi^2 \left( 1 - \left( \frac{limit}{gap} \right)^2 \right) + n_{settings} \sum_k (s_k^2 - 1)

    with the excess of the gap over what healthy axes leave, and of the variances of the pulls over one, both only where
    there is any.
    """
    comparison, gap = fitted.comparison, gap_pair(fitted)
    # of values that were not fitted where there are any: the rms of few scatters by itself
    most = most_of_healthy(int(np.count_nonzero(judged_values(fitted))))
    floors, pulls = in_floors(comparison.noise_floor, gap.fit, gap.held_out), variances_of_pulls(fitted)
    chi_squared = float(np.sum(fitted.standardised[fitted.fitted] ** 2))
    of_residuals = chi_squared * (1.0 - (most / floors) ** 2) if floors > most else 0.0
    of_settings = sum(max(value - 1.0, 0.0) for name, value in pulls.items() if not name.startswith("gain"))
    return Remainder(gap, floors, most, pulls, of_residuals + len(comparison.layout.settings) * of_settings)


def outcome_of(
    classes: Sequence[EquivalenceClass[Physics]],
    remainder: Remainder,
    *,
    explained: float,
    settings: OutcomeSettings,
) -> Outcome:
    """Return the outcome.

    Parameters
    ----------
    classes : sequence of EquivalenceClass
        One for each effect that was accepted.
    remainder : Remainder
        After all of them.
    explained : float
        From :func:`explained_share`.
    settings : OutcomeSettings
    """
    left = remainder.is_left(settings)
    if not classes:
        return Outcome.UNKNOWN if left else Outcome.NONE
    plausible = [one for one in classes if one.leader.plausible]
    if not plausible or (left and explained < settings.least_share):
        return Outcome.UNKNOWN
    if remainder.misses and all(one.others for one in classes):
        return Outcome.UNKNOWN  # a model that misses something tells look-alikes apart by chance
    if left or len(plausible) < len(classes):
        return Outcome.PARTIAL
    return Outcome.EQUIVALENT if any(one.others for one in classes) else Outcome.NAMED


def explained_share(baseline: Fitted[Physics], final: Fitted[Physics], left: float) -> float:
    r"""Return the share :math:`(C_0 - C_1)/(C_0 - C_1 + R)` of the misfit that is gone, with costs C before and after.

    Parameters
    ----------
    baseline, final : Fitted
        Before anything was added, and after all.
    left : float
        R, the misfit of :class:`Remainder`.
    """
    gained = baseline.cost - final.cost
    return gained / (gained + left) if gained > 0.0 else 0.0


def hidden_in_remainder(
    baseline: Fitted[Physics],
    final: Fitted[Physics],
    without: Callable[[Fitted[Physics], Effect[Physics]], Fitted[Physics]],
    settings: OutcomeSettings,
) -> Effect[Physics] | None:
    """Return the effect that explains least, if what is found leaves so much that it may be a part of that.

    Only where all of them explain enough to be believed beside what is left: where they do not, nothing is named in any
    case.

    Parameters
    ----------
    baseline, final : Fitted
        Before anything was added, and after all.
    without : callable
        Returns the fit without one of the effects.
    settings : OutcomeSettings
    """
    effects, remainder = final.hypothesis.effects, remainder_of(final)
    if len(effects) < 2 or not remainder.is_left(settings):
        return None
    if explained_share(baseline, final, remainder.misfit) < settings.least_share:
        return None
    explains = {effect: without(final, effect).cost - final.cost for effect in effects}
    least = min(explains, key=lambda one: explains[one])
    return least if explains[least] < settings.least_of_remainder * remainder.misfit else None
