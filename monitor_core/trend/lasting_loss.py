r"""Weigh whether a loss has lasted since some session, against everything that a healthy axis may do.

The charts forget: what they follow as dependence, or learn while they are calm, is no evidence any more. So each
session is also weighed together with all before it, as Shiryaev (1963) and Roberts (Technometrics 8 (1966) 411–430) do:

.. math:: R_t = \sum_{\tau < t}
    \frac{\sum_r w_r\, p(y_{1 \ldots t} \mid r, \text{a step } d > 0 \text{ since } \tau)}
    {\sum_r w_r\, p(y_{1 \ldots t} \mid r)}

over the structures r of :mod:`monitor_core.trend.belief`, their coefficients and the step integrated out; the step is
half-normal with :data:`STEP` standard deviations of a session. On a healthy axis :math:`R_t - t` is a martingale, so
that the sessions until :math:`R_t` exceeds A are A or more in the mean (Pollak, Ann. Stat. 13 (1985) 206–227).

What a step leaves in the errors of a Kalman filter is found with that filter alone (the signatures of Willsky & Jones,
IEEE Trans. Autom. Control 21 (1976) 108–112): the error of each session holds the share g of the step
that the filter has not taken for something else yet. :data:`KEPT` sessions are remembered as possible beginnings; two
neighbours that say least are made one, which keeps the evidence of both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from scipy import special

from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import (
    STRUCTURES,
    Bank,
    Belief,
    Prediction,
    bank_of,
    with_bank,
)
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate

#: Prior standard deviation of a step in those of a session: half-normal, so that 2 is the median.
STEP = 3.0
#: One session may say so many standard deviations, less than it may teach: tails are heavier in a shop than in tables.
LARGEST_WORD = 3.0
#: Sessions that are remembered as possible beginnings. With three as many steps are found as with all.
KEPT = 4


@dataclass(frozen=True, slots=True)
class Beginnings:
    """Sessions in which a lasting loss may have begun, the oldest first; none before anything is watched."""

    at: tuple[datetime, ...] = ()
    numbers: tuple[float, ...] = ()  # of each what the sessions since say, see :class:`_Weighed`


@dataclass(frozen=True, slots=True)
class LastingLoss:
    """What all sessions together say of a loss that lasts."""

    log_evidence: float  # ln R
    onset: datetime  # the beginning that explains the sessions best
    change: Estimate  # of the level since then, in the unit of the observations


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """What the sessions say of each beginning, by structure; shapes (n_beginnings, n_structures, …)."""

    effect: FloatArray  # of a unit step on what the filter believes, (…, size of its state)
    cross: FloatArray  # sum of g times error over its variance [unit of the values]
    information: FloatArray  # sum of g² over the variance of the error, in units of σ²
    merged: FloatArray  # (n_beginnings,), logarithm of what others that it stands for add, as a factor

    def numbers(self) -> tuple[float, ...]:
        """Return all numbers, beginning by beginning."""
        count = len(self.merged)
        columns = (self.effect.reshape(count, -1), self.cross, self.information, self.merged[:, None])
        return tuple(np.hstack(columns).ravel().tolist())

    def without(self, which: int) -> "_Weighed":
        """Return the other beginnings."""
        left = [i for i in range(len(self.merged)) if i != which]
        return _Weighed(self.effect[left], self.cross[left], self.information[left], self.merged[left])


def weigh(
    beginnings: Beginnings,
    belief: Belief,
    prediction: Prediction,
    session: Session,
    *,
    towards_loss: float,
    learns: bool,
) -> tuple[Beginnings, LastingLoss | None]:
    """Weigh one more session, before the belief has learnt it, and tell whether it will.

    ``towards_loss`` is 1.0 if values rise as preload is lost, -1.0 if they fall. A session that teaches nothing says
    nothing either: what scatter there is would not be known. The loss is None as long as no session before this one can
    be its beginning: what one session says alone is none that lasts.
    """
    bank, spread = prediction.bank, prediction.spread
    weighed = _with_one_more(_weighed(beginnings, prediction.design.size))
    effect, cross, information = weighed.effect.copy(), weighed.cross, weighed.information
    effect[..., -1] *= prediction.decay
    left = 1.0 - effect @ prediction.design
    shape, rate, weight = bank.shape, bank.rate, bank.weight
    if learns:
        off = session.value - belief.zero - prediction.centre
        largest = LARGEST_WORD * prediction.scale
        error = towards_loss * np.clip(session.evident(off), -largest, largest)
        cross, information = cross + left * error / spread, information + left**2 / spread
        shape, rate = shape + 0.5, rate + 0.5 * error**2 / spread
        weight = np.exp(prediction.log_weight(off))
    effect += left[..., None] * (prediction.gain if learns else prediction.gain_of_dependence)
    weighed = _Weighed(effect, cross, information, weighed.merged)
    each = _log_evidence(weighed, shape, rate, weight)
    at = (*beginnings.at, session.started_at)
    loss = None
    if len(at) > 1:
        best = int(np.argmax(each[:-1]))
        log_evidence = float(np.logaddexp.reduce((each + weighed.merged)[:-1]))
        loss = LastingLoss(log_evidence, at[best], _step(weighed, best, bank, towards_loss))
    at, weighed = _thinned(at, weighed, each)
    return Beginnings(at, weighed.numbers()), loss


def without_loss(belief: Belief, beginnings: Beginnings, onset: datetime, towards_loss: float) -> Belief:
    """Return what is believed of the healthy axis if it has lost preload since one of the beginnings.

    The filter has taken some of the loss for level, season or dependence; that is given back, with the uncertainty of
    the loss.
    """
    bank = bank_of(belief)
    weighed = _weighed(beginnings, bank.mean.shape[1])
    nearest = min(range(len(beginnings.at)), key=lambda i: abs(beginnings.at[i] - onset))
    effect, information = weighed.effect[nearest], weighed.information[nearest] + STEP**-2
    step = towards_loss * np.maximum(weighed.cross[nearest], 0.0) / information
    unknown = effect[:, :, None] * effect[:, None, :] / information[:, None, None]
    healthy = replace(bank, mean=bank.mean - effect * step[:, None], covariance=bank.covariance + unknown)
    return with_bank(belief, healthy)


def _log_evidence(weighed: _Weighed, shape: FloatArray, rate: FloatArray, weight: FloatArray) -> FloatArray:
    """Return by how much each beginning predicts better than none, all steps of a loss integrated out."""
    information = weighed.information + STEP**-2
    with_step = rate - 0.5 * weighed.cross**2 / information
    upwards = weighed.cross / np.sqrt(information * with_step / shape)
    of_structure = (
        shape * np.log(rate / with_step) - 0.5 * np.log(STEP**2 * information)
        + math.log(2.0) + special.log_ndtr(upwards)
    )  # fmt: skip
    return np.asarray(np.logaddexp.reduce(np.log(np.maximum(weight, 1e-300)) + of_structure, axis=1))


def _step(weighed: _Weighed, which: int, bank: Bank, towards_loss: float) -> Estimate:
    """Return the step since a beginning, over all structures."""
    information = weighed.information[which] + STEP**-2
    size, weight = weighed.cross[which] / information, bank.weight
    mean = float(weight @ size)
    variance = float(weight @ (bank.rate / bank.shape / information + (size - mean) ** 2))
    return Estimate(towards_loss * mean, math.sqrt(variance), float(weight @ (2.0 * bank.shape)))


def _thinned(at: tuple[datetime, ...], weighed: _Weighed, each: FloatArray) -> tuple[tuple[datetime, ...], _Weighed]:
    """Make one of two neighbours until few are left: first of those that say little and lie close together."""
    while len(at) > KEPT:
        own = each + weighed.merged
        apart = np.array([(later - at[i]).total_seconds() for i, later in enumerate(at[1:])])
        pair = np.logaddexp(own[:-1], own[1:]) + np.log(apart)
        i = int(np.argmin(pair[:-1]))  # the newest stays: nothing is known of it yet
        stays, goes = (i, i + 1) if own[i] >= own[i + 1] else (i + 1, i)
        weighed.merged[stays] = np.logaddexp(own[i], own[i + 1]) - each[stays]
        at, weighed, each = (*at[:goes], *at[goes + 1 :]), weighed.without(goes), np.delete(each, goes)
    return at, weighed


def _weighed(beginnings: Beginnings, size: int) -> _Weighed:
    count, structures = len(beginnings.at), len(STRUCTURES)
    rows = np.array(beginnings.numbers, dtype=np.float64).reshape(count, structures * (size + 2) + 1)
    effect, cross, information, merged = np.split(rows, np.cumsum([structures * size, structures, structures]), axis=1)
    return _Weighed(effect.reshape(count, structures, size), cross, information, merged[:, 0])


def _with_one_more(weighed: _Weighed) -> _Weighed:
    """Let a loss begin now as well."""
    arrays: Sequence[FloatArray] = (weighed.effect, weighed.cross, weighed.information, weighed.merged)
    return _Weighed(*(np.concatenate((array, np.zeros((1, *array.shape[1:])))) for array in arrays))
