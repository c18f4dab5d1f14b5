r"""Filter several numbers of an axis, and weigh a step in them together: the arithmetic of :mod:`.joint`.

Arrays may begin with a shape of axes that are measured at the same times, so that many are simulated at once.
"""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import BoolArray, FloatArray

#: How sessions depend on each other: φ of sessions a day apart, the share of the scatter that is so correlated, weight.
STRUCTURES = np.array([
    (0.0, 0.0, 0.30), (0.3, 1.0, 0.14), (0.6, 1.0, 0.14), (0.8, 1.0, 0.12), (0.9, 1.0, 0.08), (0.85, 0.5, 0.12),
    (0.96, 0.4, 0.10),
])  # fmt: skip
_CORRELATION, _SHARE, _WEIGHT = STRUCTURES.T
#: Level, season (two), change of the temperature in a day, temperature; the autoregression is the last of the state.
_DEVIATIONS = np.array([100.0, 0.8, 0.8, 4.0, 2.0])  # of these coefficients, in standard deviations of a session
SIZE = _DEVIATIONS.size + 1
#: Sessions that the prior of the correlations, none, is worth.
WORTH = 5.0
#: A step has so many standard deviations of a session, over all directions.
STEP = 2.0
#: Belief that a step may go any way, where the ways in which a loss moves some numbers are known and others' are not.
ANY_WAY = 0.25
#: One session may teach no more than so many standard deviations.
LARGEST_LESSON = 4.0
#: Sessions that are remembered as possible beginnings.
KEPT = 12


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """What is believed of each number, by structure, and of all together."""

    mean: FloatArray  # (…, p, n_structures, size of the state)
    covariance: FloatArray  # (n_structures, size of the state, size of the state), in units of σ²: alike for all
    rate: FloatArray  # b of the inverse gamma of σ², (…, p, n_structures)
    log_weight: FloatArray  # (…, p, n_structures)
    together: FloatArray  # scale of the inverse Wishart of the normal scores, (…, p, p)
    n: float  # sessions that were learnt

    @property
    def shape(self) -> float:
        """Shape a of the inverse gamma."""
        return 0.5 * (1.0 + self.n)

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the joint t: of the inverse Wishart, p + 2 at first, less p − 1."""
        return 2.0 + WORTH + self.n

    @property
    def weight(self) -> FloatArray:
        """Probability of each structure, (…, p, n_structures)."""
        return np.asarray(np.exp(self.log_weight))

    @property
    def scatter(self) -> FloatArray:
        """Standard deviation σ of each number from session to session, (…, p)."""
        return np.asarray(np.sqrt((self.weight * self.rate).sum(axis=-1) / self.shape))

    def numbers(self) -> tuple[float, ...]:
        """Return all numbers of one axis in a row."""
        p = self.mean.shape[0]
        (i, j), (k, m) = _upper(SIZE), _upper(p)
        arrays = (self.mean, self.rate, self.log_weight, self.covariance[:, i, j], self.together[k, m])
        return (*np.concatenate([a.ravel() for a in arrays]).tolist(), self.n)


def bank_from(numbers: tuple[float, ...], p: int) -> Bank:
    """Return what is believed of the p numbers of one axis, from its numbers in a row."""
    n = len(STRUCTURES)
    sizes = [p * n * SIZE, p * n, p * n, n * SIZE * (SIZE + 1) // 2]
    mean, rate, weight, covariance, together = np.split(np.array(numbers[:-1]), np.cumsum(sizes))
    return Bank(
        mean.reshape(p, n, SIZE), _symmetric(covariance.reshape(n, -1), SIZE), rate.reshape(p, n),
        weight.reshape(p, n), _symmetric(together[None], p)[0], numbers[-1],
    )  # fmt: skip


@functools.cache
def _upper(size: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    return np.triu_indices(size)


def _symmetric(upper: FloatArray, size: int) -> FloatArray:
    i, j = _upper(size)
    full = np.empty((len(upper), size, size))
    full[:, i, j] = full[:, j, i] = upper
    return full


def begin(p: int, axes: tuple[int, ...] = ()) -> Bank:
    """Return what is known of p numbers before the first session, counted in their scatter from their mean."""
    n = len(STRUCTURES)
    covariance = np.zeros((n, SIZE, SIZE))
    covariance[:, range(SIZE), range(SIZE)] = [*_DEVIATIONS**2, 0.0]
    covariance[:, -1, -1] = _SHARE
    log_weight = np.broadcast_to(np.log(_WEIGHT), (*axes, p, n)).copy()
    together = np.broadcast_to(WORTH * np.eye(p), (*axes, p, p)).copy()
    return Bank(np.zeros((*axes, p, n, SIZE)), covariance, np.full((*axes, p, n), 0.5), log_weight, together, 0.0)


def reopened(bank: Bank) -> Bank:
    """Forget the levels, and keep what was learnt of everything else."""
    covariance = bank.covariance.copy()
    covariance[:, 0, 0] += _DEVIATIONS[0] ** 2
    return replace(bank, covariance=covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A session as it was predicted."""

    bank: Bank  # at the time of the session
    design: FloatArray
    decay: FloatArray  # of the autoregression since the session before, (n_structures,)
    gain: FloatArray  # what a unit error teaches of the state, (n_structures, size)
    spread: FloatArray  # q, (n_structures,)
    error: FloatArray  # (…, p, n_structures)
    scale: FloatArray  # of its t, (…, p, n_structures)
    score: FloatArray  # z, (…, p): on a healthy axis normal with the covariance Ω
    square: FloatArray  # T² of the scores as it is distributed with chi-square, (…,)
    precision: FloatArray  # Ω⁻¹ as it is believed, (…, p, p)
    known: BoolArray  # (p,)
    log_weight: FloatArray  # once the session was seen, (…, p, n_structures)

    @property
    def relative(self) -> FloatArray:
        """Errors in standard deviations, (…, p), zero where nothing is known of a number."""
        return np.asarray((self.bank.weight * self.error / self.scale).sum(axis=-1) * self.known)


def judge(bank: Bank, design: FloatArray, days: float, values: FloatArray, known: BoolArray) -> Judged:
    """Predict a session so many days after the one before, and say by how much its values, (…, p), are off."""
    decay = _CORRELATION**days
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    mean[..., -1] *= decay
    covariance[:, -1, :] *= decay[:, None]
    covariance[:, :, -1] *= decay[:, None]
    covariance[:, -1, -1] += _SHARE * (1.0 - decay**2)
    bank = replace(bank, mean=mean, covariance=covariance)
    cross = covariance @ design
    spread = cross @ design + 1.0 - _SHARE
    error = values[..., None] - mean @ design
    scale = np.sqrt(bank.rate / bank.shape * spread)
    of_t, ratio = 2.0 * bank.shape, error / scale
    # the smaller tail has all its digits
    tail = np.clip((bank.weight * scipy.special.stdtr(of_t, -np.abs(ratio))).sum(axis=-1), 1e-300, 0.5)
    sign = np.sign((bank.weight * ratio).sum(axis=-1))
    if np.ptp(np.sign(ratio), axis=-1).any():  # structures do not agree on which side of the middle it lies
        below = (bank.weight * scipy.special.stdtr(of_t, ratio)).sum(axis=-1)
        tail, sign = np.clip(np.minimum(below, 1.0 - below), 1e-300, 0.5), np.where(below < 0.5, -1.0, 1.0)
    score = -sign * scipy.special.ndtri(tail)

    together, count = bank.together / bank.degrees, int(known.sum())
    precision: FloatArray = np.linalg.inv(together).astype(np.float64)
    if not known.all():  # what the others let expect adds nothing to T²: the marginal law
        of_known = np.linalg.solve(together[..., known, :][..., known], score[..., known, None])
        score[..., ~known] = (together[..., ~known, :][..., known] @ of_known)[..., 0]
    square = np.maximum(np.einsum("...i,...ij,...j->...", score, precision, score), 1e-300)
    beyond = np.maximum(scipy.special.fdtrc(count, bank.degrees, square / count), 1e-300)
    as_normal = scipy.special.chdtri(count, beyond)
    log_density = -np.log(scale) - 0.5 * (of_t + 1.0) * np.log1p(ratio**2 / of_t)
    log_weight = bank.log_weight + log_density * known[:, None]
    return Judged(
        bank,
        design,
        decay,
        cross / spread[:, None],
        spread,
        error,
        scale,
        score * np.sqrt(as_normal / square)[..., None],
        as_normal,
        precision,
        known,
        log_weight - np.logaddexp.reduce(log_weight, axis=-1)[..., None],
    )


def learn(judged: Judged) -> Bank:
    """Learn a session that has all numbers, of which no more than :data:`LARGEST_LESSON` is believed."""
    bank, gain, spread = judged.bank, judged.gain, judged.spread
    error = np.clip(judged.error, -LARGEST_LESSON * judged.scale, LARGEST_LESSON * judged.scale)
    score = np.clip(judged.score, -LARGEST_LESSON, LARGEST_LESSON)
    return Bank(
        bank.mean + gain * error[..., None],
        bank.covariance - gain[:, :, None] * gain[:, None, :] * spread[:, None, None],
        bank.rate + 0.5 * error**2 / spread,
        judged.log_weight,
        bank.together + score[..., :, None] * score[..., None, :],
        bank.n + 1.0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """What the sessions say of each session in which a step may have begun, the oldest first."""

    age: FloatArray  # days since it, (…, n_beginnings)
    merged: FloatArray  # logarithm of what others that it stands for add, as a factor, (…, n_beginnings)
    effect: FloatArray  # of a unit step on what is believed of a number, (…, n_beginnings, p, size of the state)
    cross: FloatArray  # c, (…, n_beginnings, p)
    found: FloatArray  # the same of the errors themselves, as large as they are, (…, n_beginnings, p)
    information: FloatArray  # Λ, (…, n_beginnings, p, p)

    def numbers(self) -> tuple[float, ...]:
        """Return all numbers of one axis, beginning by beginning."""
        n = self.age.size
        arrays = (self.age, self.merged, self.effect, self.cross, self.found, self.information)
        return tuple(np.hstack([a.reshape(n, a.size // max(n, 1)) for a in arrays]).ravel().tolist())


def weighed_from(numbers: tuple[float, ...], p: int) -> Weighed:
    """Return what is weighed of one axis, from its numbers in a row."""
    rows = np.array(numbers, dtype=np.float64).reshape(-1, 2 + p * (SIZE + 2 + p))
    age, merged, effect, cross, found, information = np.split(rows, np.cumsum([1, 1, p * SIZE, p, p]), axis=1)
    return Weighed(age[:, 0], merged[:, 0], effect.reshape(-1, p, SIZE), cross, found, information.reshape(-1, p, p))


def none_weighed(p: int, axes: tuple[int, ...] = ()) -> Weighed:
    """Return what is weighed before any session is."""
    return Weighed(*(np.zeros((*axes, 0, *shape)) for shape in ((), (), (p, SIZE), (p,), (p,), (p, p))))


def weigh(weighed: Weighed, judged: Judged, days: float, *, limit: float, learns: bool) -> Weighed:
    """Weigh one more session, and whether a step began in it; half of the limit of ln R is what it may bring alone."""
    p = judged.score.shape[-1]
    age, merged, effect = (
        _one_more(weighed.age + days, -1),
        _one_more(weighed.merged, -1),
        _one_more(weighed.effect, -3),
    )
    cross, found = _one_more(weighed.cross, -2), _one_more(weighed.found, -2)
    information = _one_more(weighed.information, -3)
    weight = judged.bank.weight
    effect[..., -1] *= (weight @ judged.decay)[..., None, :]
    left = 1.0 - effect @ judged.design
    seen = left * (weight @ (1.0 / np.sqrt(judged.spread)))[..., None, :]  # of a step, in standard deviations
    prior = STEP**2 / p
    largest = (limit + p * np.log1p(prior)) * (1.0 + 1.0 / prior)
    word = judged.score * np.sqrt(np.minimum(1.0, largest / judged.square))[..., None]
    scored = (judged.precision @ word[..., None])[..., 0]
    errors = (judged.precision @ judged.relative[..., None])[..., 0]
    if learns:
        effect = effect + left[..., None] * (weight @ judged.gain)[..., None, :, :]
    return Weighed(
        age,
        merged,
        effect,
        cross + seen * scored[..., None, :],
        found + seen * errors[..., None, :],
        information + seen[..., :, None] * judged.precision[..., None, :, :] * seen[..., None, :],
    )


def _one_more(array: FloatArray, axis: int) -> FloatArray:
    shape = list(array.shape)
    shape[axis] = 1
    return np.concatenate((array, np.zeros(shape)), axis=axis)


def posterior_precision(weighed: Weighed, judged: Judged) -> FloatArray:
    """Return the precision of the step since each beginning, prior included, (…, n_beginnings, p, p)."""
    p = weighed.cross.shape[-1]
    return np.asarray(weighed.information + p / STEP**2 * judged.precision[..., None, :, :])


@functools.cache
def directions_of(signs: tuple[float, ...]) -> FloatArray:
    """Return the directions in which a loss may go, (n_directions, p), where the ways of some numbers are known.

    ``signs``: 1 for a number that rises as preload is lost, -1 for one that falls, 0 where it is not known. Which of
    them show a loss is not known either: all subsets, in standard deviations alike.
    """
    known = [index for index, sign in enumerate(signs) if sign != 0.0]
    rows = []
    for chosen in range(1, 2 ** len(known)):
        row = np.zeros(len(signs))
        for bit, index in enumerate(known):
            row[index] = signs[index] if chosen >> bit & 1 else 0.0
        rows.append(row / np.linalg.norm(row))
    return np.array(rows).reshape(-1, len(signs))


def log_evidence(weighed: Weighed, judged: Judged, signs: tuple[float, ...]) -> FloatArray:
    """Return by how much a step since each beginning predicts better than none, (…, n_beginnings).

    Where the ways of all numbers are known, along the directions of a loss; where those of some are,
    :data:`ANY_WAY` of it is for a step of any direction; where none is, all.
    """
    directions = directions_of(signs)
    if not len(directions):
        return _of_any_step(weighed, judged)
    of_loss = _of_loss(weighed, directions)
    if all(signs):
        return of_loss
    return np.logaddexp(math.log(ANY_WAY) + _of_any_step(weighed, judged), math.log1p(-ANY_WAY) + of_loss)


def _of_any_step(weighed: Weighed, judged: Judged) -> FloatArray:
    p = weighed.cross.shape[-1]
    precision = posterior_precision(weighed, judged)
    step = np.linalg.solve(precision, weighed.cross[..., None])[..., 0]
    before = np.linalg.slogdet(p / STEP**2 * judged.precision)[1]
    grown = np.linalg.slogdet(precision)[1] - before[..., None]
    return np.asarray(0.5 * ((weighed.cross * step).sum(axis=-1) - grown))


def _of_loss(weighed: Weighed, directions: FloatArray) -> FloatArray:
    along = weighed.cross @ directions.T
    information = np.einsum("ki,...ij,kj->...k", directions, weighed.information, directions)
    known = information + STEP**-2
    of_loss = (
        0.5 * along**2 / known - 0.5 * np.log(STEP**2 * known)
        + math.log(2.0) + scipy.special.log_ndtr(along / np.sqrt(known))
    )  # fmt: skip
    return np.asarray(np.logaddexp.reduce(of_loss, axis=-1) - math.log(len(directions)))


def step_since(
    weighed: Weighed, judged: Judged, which: int, each: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the step of each number of one axis, its uncertainty, both in σ, and its share of the evidence.

    Step and uncertainty are over all beginnings, weighted by what they say: when it began is not known for certain. The
    shares are the squares of c of one of them, whitened so that each number keeps as much of itself as can be.
    """
    weight = np.exp(each - np.logaddexp.reduce(each))
    covariance = np.linalg.inv(weighed.information)  # without the prior, which would make large steps small
    steps = (covariance @ weighed.found[..., None])[..., 0]
    step: FloatArray = weight @ steps
    variance = weight @ (np.diagonal(covariance, axis1=-2, axis2=-1) + (steps - step) ** 2)
    precision, cross = posterior_precision(weighed, judged)[which], weighed.cross[which]
    deviation = np.sqrt(np.diagonal(precision))
    length, axes = np.linalg.eigh(precision / np.outer(deviation, deviation))
    white = (axes / np.sqrt(length)) @ axes.T @ (cross / deviation)
    return step, np.sqrt(variance), white**2 / float(white @ white)


def without_step(bank: Bank, weighed: Weighed, judged: Judged, which: int) -> Bank:
    """Give back what the filter has taken of a step since a beginning for level, season or dependence."""
    step = np.linalg.solve(posterior_precision(weighed, judged)[which], weighed.cross[which])
    taken = weighed.effect[which] * (step * bank.scatter)[:, None]
    return replace(bank, mean=bank.mean - taken[:, None, :])


def thinned(weighed: Weighed, each: FloatArray) -> tuple[Weighed, int | None]:
    """Let one of two neighbours stand for both where there are too many: of those that say little and lie together.

    ``each``: ln of the evidence, (…, n_beginnings). Returns which of them is gone, too, where it is one axis.
    """
    age = weighed.age
    if age.shape[-1] <= KEPT:
        return weighed, None
    own = each + weighed.merged
    both = np.logaddexp(own[..., :-1], own[..., 1:])
    # the newest stays: nothing is known of it yet
    first = np.argmin((both + np.log(age[..., :-1] - age[..., 1:]))[..., :-1], axis=-1)[..., None]
    older = np.take_along_axis(own, first, -1) >= np.take_along_axis(own, first + 1, -1)
    stays, gone = np.where(older, first, first + 1), np.where(older, first + 1, first)
    merged = weighed.merged.copy()
    joined = np.take_along_axis(both, first, -1) - np.take_along_axis(each, stays, -1)
    np.put_along_axis(merged, stays, joined, -1)
    left = np.arange(age.shape[-1] - 1)
    left = left + (left >= gone)

    def those(array: FloatArray) -> FloatArray:
        further = array.ndim - age.ndim
        return np.take_along_axis(array, left.reshape(*left.shape, *(1,) * further), -1 - further)

    arrays = (those(array) for array in (
        age, merged, weighed.effect, weighed.cross, weighed.found, weighed.information
    ))  # fmt: skip
    return Weighed(*arrays), int(gone[0]) if gone.ndim == 1 else None


def evidence_of_histories(
    values: FloatArray, n_baseline: int, limit: float, signs: tuple[float, ...] = ()
) -> FloatArray:
    """Return ln R of many axes, (n_axes, n_sessions, p), a session a day, all numbers known; NaN where none is judged.

    The baseline is learnt, its mean and scatter the units. What alarms goes on being learnt: only what comes until
    then is what :func:`monitor_core.trend.joint.joint_step` says.
    """
    n_axes, n_sessions, p = values.shape
    baseline = values[:, :n_baseline]
    values = (values - baseline.mean(axis=1)[:, None]) / baseline.std(axis=1, ddof=1)[:, None]
    bank, weighed, known = begin(p, (n_axes,)), none_weighed(p, (n_axes,)), np.ones(p, dtype=bool)
    found, signs = np.full((n_axes, n_sessions), np.nan), signs or (0.0,) * p
    for session in range(n_sessions):
        days = float(session > 0)
        judged = judge(bank, design_row(session / 365.25), days, values[:, session], known)
        bank = learn(judged)
        if session < n_baseline:
            continue
        weighed = weigh(weighed, judged, days, limit=limit, learns=True)
        each = log_evidence(weighed, judged, signs)
        if weighed.age.shape[-1] > 1:
            found[:, session] = np.logaddexp.reduce((each + weighed.merged)[:, :-1], axis=-1)
        weighed, _ = thinned(weighed, each)
    return found


def design_row(years: float, change: float = 0.0, warmer: float = 0.0) -> FloatArray:
    """Return the row of a session so long after the first, with change and excess of temperature in their units."""
    angle = 2.0 * np.pi * years
    return np.array([1.0, 1.0 - np.cos(angle), np.sin(angle), change, warmer, 1.0])
