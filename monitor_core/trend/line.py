"""Draw a line through the trend, and project it: how much is lost a year, and where the next readings would lie.

The charts find changes soon; the line shows what goes on for years, however slow, and nothing is learnt away in it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.trend.belief import DAY, FRICTION_SHARE, KELVIN, STRUCTURES, YEAR, Prior, Structure, change_in_a_day
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate

#: Of fewer sessions, or a shorter time, no line is drawn.
FEWEST, SHORTEST = 10, 7 * DAY
#: So many sessions are drawn on at most, the newest.
MOST = 400
#: Standard deviation, in units of the scatter, of what nothing is known about.
_OPEN = 1e4


@dataclass(frozen=True, slots=True)
class TrendLine:
    """A straight line through sessions, season and covariates taken out."""

    started_at: datetime
    ended_at: datetime
    at_end: Estimate  # value on the line at the last session, in the unit of the observations
    slope: Estimate  # a year
    n_sessions: int


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
    first, last = chosen[0].started_at, chosen[-1].started_at
    days = np.array([(session.started_at - last) / DAY for session in chosen])
    values = np.array([session.value for session in chosen])
    if np.ptp(values) == 0.0:
        return None
    zero, unit = float(values.mean()), float(values.std())
    angle = 2.0 * math.pi * days * (DAY / YEAR)
    design = np.column_stack([
        np.ones(days.size), days * (DAY / YEAR), 1.0 - np.cos(angle), np.sin(angle), _changes(chosen),
        _covariate([session.temperature for session in chosen], KELVIN),
        _covariate([session.friction_torque for session in chosen], None),
    ])  # fmt: skip
    precision = np.array([_OPEN, _OPEN, *prior.deviations]) ** -2.0
    lent = design[:, 2:] @ np.array(prior.coefficients)
    fits = [_fit((values - zero - lent) / unit, design, precision, days, structure) for structure in STRUCTURES]
    weight = np.array(prior.weights)
    evidence = np.array([fit.log_evidence for fit in fits])
    weight = weight * np.exp(evidence - evidence.max())
    weight /= weight.sum()

    def averaged(coefficient: int) -> Estimate:
        means = np.array([fit.mean[coefficient] for fit in fits])
        variances = np.array([fit.variance[coefficient] for fit in fits])
        mean = float(weight @ means)
        variance = float(weight @ (variances + (means - mean) ** 2))
        offset = zero if coefficient == 0 else 0.0
        return Estimate(offset + unit * mean, unit * math.sqrt(variance), float(days.size - 2))

    return TrendLine(first, last, averaged(0), averaged(1), len(chosen))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    mean: FloatArray
    variance: FloatArray
    log_evidence: float


def _fit(
    values: FloatArray, design: FloatArray, prior_precision: FloatArray, days: FloatArray, structure: Structure
) -> _Fit:
    """Return the posterior of a structure, in the normal–inverse-gamma family with nothing known of σ²."""
    apart = np.abs(days[:, None] - days[None, :])
    covariance = structure.share * structure.correlation**apart
    covariance[np.diag_indices(days.size)] = 1.0
    factor = scipy.linalg.cholesky(covariance, lower=True)
    white = scipy.linalg.solve_triangular(factor, np.column_stack([values, design]), lower=True)
    y, x = white[:, 0], white[:, 1:]
    precision = x.T @ x + np.diag(prior_precision)
    inverse = scipy.linalg.inv(precision)
    mean = inverse @ (x.T @ y)
    squares = float(y @ y - mean @ precision @ mean)
    half = 0.5 * (values.size - 2)
    log_determinants = 2.0 * float(np.log(np.diag(factor)).sum()) + float(np.linalg.slogdet(precision)[1])
    evidence = -0.5 * log_determinants - half * math.log(squares) + float(scipy.special.gammaln(half))
    return _Fit(mean, np.diag(inverse) * squares / (2.0 * half), evidence)


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


#: Through fewer readings every line is a guess.
FEWEST_READINGS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """Readings as they would be at later moments; shape (n_moments,)."""

    value: FloatArray  # on the line, in the unit of the readings
    lower: FloatArray  # of the 95 % prediction interval of one reading
    upper: FloatArray
    slope: Estimate  # in the unit of the readings a day


def project(days: FloatArray, values: FloatArray, ahead: FloatArray) -> Projection:
    r"""Return the 95 % prediction interval of one more reading on the straight line through readings.

    .. math:: \hat y(t) \pm t_{0.975,\,n-2}\; s \sqrt{1 + \frac{1}{n} + \frac{(t - \bar t)^2}{\sum_i (t_i - \bar t)^2}}

    Eq. (1.4.11) of [1]_. It holds for readings that scatter independently about a line that goes on; that it does is an
    assumption, which is why the answer is called a projection.

    Parameters
    ----------
    days : ndarray, shape (n_readings,)
        When they were taken. [d]
    values : ndarray, shape (n_readings,)
        In any unit. [-]
    ahead : ndarray, shape (n_moments,)
        When readings are asked for, counted as ``days``. [d]

    Returns
    -------
    Projection
        Values, interval and slope. [-]

    Raises
    ------
    NotIdentifiableError
        If there are fewer than 8 readings, or all of one moment.

    References
    ----------
    .. [1] N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed., Wiley, 1998.
    """
    n = days.size
    if n < FEWEST_READINGS or np.ptp(days) == 0.0:
        raise NotIdentifiableError(
            f"a projection needs {FEWEST_READINGS} readings or more, of several moments; got {n}"
        )
    mean = float(days.mean())
    spread = float(np.sum((days - mean) ** 2))
    slope = float(np.sum((days - mean) * values)) / spread
    level = float(values.mean())
    scatter = float(np.sqrt(np.sum((values - level - slope * (days - mean)) ** 2) / (n - 2)))
    value = level + slope * (ahead - mean)
    reach = float(scipy.special.stdtrit(n - 2, 0.975)) * scatter * np.sqrt(1.0 + 1.0 / n + (ahead - mean) ** 2 / spread)
    return Projection(value, value - reach, value + reach, Estimate(slope, scatter / spread**0.5, float(n - 2)))
