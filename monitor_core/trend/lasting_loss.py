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
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import N_COEFFICIENTS, STRUCTURES, Belief, Numbers, Prediction
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate

#: Prior standard deviation of a step in those of a session: half-normal, so that 2 is the median.
STEP = 3.0
#: One session may say so many standard deviations, less than it may teach: tails are heavier in a shop than in tables.
LARGEST_WORD = 3.0
#: Sessions that are remembered as possible beginnings. With three as many steps are found as with all.
KEPT = 4


class Said(Numbers):
    """What the sessions say of each beginning, by structure.

    ``sums``, shape (n_beginnings, n_structures, size + 2), are the effect of a unit step on what the filter believes,
    the sum of its share g times the error over the variance [unit of the values], and that of g² over the variance.
    ``merged``, (n_beginnings,), is the logarithm of what others that a beginning stands for add, as a factor.
    """

    __slots__ = ("merged", "sums")

    def __init__(self, sums: FloatArray, merged: FloatArray) -> None:
        """Take the arrays as they are."""
        self.sums, self.merged = sums, merged

    def numbers(self) -> FloatArray:
        """Return effects, cross products, information and merged of each beginning."""
        count = len(self.merged)
        effect = self.sums[..., :-2].reshape(count, math.prod(self.sums.shape[1:]) - 2 * len(STRUCTURES))
        return np.hstack((effect, self.sums[..., -2], self.sums[..., -1], self.merged[:, None]))

    @classmethod
    def of(cls, numbers: FloatArray) -> "Said":
        """Return what such numbers say, in a row or not."""
        structures = len(STRUCTURES)
        rows = numbers.reshape(-1, structures * (_EFFECT + 2) + 1)
        count = len(rows)
        effect = rows[:, : structures * _EFFECT].reshape(count, structures, _EFFECT)
        sums = rows[:, structures * _EFFECT : -1].reshape(count, 2, structures).transpose(0, 2, 1)
        return cls(np.concatenate((effect, sums), axis=2), rows[:, -1].copy())


_EFFECT = N_COEFFICIENTS + 1
_NOTHING = Said(np.zeros((0, len(STRUCTURES), _EFFECT + 2)), np.zeros(0))


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
    change: Estimate  # of the level since then, in the unit of the observations


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
    before, count = beginnings.said, len(beginnings.at)
    sums = np.zeros((count + learns, *before.sums.shape[1:]))  # a loss may begin now as well
    sums[:count] = before.sums
    sums[..., _EFFECT - 1] *= prediction.decay
    left = 1.0 - sums[..., :_EFFECT] @ prediction.design[:-1]  # of a unit step in the error of this session
    if not learns:
        sums[..., _EFFECT - 1] += left * prediction.gain[:, -2]
        return Beginnings(beginnings.at, Said(sums, before.merged)), None
    largest = LARGEST_WORD * prediction.scale
    error = towards_loss * np.minimum(np.maximum(session.evident(prediction.error), -largest), largest)
    in_spread = left / prediction.spread
    sums[..., :_EFFECT] += left[..., None] * prediction.gain[:, :-1]
    sums[..., -2] += in_spread * error
    sums[..., -1] += in_spread * left
    squares = 2.0 * prediction.bank.rate + error * error / prediction.spread
    at, merged = (*beginnings.at, session.started_at), np.append(before.merged, 0.0)
    each, loss = _log_evidence(sums, squares, prediction), None
    if count:
        best = int(np.argmax(each[:-1]))
        log_evidence = float(np.logaddexp.reduce((each + merged)[:-1]))
        loss = LastingLoss(log_evidence, at[best], _change(sums[best], squares, prediction, towards_loss))
    at, kept, merged = _thinned(at, each, merged)
    return Beginnings(at, Said(sums[kept], merged)), loss


def without_loss(belief: Belief, beginnings: Beginnings, onset: datetime, towards_loss: float) -> Belief:
    """Return what is believed of the healthy axis if it has lost preload since one of the beginnings.

    The filter has taken some of the loss for level, season or dependence; that is given back, with the uncertainty of
    the loss.
    """
    nearest = min(range(len(beginnings.at)), key=lambda i: abs(beginnings.at[i] - onset))
    sums = beginnings.said.sums[nearest]
    effect, information = sums[:, :-2], sums[:, -1] + STEP**-2
    step = towards_loss * np.maximum(sums[:, -2], 0.0) / information
    healthy = belief.bank.with_covariance(effect[:, :, None] * effect[:, None, :] / information[:, None, None])
    healthy.joint[:, :-1, -1] -= effect * step[:, None]
    healthy.joint[:, -1, :-1] = healthy.joint[:, :-1, -1]
    return replace(belief, bank=healthy)


def _log_evidence(sums: FloatArray, squares: FloatArray, prediction: Prediction) -> FloatArray:
    """Return by how much each beginning predicts better than none, all steps of a loss integrated out.

    ``squares`` is 2b of a healthy axis after the session.
    """
    shape = prediction.bank.shape + 0.5
    cross, information = sums[..., -2], sums[..., -1] + STEP**-2
    with_step = squares - cross * cross / information
    upwards = cross * np.sqrt(2.0 * shape / (information * with_step))
    of_structure = (
        shape * np.log(squares / with_step) - 0.5 * np.log(STEP**2 * information)
        + math.log(2.0) + scipy.special.log_ndtr(upwards)
    )  # fmt: skip
    return np.asarray(np.logaddexp.reduce(prediction.log_weight + of_structure, axis=1))


def _change(sums: FloatArray, squares: FloatArray, prediction: Prediction, towards_loss: float) -> Estimate:
    """Return the step since a beginning, over all structures."""
    degrees, weight = 2.0 * prediction.bank.shape + 1.0, np.exp(prediction.log_weight)
    information = sums[:, -1] + STEP**-2
    size = np.maximum(sums[:, -2], 0.0) / information
    mean = float(weight @ size)
    variance = float(weight @ (squares / (degrees * information) + (size - mean) ** 2))
    return Estimate(towards_loss * mean, math.sqrt(variance), degrees)


def _thinned(
    at: tuple[datetime, ...], each: FloatArray, merged: FloatArray
) -> tuple[tuple[datetime, ...], list[int], FloatArray]:
    """Make one of two neighbours until few are left: first of those that say little and lie close together.

    Returned are the times of those that stay, which they were, and what each stands for.
    """
    kept, own = list(range(len(at))), (each + merged).tolist()
    while len(kept) > KEPT:
        pair = np.logaddexp(own[:-1], own[1:])
        apart = [(at[later] - at[i]).total_seconds() for i, later in pairwise(kept)]
        i = int(np.argmin((pair + np.log(apart))[:-1]))  # the newest stays: nothing is known of it yet
        goes = i + 1 if own[i] >= own[i + 1] else i
        own[i : i + 2] = [float(pair[i])]
        del kept[goes]
    return tuple(at[i] for i in kept), kept, np.array(own) - each[kept]
