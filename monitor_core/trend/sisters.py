"""Let axes of one type lend a young one what it cannot know yet: dependence, scatter, temperature, friction torque."""

import math
from collections.abc import Sequence

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import N_COEFFICIENTS, Belief, Prior

#: The scatter of one sister is worth so many degrees of freedom at most, however old she is: axes differ.
MOST_DEGREES_OF_FREEDOM = 20.0
_OF_ONE_SISTER = 4.0
#: Temperature, its change and friction torque among the coefficients. A season is not lent: it is counted from the
#: first session.
_LENT = range(3, N_COEFFICIENTS)


def prior_from(sisters: Sequence[Belief], default: Prior | None = None) -> Prior:
    r"""Return what healthy sisters teach; without any, the default.

    Dependence: the mean of what is believed of each, the default counted as one more sister. Scatter: the mean of
    ln σ², worth the :math:`2 / \operatorname{var}(\ln \sigma^2)` degrees of freedom that their difference allows.
    Coefficients: a random-effects mean, of which the axis may differ as sisters do (DerSimonian & Laird, Control. Clin.
    Trials 7 (1986) 177–188), and by the default over their number more: no sister that differs is forced to agree.
    """
    prior = default or Prior()
    if not sisters:
        return prior
    banks = [sister.bank for sister in sisters]
    count = len(banks)
    weights = (np.array(prior.weights) + sum(bank.weight for bank in banks)) / (1.0 + count)

    logarithms = np.array([math.log(bank.variance) for bank in banks])
    variance = math.exp(float(logarithms.mean()))
    between = float(logarithms.var(ddof=1)) if count > 1 else 2.0 / _OF_ONE_SISTER
    degrees = min(2.0 / between, MOST_DEGREES_OF_FREEDOM) if between > 0.0 else MOST_DEGREES_OF_FREEDOM

    coefficients, deviations = list(prior.coefficients), list(prior.deviations)
    for index in _LENT:
        means = np.array([float(bank.weight @ bank.mean[index]) for bank in banks])
        variances = np.array([
            float(bank.weight @ (bank.rate / bank.shape * bank.covariance[index, index])) for bank in banks
        ])  # fmt: skip
        least = prior.deviations[index - 1] ** 2 * variance / (1.0 + count)
        mean, spread = _random_effects(means, variances, least)
        coefficients[index - 1] = mean
        deviations[index - 1] = min(math.sqrt(spread / variance), prior.deviations[index - 1])
    return Prior(
        tuple((weights / weights.sum()).tolist()), tuple(coefficients), tuple(deviations), variance, degrees, count
    )


def _random_effects(means: FloatArray, variances: FloatArray, least: float) -> tuple[float, float]:
    """Return the mean of one more sister and its variance, of which at least so much is between sisters."""
    weight = 1.0 / variances
    fixed = float(weight @ means / weight.sum())
    scale = float(weight.sum() - weight @ weight / weight.sum())
    excess = float(weight @ (means - fixed) ** 2) - (means.size - 1)
    between = max(least, excess / scale if scale > 0.0 else 0.0)
    weight = 1.0 / (variances + between)
    return float(weight @ means / weight.sum()), between + 1.0 / float(weight.sum())
