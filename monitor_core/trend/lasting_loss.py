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
import scipy

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
        effect = self.effect.reshape(count, math.prod(self.effect.shape[1:]))
        columns = (effect, self.cross, self.information, self.merged[:, None])
        return tuple(np.hstack(columns).ravel().tolist())

    def without(self, which: int) -> "_Weighed":
        """Return the other beginnings."""
        left = [i for i in range(len(self.merged)) if i != which]
        return _Weighed(self.effect[left], self.cross[left], self.information[left], self.merged[left])


def weigh(
    beginnings: Beginnings,
    prediction: Prediction,
    session: Session,
    *,
    towards_loss: float,
    learns: bool,
) -> tuple[Beginnings, LastingLoss | None]:
    """Weigh one more session, as it was predicted, and say whether it will be learnt.

    ``towards_loss`` is 1.0 if values rise as preload is lost, -1.0 if they fall. A session that teaches nothing says
    nothing either and begins nothing: what scatter there is would not be known. The loss is None for it, and as long as
    no session before this one can be its beginning: what one session says alone is none that lasts.
    """
    before = _weighed(beginnings, prediction.design.size)
    if not learns:
        effect, left = _left_of_a_step(before, prediction)
        effect += left[..., None] * prediction.gain_of_dependence
        return Beginnings(beginnings.at, replace(before, effect=effect).numbers()), None
    before, at = _with_one_more(before), (*beginnings.at, session.started_at)
    effect, left = _left_of_a_step(before, prediction)
    off = prediction.error(session.value)
    largest, spread = LARGEST_WORD * prediction.scale, prediction.spread
    error = towards_loss * np.clip(session.evident(off), -largest, largest)
    weighed = _Weighed(
        effect + left[..., None] * prediction.gain,
        before.cross + left * error / spread,
        before.information + left**2 / spread,
        before.merged,
    )
    bank = prediction.bank
    rate = bank.rate + 0.5 * error**2 / spread
    healthy = replace(bank, shape=bank.shape + 0.5, rate=rate, log_weight=prediction.log_weight(off))
    each, loss = _log_evidence(weighed, healthy), None
    if beginnings.at:
        best = int(np.argmax(each[:-1]))
        log_evidence = float(np.logaddexp.reduce((each + weighed.merged)[:-1]))
        loss = LastingLoss(log_evidence, at[best], _change(weighed, best, healthy, towards_loss))
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


def _log_evidence(weighed: _Weighed, healthy: Bank) -> FloatArray:
    """Return by how much each beginning predicts better than none, all steps of a loss integrated out."""
    information = weighed.information + STEP**-2
    with_step = healthy.rate - 0.5 * weighed.cross**2 / information
    upwards = weighed.cross / np.sqrt(information * with_step / healthy.shape)
    of_structure = (
        healthy.shape * np.log(healthy.rate / with_step) - 0.5 * np.log(STEP**2 * information)
        + math.log(2.0) + scipy.special.log_ndtr(upwards)
    )  # fmt: skip
    return np.asarray(np.logaddexp.reduce(healthy.log_weight + of_structure, axis=1))


def _left_of_a_step(weighed: _Weighed, prediction: Prediction) -> tuple[FloatArray, FloatArray]:
    """Return what unit steps have done to the state when a session is predicted, and what is left in its error."""
    effect = weighed.effect.copy()
    effect[..., -1] *= prediction.decay
    return effect, 1.0 - effect @ prediction.design


def _change(weighed: _Weighed, which: int, healthy: Bank, towards_loss: float) -> Estimate:
    """Return the step since a beginning, over all structures."""
    information = weighed.information[which] + STEP**-2
    size, weight = np.maximum(weighed.cross[which], 0.0) / information, healthy.weight
    mean = float(weight @ size)
    variance = float(weight @ (healthy.rate / healthy.shape / information + (size - mean) ** 2))
    return Estimate(towards_loss * mean, math.sqrt(variance), float(weight @ (2.0 * healthy.shape)))


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
