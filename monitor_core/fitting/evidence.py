r"""Weigh the evidence for one hypothesis against another where residuals are correlated and not of size one.

Residuals whose neighbours correlate by ρ count as :math:`n (1 - \rho)/(1 + \rho)` values, and what the fuller of two
hypotheses leaves, s² per value, is taken for the noise:

.. math::

    \Delta BIC = \frac{1 - \rho}{1 + \rho}\,\frac{\chi^2_0 - \chi^2_1}{s^2} - k \ln n_{eff}

for k parameters more that the data see (Schwarz, Ann. Statist. 6 (1978) 461; the number of effective values is that of
a first-order autoregression).
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.comparison import Comparison, Layout
from monitor_core.fitting.hypothesis import is_size
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: A decrease of χ² is measured with the noise budget at the least: residuals below it may be correlated. But what
#: leaves less than half of a budget, or a quarter of its square, disproves it.
_LEAST_SCALE, _DISPROVED = 1.0, 0.25
_HIGHEST_CORRELATION = 0.9
_SMALLEST = 1e-9  # of s²: data of a model have no noise at all
#: Evidence, of BIC or of χ² for nothing more that is free (Kass and Raftery, J. Am. Stat. Assoc. 90 (1995) 773).
STRONG, VERY_STRONG = 6.0, 10.0
_SHARE_OF_THRESHOLD = 0.4


@dataclass(frozen=True, slots=True)
class EvidenceScale:
    """Turn a decrease of χ² into evidence: the size and the correlation of the residuals that count as noise."""

    mean_square: float  # s² of the residuals that count as noise [-]
    correlation: float  # ρ of neighbours [-]
    n_values: int  # that were fitted

    @property
    def share(self) -> float:
        """How many independent values one value is worth."""
        return (1.0 - self.correlation) / (1.0 + self.correlation)

    @property
    def factor(self) -> float:
        """From a decrease of χ² to twice a log-likelihood ratio."""
        return self.share / self.mean_square

    def penalty(self, n_parameters: int) -> float:
        """Return what n parameters cost."""
        return n_parameters * math.log(max(self.n_values * self.share, 2.0))


def least_difference(comparison: Comparison[Physics]) -> float:
    """Return the difference of BIC from which on two effects count as distinguishable.

    Another effect scores 10 more than the true one once in a hundred and fifty times, and there are several others.
    What the form of a model may feign where nothing is missing shows in the least evidence for an effect.
    """
    return max(VERY_STRONG, _SHARE_OF_THRESHOLD * comparison.least_delta_bic)


def evidence_scale(fitted: Fitted[Physics]) -> EvidenceScale:
    """Return the evidence scale of a fit: its residuals count as noise.

    A parameter within a tolerance adds one value, its prior, and takes one away. With the residuals of the priors, the
    degrees of freedom are the number of values less that of the unknowns that are seen and have no prior.
    """
    residuals = fitted.standardised[fitted.fitted]
    free = max(residuals.size - fitted.n_seen, 1)
    mean_square = (float(residuals @ residuals) + fitted.prior_cost) / free
    mean_square = max(mean_square, min(_LEAST_SCALE, mean_square / _DISPROVED), _SMALLEST)
    correlation = neighbour_correlation(fitted.comparison.layout, fitted.standardised, fitted.fitted)
    return EvidenceScale(mean_square, min(max(correlation, 0.0), _HIGHEST_CORRELATION), residuals.size)


def neighbour_correlation(layout: Layout, standardised: FloatArray, chosen: BoolArray) -> float:
    """Return the correlation of residuals with the next ones of their setting and channel."""
    group = layout.setting * len(layout.channels) + layout.channel
    pairs = (group[1:] == group[:-1]) & chosen[1:] & chosen[:-1]
    if np.count_nonzero(pairs) < 2:
        return 0.0
    first, second = standardised[:-1][pairs], standardised[1:][pairs]
    power = math.sqrt(float(first @ first) * float(second @ second))
    return float(first @ second) / power if power > 0.0 else 0.0


def delta_bic(without: Fitted[Physics], fuller: Fitted[Physics], scale: EvidenceScale) -> float:
    """Return BIC of a hypothesis less BIC of a fuller one: above zero speaks for the fuller.

    What the data gain counts by the scale. The pull of a declared parameter is no residual: it is neither correlated
    nor larger than its tolerance because the data are, and counts in full.
    """
    of_priors = without.prior_cost - fuller.prior_cost
    of_data = without.cost - fuller.cost - of_priors
    return scale.factor * of_data + of_priors - scale.penalty(fuller.n_seen - without.n_seen)


def covariance(fitted: Fitted[Physics], scale: EvidenceScale) -> FloatArray:
    r"""Return the covariance of the coordinates, :math:`(f J^T J + \Pi)^{-1}` with the priors' precision Π.

    f is the factor of the evidence scale: residuals that are correlated, or exceed their budget, count for less.
    """
    n = fitted.hypothesis.n_coordinates
    precision = fitted.precision(scale.factor)
    root = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    correlation = precision / np.outer(root, root)
    return np.asarray(np.linalg.pinv(correlation, rcond=1e-13, hermitian=True) / np.outer(root, root)).reshape(n, n)


def significance(
    fitted: Fitted[Physics], effect: Effect[Physics], scale: EvidenceScale, *, of_scatter: bool = False
) -> float:
    """Return the size of an effect of a fit over its standard deviation, of its largest size where it has several.

    Beside the scatter of the data stands what the formula of the effect leaves out, or ``of_scatter`` alone is meant.
    """
    form = 0.0 if of_scatter else effect.form_share
    variances, largest = np.diag(covariance(fitted, scale)), 0.0
    for column, (other, parameter) in enumerate(fitted.hypothesis.unknowns, fitted.hypothesis.n_uncertain):
        if other.key == effect.key and (parameter is other.parameters[0] or is_size(parameter)):
            size = abs(fitted.coordinates[column])  # of a size, which is null at 0
            deviation = math.hypot(math.sqrt(max(float(variances[column]), 0.0)), form * size)
            largest = max(largest, size / max(deviation, 1e-300))
    return largest
