"""Say of a healthy axis what people want to know: its level, its scatter, and what the baseline has not seen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np
import scipy

from monitor_core.trend.belief import STRUCTURES, Belief, Prior, begin, healthy_value, learnt_from, reopened
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Interval, IntervalKind

_CORRELATION = np.array([structure.correlation for structure in STRUCTURES])
_SHARE = np.array([structure.share for structure in STRUCTURES])
#: So often what sisters lent is dropped though the axis is like them.
CONTRADICTED_BY_CHANCE = 0.05
#: A baseline of a year has seen every season.
ALL_SEASONS = timedelta(days=330)


@dataclass(frozen=True, slots=True)
class Baseline:
    """What is normal for an axis, as far as it was learnt."""

    mean: float  # under mean conditions, at the time of the last session
    standard_uncertainty: float  # of the mean
    scatter: float  # standard deviation from one session to the next, same unit as the mean
    size: int  # sessions
    n_observations: int
    degrees_of_freedom: float
    autocorrelation: float  # of sessions a day apart
    dependence: float  # how much wider a long mean scatters than that of independent sessions; 1 for those
    started_at: datetime
    ended_at: datetime
    weights: tuple[float, ...] = ()  # of the structures of dependence
    temperatures: tuple[float, float] | None = None  # lowest and highest that were seen [°C]
    lubricated_at: datetime | None = None  # the level was open to it, as said or as friction looked

    def scatter_of_mean(self, count: int) -> float:
        r"""Return the standard deviation of the mean of so many sessions in a row, a day apart.

        .. math:: \sigma^2 \left[\frac{1 - s}{n}
            + s\,\frac{n (1 - \varphi^2) - 2 \varphi (1 - \varphi^n)}{n^2 (1 - \varphi)^2}\right]
        """
        rho, share = _CORRELATION, _SHARE
        together = (count * (1.0 - rho**2) - 2.0 * rho * (1.0 - rho**count)) / (count * (1.0 - rho)) ** 2
        return self.scatter * math.sqrt(float(np.array(self.weights) @ ((1.0 - share) / count + share * together)))

    def prediction_interval(self, level: float = 0.95) -> Interval:
        r"""Predict where one more healthy session will lie, :math:`\bar x \pm t^* \sqrt{s^2 + u^2(\bar x)}`.

        For people to look at: alarms come from the charts, whose false-alarm rate is stated.
        """
        quantile = float(scipy.special.stdtrit(self.degrees_of_freedom, 0.5 * (1.0 + level)))
        half = quantile * math.hypot(self.scatter, self.standard_uncertainty)
        return Interval(self.mean - half, self.mean + half, IntervalKind.PREDICTION, level)

    @property
    def not_seen(self) -> tuple[str, ...]:
        """What the baseline knows nothing of, in words: later differences may come from there."""
        missing = []
        span = self.ended_at - self.started_at
        if span < ALL_SEASONS:
            missing.append(f"other seasons than those {max(span.days, 1)} days")
        if self.temperatures is None:
            missing.append("any temperature: none was stated")
        else:
            low, high = self.temperatures
            if f"{low:.1f}" == f"{high:.1f}":
                missing.append(f"temperatures other than {low:.1f} °C")
            else:
                missing.append(f"temperatures below {low:.1f} or above {high:.1f} °C")
        return tuple(missing)


def learn_baseline(sessions: Sequence[Session], prior: Prior | None = None) -> Belief | None:
    """Learn the first sessions of an axis, in time order and any unit.

    ``None`` as long as the scatter is not known: fewer than two sessions, or all of one value without any stated
    uncertainty.
    """
    if len(sessions) < 2:
        return None
    prior = prior or Prior()
    values = np.array([session.value for session in sessions])
    stated = float(np.mean([session.own_variance for session in sessions]))
    # values all alike may differ from their mean by a rounding error, which is no scatter
    observed = float(np.median(np.abs(values - np.median(values))) / scipy.special.ndtri(0.75)) ** 2
    if np.ptp(values) > 0.0 and observed == 0.0:
        observed = float(values.var(ddof=1))
    variance = max(observed, stated)
    if variance == 0.0 and prior.variance is None:
        return None
    return learnt_from(sessions, begin(sessions[0], prior, variance))


def contradicts(sessions: Sequence[Session], prior: Prior) -> bool:
    r"""Tell whether the first sessions of an axis contradict what its sisters lent it.

    Dependence, temperature and friction are taken as lent, the scatter s is the axis' own: it is too large where any of
    them is not so, and too small where sisters are coarser. On an axis like its sisters, of scatter σ₀,

    .. math:: s^2 / \sigma_0^2 \sim F(\nu, \nu_0)

    with the degrees of freedom of both, and lies outside the interval of level 1 − :data:`CONTRADICTED_BY_CHANCE` by
    chance alone (a prior-predictive check: Box, J. R. Stat. Soc. A 143 (1980) 383–430).
    """
    own = learn_baseline(sessions, replace(prior, variance=None, degrees_of_freedom=Prior().degrees_of_freedom))
    if own is None or prior.variance is None:
        return False
    bank, lent = own.bank, prior.degrees_of_freedom
    below = float(scipy.special.fdtr(2.0 * bank.shape, lent, bank.variance / prior.variance))
    return min(below, 1.0 - below) < 0.5 * CONTRADICTED_BY_CHANCE


def learn_level_again(belief: Belief, sessions: Sequence[Session]) -> Belief:
    """Learn the level anew after an inspection, and go on from what was learnt of everything else."""
    return learnt_from(sessions, reopened(belief))


def baseline_of(belief: Belief) -> Baseline:
    """Sum up a belief for people."""
    bank, weight = belief.bank, belief.bank.weight
    mean, uncertainty = healthy_value(belief, belief.last_at)
    long_run = float(weight @ (1.0 + 2.0 * _SHARE * _CORRELATION / (1.0 - _CORRELATION)))
    return Baseline(
        mean=mean,
        standard_uncertainty=uncertainty,
        scatter=math.sqrt(bank.variance),
        size=belief.n_sessions,
        n_observations=belief.n_observations,
        degrees_of_freedom=2.0 * bank.shape,
        autocorrelation=float(weight @ (_SHARE * _CORRELATION)),
        dependence=math.sqrt(long_run),
        started_at=belief.started_at,
        ended_at=belief.ended_at,
        weights=tuple(weight.tolist()),
        temperatures=None if belief.temperature is None else (belief.temperature.lowest, belief.temperature.highest),
        lubricated_at=belief.lubricated_at,
    )
