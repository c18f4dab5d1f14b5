"""What a search means: named, equivalent, partial, none or unknown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from monitor_core.discrepancy.explanation import Gap, Outcome
from monitor_core.discrepancy.judging.classes import EquivalenceClass
from monitor_core.discrepancy.searching.fit import Fitted
from monitor_core.discrepancy.searching.holding_out import in_floors, most_of_healthy

Physics = TypeVar("Physics")


@dataclass(frozen=True, slots=True)
class OutcomeSettings:
    """When something is left. The figures are set on simulated machines, see benchmarks/hidden_effects."""

    #: Where something is left, what was found must explain this share of the misfit, or it may stand for the true
    #: effect as well.
    least_share: float = 0.95
    #: Variance of the pulls of settings: 2.2 at most on healthy machines; more is a drift, or an effect in disguise.
    pulls: float = 3.0


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


def outcome_of(
    classes: Sequence[EquivalenceClass[Physics]],
    gap: Gap,
    *,
    pulls: Mapping[str, float],
    explained: float,
    n_judged: int,
    settings: OutcomeSettings,
) -> Outcome:
    """Return the outcome.

    Parameters
    ----------
    classes : sequence of EquivalenceClass
        One for each effect that was accepted.
    gap : Gap
        Before any of them, and after all.
    pulls : mapping of str to float
        From :func:`variances_of_pulls`, after all.
    explained : float
        From :func:`explained_share`.
    n_judged : int
        Values that the gap after all is of, held-out ones where there are any: the rms of few scatters by itself.
    settings : OutcomeSettings
    """
    pulled = any(value > settings.pulls for name, value in pulls.items() if not name.startswith("gain"))
    misses = in_floors(gap.noise_floor, gap.after.fit, gap.after.held_out) > most_of_healthy(n_judged)
    left = misses or pulled
    if not classes:
        return Outcome.UNKNOWN if left else Outcome.NONE
    plausible = [one for one in classes if one.leader.plausible]
    if not plausible or (left and explained < settings.least_share):
        return Outcome.UNKNOWN
    if misses and all(one.others for one in classes):  # a model that misses something tells look-alikes apart by chance
        return Outcome.UNKNOWN
    if left or len(plausible) < len(classes):
        return Outcome.PARTIAL
    return Outcome.EQUIVALENT if any(one.others for one in classes) else Outcome.NAMED


def explained_share(
    baseline: Fitted[Physics],
    final: Fitted[Physics],
    gap: Gap,
    pulls: Mapping[str, float],
    *,
    n_judged: int,
    settings: OutcomeSettings,
) -> float:
    r"""Return the share of the misfit that is gone: residuals, errors of the settings and pulls of parameters together.

    .. math::

        \frac{C_0 - C_1}{C_0 - C_1 + R}, \qquad
        R = \chi^2_1 \left( 1 - \left( \frac{limit}{gap} \right)^2 \right) + n_{settings} \sum_k (s_k^2 - 1)

    with the costs C before and after, and what is left: the excess of the gap over what healthy axes leave, and of the
    variances of the pulls over one, both only where there is any.

    Parameters
    ----------
    baseline, final : Fitted
        Before anything was added, and after all.
    gap : Gap
    pulls : mapping of str to float
        From :func:`variances_of_pulls`, after all.
    n_judged : int
        Values that the gap after all is of.
    settings : OutcomeSettings
    """
    gained = baseline.cost - final.cost
    chi_squared = float(np.sum(final.standardised[final.fitted] ** 2))
    after, most = in_floors(gap.noise_floor, gap.after.fit, gap.after.held_out), most_of_healthy(n_judged)
    residual = chi_squared * (1.0 - (most / after) ** 2) if after > most else 0.0
    of_settings = sum(max(value - 1.0, 0.0) for name, value in pulls.items() if not name.startswith("gain"))
    left = residual + len(final.comparison.layout.settings) * of_settings
    return gained / (gained + left) if gained > 0.0 else 0.0
