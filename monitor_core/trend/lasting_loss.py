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
from itertools import pairwise

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import N_COEFFICIENTS, STRUCTURES, Belief, Numbers, Prediction, applied
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate

#: Prior standard deviation of a step in those of a session: half-normal, so that 2 is the median.
STEP = 3.0
#: One session may say so many standard deviations, less than it may teach: tails are heavier in a shop than in tables.
LARGEST_WORD = 3.0
#: Sessions that are remembered as possible beginnings. With three as many steps are found as with all.
KEPT = 4


_EFFECT = N_COEFFICIENTS + 1
_DEPENDENCE = N_COEFFICIENTS


class Said(Numbers):
    """What the sessions say of each beginning, by structure.

    ``sums``, shape (size + 2, n_beginnings, n_structures), are the effect of a unit step on what the filter believes,
    the sum of its share g times the error over the variance [unit of the values], and that of g² over the variance.
    ``merged`` is the logarithm of what others that a beginning stands for add, as a factor.
    """

    __slots__ = ("merged", "sums")

    def __init__(self, sums: FloatArray, merged: tuple[float, ...]) -> None:
        """Take the arrays as they are."""
        self.sums, self.merged = sums, merged

    def numbers(self) -> FloatArray:
        """Return effects, cross products, information and merged of each beginning."""
        count = len(self.merged)
        effect = self.sums[:_EFFECT].transpose(1, 2, 0).reshape(count, _EFFECT * len(STRUCTURES))
        return np.hstack((effect, self.sums[-2], self.sums[-1], np.array(self.merged).reshape(count, 1)))

    @classmethod
    def of(cls, numbers: FloatArray) -> "Said":
        """Return what such numbers say, in a row or not."""
        structures = len(STRUCTURES)
        rows = numbers.reshape(-1, structures * (_EFFECT + 2) + 1)
        sums = np.empty((_EFFECT + 2, len(rows), structures))
        sums[:_EFFECT] = rows[:, : structures * _EFFECT].reshape(-1, structures, _EFFECT).transpose(2, 0, 1)
        sums[-2:] = rows[:, structures * _EFFECT : -1].reshape(-1, 2, structures).transpose(1, 0, 2)
        return cls(sums, tuple(rows[:, -1].tolist()))


_NOTHING = Said(np.zeros((_EFFECT + 2, 0, len(STRUCTURES))), ())


@dataclass(frozen=True, slots=True)
class Beginnings:
    """Sessions in which a lasting loss may have begun, the oldest first; none before anything is watched."""

    at: tuple[datetime, ...] = ()
    said: Said = _NOTHING


@dataclass(frozen=True, slots=True)
class LastingLoss:
    """What all sessions together say of a loss that lasts."""

    log_evidence: float  # ln R
    onset: datetime  # the beginning that explains the sessions best
    change: Estimate | None  # of the level since then, in the unit of the observations; None below the limit


def weigh(
    beginnings: Beginnings,
    prediction: Prediction,
    session: Session,
    *,
    towards_loss: float,
    learns: bool,
    limit: float = -math.inf,
) -> tuple[Beginnings, LastingLoss | None]:
    """Weigh one more session, as it was predicted, and say whether it will be learnt.

    ``towards_loss`` is 1.0 if values rise as preload is lost, -1.0 if they fall. How large the loss is will be told of
    evidence beyond the limit. A session that teaches nothing says
    nothing either and begins nothing: what scatter there is would not be known. The loss is None for it, and as long as
    no session before this one can be its beginning: what one session says alone is none that lasts.
    """
    before, count = beginnings.said, len(beginnings.at)
    sums = np.zeros((_EFFECT + 2, count + learns, len(STRUCTURES)))  # a loss may begin now as well
    sums[:, :count] = before.sums
    sums[_DEPENDENCE] *= prediction.decay
    left = 1.0 - applied(prediction.design[:-1], sums[:_EFFECT])  # of a unit step in the error of this session
    share = left / prediction.spread
    if not learns:
        sums[_DEPENDENCE] += share * prediction.swept[_DEPENDENCE]
        return Beginnings(beginnings.at, Said(sums, before.merged)), None
    largest = LARGEST_WORD * prediction.scale
    error = -towards_loss * np.minimum(np.maximum(session.evident(prediction.swept[-1]), -largest), largest)
    said = prediction.swept.copy()
    said[-1] = error
    sums[:-1] += said[:, None] * share
    sums[-1] += left * share
    squares = error * error / prediction.spread - prediction.bank.joint[-1, -1]
    at, merged = [*beginnings.at, session.started_at], [*before.merged, 0.0]
    each, loss = _log_evidence(sums, squares, prediction), None
    own = [evidence + others for evidence, others in zip(each, merged, strict=True)]
    if count:
        log_evidence, best = _log_sum(own[:-1]), max(range(count), key=each.__getitem__)
        change = _change(sums[:, best], squares, prediction, towards_loss) if log_evidence > limit else None
        loss = LastingLoss(log_evidence, at[best], change)
    if len(at) > KEPT:
        stays, goes = _least(at, own)
        merged[stays] = _log_sum((own[stays], own[goes])) - each[stays]
        sums[:, goes:-1] = sums[:, goes + 1 :]
        sums = sums[:, :-1]
        del at[goes], merged[goes]
    return Beginnings(tuple(at), Said(sums, tuple(merged))), loss


def without_loss(belief: Belief, beginnings: Beginnings, onset: datetime, towards_loss: float) -> Belief:
    """Return what is believed of the healthy axis if it has lost preload since one of the beginnings.

    The filter has taken some of the loss for level, season or dependence; that is given back, with the uncertainty of
    the loss.
    """
    nearest = min(range(len(beginnings.at)), key=lambda i: abs(beginnings.at[i] - onset))
    sums = beginnings.said.sums[:, nearest]
    effect, information = sums[:_EFFECT], sums[-1] + STEP**-2
    step = towards_loss * np.maximum(sums[-2], 0.0) / information
    healthy = belief.bank.with_covariance(effect[:, None] * effect / information)
    healthy.joint[-1, :-1] -= effect * step
    healthy.joint[:-1, -1] = healthy.joint[-1, :-1]
    return replace(belief, bank=healthy)


def _log_evidence(sums: FloatArray, squares: FloatArray, prediction: Prediction) -> list[float]:
    """Return by how much each beginning predicts better than none, all steps of a loss integrated out.

    ``squares`` is 2b of a healthy axis after the session.
    """
    shape = prediction.bank.shape + 0.5
    cross, information = sums[-2], sums[-1] + STEP**-2
    explained = cross * cross / information
    odds = explained / (squares - explained)
    upwards = np.copysign(np.sqrt(2.0 * shape * odds), cross)
    of_structure = shape * np.log1p(odds) - 0.5 * np.log(information) + scipy.special.log_ndtr(upwards)
    of_all: list[float] = np.logaddexp.reduce(prediction.log_weight + of_structure, axis=1).tolist()
    return [evidence + math.log(2.0 / STEP) for evidence in of_all]


def _change(sums: FloatArray, squares: FloatArray, prediction: Prediction, towards_loss: float) -> Estimate:
    """Return the step since a beginning, over all structures."""
    degrees, weight = 2.0 * prediction.bank.shape + 1.0, np.exp(prediction.log_weight)
    information = sums[-1] + STEP**-2
    size = np.maximum(sums[-2], 0.0) / information
    mean = float(weight @ size)
    variance = float(weight @ (squares / (degrees * information) + (size - mean) ** 2))
    return Estimate(towards_loss * mean, math.sqrt(variance), degrees)


def _least(at: Sequence[datetime], own: Sequence[float]) -> tuple[int, int]:
    """Return the neighbours that say little and lie close together, of which the first is to stand for the second.

    ``own`` is the logarithm of what each says. The newest stays: nothing is known of it yet.
    """
    said = [
        _log_sum(pair) + math.log((later - earlier).total_seconds())
        for pair, (earlier, later) in zip(pairwise(own[:-1]), pairwise(at[:-1]), strict=True)
    ]
    i = said.index(min(said))
    return (i, i + 1) if own[i] >= own[i + 1] else (i + 1, i)


def _log_sum(logarithms: Sequence[float]) -> float:
    """Return the logarithm of a sum of numbers, given theirs."""
    largest = max(logarithms)
    return largest + math.log(sum(math.exp(each - largest) for each in logarithms))
