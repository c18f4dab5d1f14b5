r"""Tell a loss of preload while the baseline is still being learnt, so that nothing that falls is learnt as healthy.

A baseline takes its sessions for those of an axis that stays as it is. Whether it does is weighed with every session,
against a loss that goes on evenly since the first. Of the values y of n sessions at times t, with the structures r of
dependence and the covariates X of :mod:`monitor_core.trend.belief`,

.. math::

    y \mid r, \delta &\sim \mathcal{N}\bigl(\mu + X\beta + \sigma\,\delta\,(t - t_1)/\bar\Delta,\; \sigma^2 C_r\bigr),
    \qquad \bar\Delta = (t_n - t_1)/(n - 1) \\
    B_n &= \frac{\sum_r w_r\, p(y \mid r,\, \delta > 0)}{\sum_r w_r\, p(y \mid r,\, \delta = 0)}

with the coefficients β normal in units of σ and the loss δ of a session half-normal. Level and scale have the right
Haar prior dμ dσ/σ, so that B compares what of the values does not depend on zero and unit. On a healthy axis it is a
martingale of mean 1, whatever those are (Pérez-Ortiz, Lardy, de Heide & Grünwald, Ann. Stat. 52 (2024) 1410–1432), and
after Ville it exceeds A on one of A axes at most, however often it is looked at: the rate is that of all the learning.
It is the rate of axes that depend as the weights of the structures say; the benchmark
``python -m benchmarks.learning`` tells it for each kind of axis.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from statistics import NormalDist

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import DAY, FRICTION_SHARE, KELVIN, LUBRICATION, STRUCTURES, YEAR, Prior, change_in_a_day
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate

#: So large a share of healthy axes at most is said to fall while they are learnt.
FALSE_SHARE = 0.05
#: Logarithm of the evidence beyond which an axis falls.
EVIDENCE_LIMIT = -math.log(FALSE_SHARE)
#: Prior standard deviation of the loss from one session to the next, in those of a session.
LOSS_OF_A_SESSION = 0.3
#: What warmth may do is not known while an axis is learnt, but where sisters tell: so many standard deviations of a
#: session per :data:`KELVIN`, and as a season where no temperature is stated. A trend that goes with a temperature is
#: no loss. Of unstated ones a season may do more, but to allow for it would hide losses of 13 %.
WARMTH, UNSTATED_SEASON = 10.0, 2.0
#: Fewer sessions tell neither scatter nor trend.
FEWEST = 5
#: Of more sessions the first half of so many and the newest half are weighed.
MOST = 40
_CORRELATION = np.array([structure.correlation for structure in STRUCTURES])[:, None, None]
_SHARE = np.array([structure.share for structure in STRUCTURES])[:, None, None]
#: Median of the magnitude of the difference of two standard normal values.
_MEDIAN_STEP = math.sqrt(2.0) * NormalDist().inv_cdf(0.75)


@dataclass(frozen=True, slots=True)
class Fall:
    """A loss that goes on evenly since the first session, as the sessions speak for it."""

    log_evidence: float  # ln B
    onset: datetime  # the first session
    level: float  # at the onset, in the unit of the values
    change: Estimate  # since then up to the newest session


def weigh_fall(sessions: Sequence[Session], prior: Prior, *, towards_loss: float) -> Fall | None:
    """Weigh whether the sessions that a baseline is to be learnt from lose preload, in time order and any unit.

    ``towards_loss`` is 1.0 if values rise as preload is lost, -1.0 if they fall. Of the prior, scatter is not used: an
    axis may be coarser than its sisters. None for fewer than :data:`FEWEST` sessions, or if all have one value.
    """
    if len(sessions) > MOST:
        sessions = (*sessions[: MOST // 2], *sessions[-(MOST // 2) :])
    values = np.array([session.value for session in sessions])
    count = len(values)
    if count < FEWEST or np.ptp(values) == 0.0:
        return None
    days = np.array([(session.started_at - sessions[0].started_at) / DAY for session in sessions])
    covariates, deviations = _covariates(sessions, days, prior)
    left = values - values[0] - covariates @ np.array(prior.coefficients)
    spread = np.hstack([covariates * deviations, _lubrications(sessions)])
    root = np.linalg.cholesky(_covariance(sessions, values, days, spread))
    columns = np.stack([np.ones(count), days * ((count - 1) / days[-1]), towards_loss * left], axis=1)
    white = np.linalg.solve(root, np.broadcast_to(columns, (len(STRUCTURES), count, 3)))
    gram = white.transpose(0, 2, 1) @ white

    of_level = gram[:, 0, 0]
    information = gram[:, 1, 1] - gram[:, 0, 1] ** 2 / of_level
    cross = gram[:, 1, 2] - gram[:, 0, 1] * gram[:, 0, 2] / of_level
    squares = gram[:, 2, 2] - gram[:, 0, 2] ** 2 / of_level
    degrees, with_prior = count - 1.0, information + LOSS_OF_A_SESSION**-2
    log_determinant = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    log_healthy = np.log(prior.weights) - 0.5 * (log_determinant + np.log(of_level) + degrees * np.log(squares))
    explained = squares - cross**2 / with_prior
    upwards = cross / np.sqrt(with_prior * explained / degrees)
    log_falling = (
        log_healthy + 0.5 * degrees * np.log(squares / explained)
        - 0.5 * np.log(LOSS_OF_A_SESSION**2 * with_prior) + np.log(2.0 * scipy.special.stdtr(degrees, upwards))
    )  # fmt: skip
    log_evidence = float(np.logaddexp.reduce(log_falling) - np.logaddexp.reduce(log_healthy))

    # how much is lost: by the line alone, whatever size was thought likely before
    weight = np.exp(log_falling - np.logaddexp.reduce(log_falling))
    slope = cross / information
    mean = float(weight @ slope)
    remaining = np.maximum(squares - cross**2 / information, 0.0) / (degrees - 1.0)
    variance = float(weight @ (remaining / information + (slope - mean) ** 2))
    level = values[0] + towards_loss * float(weight @ ((gram[:, 0, 2] - gram[:, 0, 1] * slope) / of_level))
    lost = Estimate(towards_loss * mean * degrees, math.sqrt(variance) * degrees, degrees - 1.0)
    return Fall(log_evidence, sessions[0].started_at, level, lost)


def is_covered(sessions: Sequence[Session], prior: Prior, *, towards_loss: float) -> bool:
    """Tell whether sessions that are not said to fall would be, had nobody stated temperature, friction, lubrication.

    These may explain the fall, or hide a loss that went with them: that is not known, unless sisters tell what they do.
    """
    bare = [replace(session, temperature=None, friction_torque=None, lubricated=False) for session in sessions]
    fall = weigh_fall(bare, prior, towards_loss=towards_loss) if prior.n_sisters == 0 else None
    return fall is not None and fall.log_evidence > EVIDENCE_LIMIT


def _covariance(sessions: Sequence[Session], values: FloatArray, days: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the covariance of the values in units of σ², by structure; ``spread`` are covariates times deviations."""
    apart = np.abs(days[:, None] - days[None, :])
    white = np.diag(1.0 + _noise(sessions, values))
    return np.asarray(_SHARE * (_CORRELATION**apart - np.eye(len(days))) + white + spread @ spread.T)


def _covariates(sessions: Sequence[Session], days: FloatArray, prior: Prior) -> tuple[FloatArray, FloatArray]:
    """Return season (two), change of the temperature in a day, temperature, friction; and what each may do."""
    angle = 2.0 * np.pi * days / (YEAR / DAY)
    temperatures = [session.temperature for session in sessions]
    frictions = [session.friction_torque for session in sessions]
    pairs = itertools.pairwise(sessions)
    changes = [change_in_a_day(a.temperature, b.temperature, b.started_at - a.started_at) for a, b in pairs]
    usual = abs(next((friction for friction in frictions if friction), 1.0))
    columns = [
        1.0 - np.cos(angle), np.sin(angle), _centred([None, *changes]), _centred(temperatures) / KELVIN,
        _centred(frictions) / (FRICTION_SHARE * usual),
    ]  # fmt: skip
    deviations = np.array(prior.deviations)
    if prior.n_sisters == 0:
        deviations[3] = WARMTH
    if None in temperatures:
        deviations[:2] = UNSTATED_SEASON
    return np.stack(columns, axis=1), deviations


def _lubrications(sessions: Sequence[Session]) -> FloatArray:
    """Return by how much each lubrication that was stated may move the level, from its session on."""
    after = np.tri(len(sessions))[:, [session.lubricated for session in sessions]]
    return np.asarray(LUBRICATION * after)


def _centred(known: Sequence[float | None]) -> FloatArray:
    """Return differences from the mean; 0 for what is not known."""
    values = np.array(known, dtype=np.float64)
    measured = np.isfinite(values)
    if not measured.any():
        return np.zeros(len(values))
    return np.where(measured, values - values[measured].mean(), 0.0)


def _noise(sessions: Sequence[Session], values: FloatArray) -> FloatArray:
    """Return the variance that a session has on top, of fewer measurements or by its own word, in units of σ²."""
    counts = np.array([session.count for session in sessions])
    stated = np.array([session.own_variance for session in sessions])
    scale = max((float(np.median(np.abs(np.diff(values)))) / _MEDIAN_STEP) ** 2, float(np.median(stated)))
    if scale == 0.0:
        return np.zeros(len(values))
    repeated = int(counts.sum()) - len(counts)
    within = math.fsum(session.squares for session in sessions) / repeated if repeated else 0.0
    of_few = within * (1.0 / counts - np.median(1.0 / counts))
    return np.asarray(np.maximum(np.maximum(of_few, stated - scale), 0.0) / scale)
