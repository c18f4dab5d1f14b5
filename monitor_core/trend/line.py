"""Draw a line through the trend since its last change: how much is lost a year, where the next session would lie.

The charts find changes soon; the line shows what goes on for years, however slow, and nothing is learnt away in it.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike

from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import DAY, FRICTION_SHARE, KELVIN, STRUCTURES, YEAR, Prior, Structure, change_in_a_day
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate

#: Of fewer sessions, or a shorter time, no line is drawn.
FEWEST, SHORTEST = 10, 7 * DAY
#: So many sessions are drawn on at most, the newest.
MOST = 400
#: Standard deviation, in units of the scatter, of what nothing is known about.
_OPEN = 1e4
#: Standard deviation of a step, and of what a change of slope brings over all the time, in units of the scatter of all
#: sessions, the change included.
_CHANGE = 3.0
#: A change somewhere is evident by so much evidence beyond that of none: a factor of twenty.
EVIDENT = math.log(20.0)
#: Sessions beside a change at least, and places at which it is looked for first.
_LEAST_BESIDE, _PLACES = 3, 40
#: Sessions to each side of the best place that it may be at, and quantiles of it that join the uncertainty of the line.
_AROUND, _N_PLACES = 16, 8
#: Through more sessions than these a few at the begin do not matter.
_LONG = 100


@dataclass(frozen=True, slots=True)
class TrendLine:
    """A straight line through sessions, season and covariates taken out."""

    started_at: datetime
    ended_at: datetime
    at_end: Estimate  # value on the line at the last session, in the unit of the observations
    slope: Estimate  # a year
    n_sessions: int
    scatter: float  # of a session about the line, in the unit of the observations
    together: float  # covariance of value at the end and slope

    def ahead(self, years: float) -> Estimate:
        """Return one more session so long after the last, if the line goes on; season and covariates as at the end."""
        variance = self.at_end.standard_uncertainty**2 + (years * self.slope.standard_uncertainty) ** 2
        variance += 2.0 * years * self.together + self.scatter**2
        value = self.at_end.value + years * self.slope.value
        return Estimate(value, math.sqrt(max(variance, 0.0)), self.slope.degrees_of_freedom)


@dataclass(frozen=True, slots=True)
class PresentTrend:
    """How the sessions go at present: since when, and the line since then."""

    changed_at: datetime | None  # first session since the last change of level or slope; None: no change is evident
    n_since: int  # sessions since then
    line: TrendLine | None  # through these; None: they are too few, or of too short a time


def present_trend(sessions: Sequence[Session], prior: Prior | None = None, *, alarmed: bool = False) -> PresentTrend:
    r"""Find the last change of level or slope, and fit the line since then.

    A mean since some onset is no rate where there was a step, or where the onset is dated late. Of the models

    .. math:: y = \alpha + \beta t + x^\mathsf{T}\gamma + \delta\,H(t - \tau) + \eta\,(t - \tau)_+ + e

    with τ at each session in turn, and the one without a change, the marginal likelihoods are compared, averaged over
    the structures of :func:`trend_line`: what a dependence from day to day or the season may explain is no change. The
    same is asked of what follows the change, until nothing more is found. Where an alarm stands (``alarmed``)
    a change is as likely as none beforehand, no more: what falls steadily from the first session on raises one, too.
    """
    chosen, prior = sessions[-MOST:], prior or Prior()
    first, places = 0, {0: 1}
    while (found := _last_change(chosen[first:], prior, 0.0 if alarmed and not first else EVIDENT)) is not None:
        places = {first + place: share for place, share in found.items()}
        first = max(places, key=lambda place: places[place])
    changed_at = chosen[first].started_at if first else None
    best = trend_line(chosen[first:], prior)
    n_since = len(chosen) - first
    if best is None or n_since > _LONG:
        return PresentTrend(changed_at, n_since, best)
    drawn = [(places[first], best)]
    for place, share in places.items():
        line = None if place == first else trend_line(chosen[place:], prior)
        drawn += [] if line is None else [(share, line)]
    return PresentTrend(changed_at, n_since, _joined(best, drawn))


def _mixed(share: FloatArray, means: ArrayLike, covariances: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of a mixture."""
    mean = share @ np.asarray(means)
    off = means - mean
    return mean, np.einsum("i,ijk->jk", share, covariances + off[:, :, np.newaxis] * off[:, np.newaxis, :])


def _joined(best: TrendLine, drawn: Sequence[tuple[int, TrendLine]]) -> TrendLine:
    """Return the line of the best place of a change, with what the place leaves open: moments of the mixture."""
    share = np.array([weight for weight, _ in drawn]) / sum(weight for weight, _ in drawn)
    means = [[line.at_end.value, line.slope.value] for _, line in drawn]
    covariances = [
        [[line.at_end.standard_uncertainty**2, line.together], [line.together, line.slope.standard_uncertainty**2]]
        for _, line in drawn
    ]
    mean, covariance = _mixed(share, means, covariances)
    at_end, slope = (
        Estimate(float(mean[i]), math.sqrt(covariance[i, i]), best.slope.degrees_of_freedom) for i in range(2)
    )
    return replace(best, at_end=at_end, slope=slope, together=float(covariance[0, 1]))


def trend_line(sessions: Sequence[Session], prior: Prior | None = None) -> TrendLine | None:
    r"""Fit the line by generalised least squares, the dependence of the sessions averaged over the structures.

    .. math:: y = \alpha + \beta t + x^\mathsf{T}\gamma + e, \qquad
        \operatorname{cov}(e_i, e_j) = \sigma^2\,(s\,\varphi^{|t_i - t_j|} + (1 - s)\,\delta_{ij})

    with season and covariates x as in :mod:`monitor_core.trend.belief`, their prior included: a slope that the season
    may explain has an interval that says so. ``None`` if there are too few sessions, or all are of one value.
    """
    chosen = sessions[-MOST:]
    if len(chosen) < FEWEST or chosen[-1].started_at - chosen[0].started_at < SHORTEST:
        return None
    prior = prior or Prior()
    asked = _Asked.of(chosen, prior)
    if asked is None:
        return None
    fits = [asked.fit(structure) for structure in STRUCTURES]
    weight = np.array(prior.weights)
    evidence = np.array([fit.log_evidence for fit in fits])
    weight = weight * np.exp(evidence - evidence.max())
    weight /= weight.sum()
    mean, covariance = _mixed(weight, [fit.mean for fit in fits], [fit.covariance for fit in fits])
    unit, dof = asked.unit, float(len(chosen) - 2)
    scatter = unit * math.sqrt(float(weight @ [fit.variance for fit in fits]))
    at_end = Estimate(asked.zero + unit * float(mean[0]), unit * math.sqrt(covariance[0, 0]), dof)
    slope = Estimate(unit * float(mean[1]), unit * math.sqrt(covariance[1, 1]), dof)
    first, last = chosen[0].started_at, chosen[-1].started_at
    return TrendLine(first, last, at_end, slope, len(chosen), scatter, unit**2 * float(covariance[0, 1]))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    mean: FloatArray
    covariance: FloatArray
    variance: float  # of a session about the line
    log_evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """Sessions as a linear model: values about their mean in units of their scatter, and what they may follow."""

    days: FloatArray
    values: FloatArray
    design: FloatArray
    precision: FloatArray
    zero: float
    unit: float
    factors: dict[Structure, FloatArray] = field(default_factory=dict)  # of covariances, once they were wanted

    @classmethod
    def of(cls, sessions: Sequence[Session], prior: Prior) -> "_Asked | None":
        """Return the model; None if all sessions are of one value."""
        last = sessions[-1].started_at
        days = np.array([(session.started_at - last) / DAY for session in sessions])
        values = np.array([session.value for session in sessions])
        if np.ptp(values) == 0.0:
            return None
        zero, unit = float(values.mean()), float(values.std())
        angle = 2.0 * math.pi * days * (DAY / YEAR)
        design = np.column_stack([
            np.ones(days.size), days * (DAY / YEAR), 1.0 - np.cos(angle), np.sin(angle), _changes(sessions),
            _covariate([session.temperature for session in sessions], KELVIN),
            _covariate([session.friction_torque for session in sessions], None),
        ])  # fmt: skip
        precision = np.array([_OPEN, _OPEN, *prior.deviations]) ** -2.0
        lent = design[:, 2:] @ np.array(prior.coefficients)
        return cls(days, (values - zero - lent) / unit, design, precision, zero, unit)

    def fit(self, structure: Structure) -> _Fit:
        """Return the posterior of a structure, in the normal–inverse-gamma family with nothing known of σ²."""
        white, log_determinant = self._white(structure, self.design)
        y, x = white[:, 0], white[:, 1:]
        precision = x.T @ x + np.diag(self.precision)
        inverse = scipy.linalg.inv(precision)
        mean = inverse @ (x.T @ y)
        squares, half = float(y @ y - mean @ precision @ mean), 0.5 * (y.size - 2)
        log_determinant += float(np.linalg.slogdet(precision)[1])
        evidence = -0.5 * log_determinant - half * math.log(squares) + float(scipy.special.gammaln(half))
        variance = squares / (2.0 * half)
        return _Fit(mean, inverse * variance, variance, evidence)

    def evidence_of_changes(self, structure: Structure, at: Sequence[int]) -> FloatArray:
        """Return the logarithms of the marginal likelihood without a change, and with one at each of some sessions."""
        n, p = self.design.shape
        since = self.days[:, np.newaxis] - self.days[at]
        after = np.arange(n)[:, np.newaxis] >= np.array(at)
        slopes = np.where(after, since / np.ptp(self.days), 0.0)
        white, log_determinant = self._white(structure, np.hstack([self.design, after, slopes]))
        y, x = white[:, 0], white[:, 1 : p + 1]
        change = white[:, p + 1 :].reshape(n, 2, len(at))  # what is added by each: a step, and a slope from there on
        precision = x.T @ x + np.diag(self.precision)
        solved = np.linalg.solve(
            precision, np.column_stack([x.T @ y, np.einsum("ip,ick->pck", x, change).reshape(p, -1)])
        )
        of_base, of_change = solved[:, 0], solved[:, 1:].reshape(p, 2, len(at))
        left = np.einsum("ick,idk->kcd", change, change) + _CHANGE**-2.0 * np.eye(2)
        left -= np.einsum("ick,ip,pdk->kcd", change, x, of_change, optimize=True)
        toward = np.einsum("ick,i->kc", change, y - x @ of_base)
        squares, half = float(y @ y - (x.T @ y) @ of_base), 0.5 * (n - 2)
        log_determinant += float(np.linalg.slogdet(precision)[1])
        none = -0.5 * log_determinant - half * math.log(squares)
        # a slope alone, or a step with it
        gained = toward[:, 1] ** 2 / left[:, 1, 1]
        bend = none - 0.5 * np.log(_CHANGE**2 * left[:, 1, 1]) - half * np.log1p(-gained / squares)
        gained = np.einsum("kc,kc->k", toward, np.linalg.solve(left, toward[:, :, np.newaxis])[:, :, 0])
        step = none - 0.5 * np.linalg.slogdet(_CHANGE**2 * left)[1] - half * np.log1p(-gained / squares)
        return np.append(none, np.logaddexp(bend, step) - math.log(2.0))

    def _white(self, structure: Structure, columns: FloatArray) -> tuple[FloatArray, float]:
        """Return values and columns as they scatter independently, and the logarithm of the determinant."""
        factor = self.factors.get(structure)
        if factor is None:
            apart = np.abs(self.days[:, None] - self.days[None, :])
            covariance = structure.share * structure.correlation**apart
            covariance[np.diag_indices(self.days.size)] = 1.0
            factor = self.factors[structure] = scipy.linalg.cholesky(covariance, lower=True)
        white = scipy.linalg.solve_triangular(factor, np.column_stack([self.values, columns]), lower=True)
        return white, 2.0 * float(np.log(np.diag(factor)).sum())


def _last_change(sessions: Sequence[Session], prior: Prior, least: float) -> dict[int, int] | None:
    """Return the sessions, by number, that a change may be at, with weights; None if the evidence is less."""
    n = len(sessions)
    if n < FEWEST or (asked := _Asked.of(sessions, prior)) is None:
        return None
    weight = np.log(prior.weights)

    def likelihood(at: Sequence[int]) -> FloatArray:
        each = [w + asked.evidence_of_changes(s, at) for w, s in zip(weight, STRUCTURES, strict=True)]
        return np.asarray(scipy.special.logsumexp(each, axis=0))

    step = max(1, n // _PLACES)
    at = list(range(_LEAST_BESIDE, n - _LEAST_BESIDE + 1, step))
    found = likelihood(at)
    evidence = float(scipy.special.logsumexp(found[1:])) - math.log(len(at)) - found[0]
    if evidence < least:
        return None
    best = at[int(np.argmax(found[1:]))]
    reach = max(_AROUND, step)
    at = [k for k in range(best - reach, best + reach + 1) if _LEAST_BESIDE <= k <= n - _LEAST_BESIDE]
    cumulated = np.cumsum(scipy.special.softmax(likelihood(at)[1:]))
    quantiles = np.searchsorted(cumulated, (np.arange(_N_PLACES) + 0.5) / _N_PLACES)
    return Counter(at[min(int(i), len(at) - 1)] for i in quantiles)


def _changes(sessions: Sequence[Session]) -> FloatArray:
    """Return the change of the temperature in a day, as it is learnt."""
    return np.array([
        0.0,
        *(
            change_in_a_day(before.temperature, session.temperature, session.started_at - before.started_at) or 0.0
            for before, session in pairwise(sessions)
        ),
    ])  # fmt: skip


def _covariate(stated: Sequence[float | None], unit: float | None) -> FloatArray:
    """Return a covariate about its mean, in its unit or as a share of itself; 0 where it was not stated."""
    known_values = [value for value in stated if value is not None]
    mean = float(np.mean(known_values)) if known_values else 0.0
    unit = FRICTION_SHARE * abs(mean) if unit is None else unit
    if unit == 0.0:
        return np.zeros(len(stated))
    return np.array([0.0 if value is None else (value - mean) / unit for value in stated])
