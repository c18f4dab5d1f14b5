r"""Filter numbers of an axis and combinations of them, and weigh a step in each: the arithmetic of :mod:`.joint`.

Arrays may begin with a shape of axes that are measured at the same times, so that many are simulated at once.
"""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import BoolArray, FloatArray

#: How sessions depend on each other: φ of sessions a day apart, the share of the scatter that is so correlated, weight.
#: The last ones are of a slow cause that is most of the scatter.
STRUCTURES = np.array([
    (0.0, 0.0, 0.26), (0.3, 1.0, 0.10), (0.6, 1.0, 0.10), (0.6, 0.5, 0.08), (0.8, 1.0, 0.10), (0.85, 0.5, 0.10),
    (0.9, 0.9, 0.08), (0.96, 0.4, 0.08), (0.96, 0.8, 0.05), (0.96, 1.0, 0.05),
])  # fmt: skip
_CORRELATION, _SHARE, _WEIGHT = STRUCTURES.T
#: Level, season (two), change of the temperature in a day, temperature; the autoregression is the last of the state.
_DEVIATIONS = np.array([100.0, 0.8, 0.8, 4.0, 2.0])  # of these coefficients, in standard deviations of a session
SIZE = _DEVIATIONS.size + 1
#: Sessions that the prior of the correlations, none, is worth.
WORTH = 5.0
#: A step has so many standard deviations of a session.
STEP = 2.0
#: Belief that a step may go any way, where the ways in which a loss moves some numbers are known and others' are not.
ANY_WAY = 0.25
#: One session may teach no more than so many standard deviations.
LARGEST_LESSON = 4.0
#: Sessions that are remembered as possible beginnings.
KEPT = 12


def correlation_of(values: FloatArray) -> FloatArray:
    """Return the correlation of what is new in each session in numbers, (…, n_sessions, p), shrunk towards none.

    From one session to the next: levels of a slow autoregression look alike or opposed by chance (spurious correlation,
    Granger & Newbold, J. Econometrics 2 (1974) 111–120).
    """
    new = np.diff(values, axis=-2)
    n, p = new.shape[-2:]
    together = new.swapaxes(-1, -2) @ new
    deviation = np.sqrt(np.diagonal(together, axis1=-2, axis2=-1))
    deviation = np.where(deviation > 0.0, deviation, 1.0)  # what stays as it is goes with nothing
    correlation = together / (deviation[..., :, None] * deviation[..., None, :])
    correlation[..., range(p), range(p)] = 1.0
    return np.asarray((n * correlation + WORTH * np.eye(p)) / (n + WORTH))


def series_of(correlation: FloatArray, signs: tuple[float, ...]) -> FloatArray:
    r"""Return the combinations in which steps are looked for, and the numbers: (…, n_series, p), of unit scatter.

    ``signs``: 1 for a number that rises as preload is lost, -1 for one that falls, 0 where it is not known. First the
    losses, upwards, of which there are :func:`n_losses`: all subsets of the numbers whose way is known, since which of
    them show a loss is not. A step along d, in standard deviations of each number, shows best in
    :math:`a = \Omega^{-1} d` (Healy, Technometrics 29 (1987) 409–412). Where ways are not known, then sums and
    differences of all numbers, whitened, each with a weight of 1, 0 or -1. The numbers are the last p.
    """
    known, numbers = [index for index, sign in enumerate(signs) if sign != 0.0], np.eye(len(signs))
    losses = np.zeros((n_losses(signs), len(signs)))
    for bit, index in enumerate(known):
        losses[:, index] = signs[index] * (np.arange(1, len(losses) + 1) >> bit & 1)
    best = np.linalg.solve(correlation, losses.T).swapaxes(-1, -2)
    best /= np.sqrt((best * losses).sum(axis=-1, keepdims=True))
    variance, components = np.linalg.eigh(correlation)
    white = (components / np.sqrt(variance)[..., None, :]) @ components.swapaxes(-1, -2)
    ways = np.array([way for way in itertools.product((0.0, 1.0, -1.0), repeat=len(signs)) if _is_first(way)])
    any_way = (ways / np.linalg.norm(ways, axis=1)[:, None])[: 0 if all(signs) else None] @ white
    return np.concatenate((best, any_way, np.broadcast_to(numbers, correlation.shape)), axis=-2)


def n_losses(signs: tuple[float, ...]) -> int:
    """Return in how many directions a loss may go."""
    return int(2 ** sum(sign != 0.0 for sign in signs) - 1)


def _is_first(way: tuple[float, ...]) -> bool:
    """Tell one of two opposite ways from the other, and from none."""
    return next((weight for weight in way if weight), 0.0) > 0.0


def log_sum(logarithms: FloatArray) -> FloatArray:
    """Return the logarithm of the sum of numbers over the last axis, given theirs."""
    largest = logarithms.max(axis=-1)
    return np.asarray(largest + np.log(np.exp(logarithms - largest[..., None]).sum(axis=-1)))


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """What is believed of each series, by structure."""

    mean: FloatArray  # (…, n_series, n_structures, size of the state)
    covariance: FloatArray  # (n_structures, size of the state, size of the state), in units of σ²: alike for all
    rate: FloatArray  # b of the inverse gamma of σ², (…, n_series, n_structures)
    log_weight: FloatArray  # (…, n_series, n_structures)
    correlation: FloatArray  # Ω of the numbers, (…, p, p)
    series: FloatArray  # (…, n_series, p)
    n: float  # sessions that were learnt

    @property
    def shape(self) -> float:
        """Shape a of the inverse gamma."""
        return 0.5 * (1.0 + self.n)

    @property
    def weight(self) -> FloatArray:
        """Probability of each structure, (…, n_series, n_structures)."""
        return np.asarray(np.exp(self.log_weight))

    @property
    def scatter(self) -> FloatArray:
        """Standard deviation σ of each series from session to session, (…, n_series)."""
        return np.asarray(np.sqrt((self.weight * self.rate).sum(axis=-1) / self.shape))

    def numbers(self) -> tuple[float, ...]:
        """Return all numbers of one axis in a row."""
        (i, j), (k, m) = _upper(SIZE), _upper(self.correlation.shape[-1])
        beliefs = (self.mean, self.rate, self.log_weight, self.covariance[:, i, j])
        arrays = (self.series, *beliefs, self.correlation[k, m])
        return (*np.concatenate([a.ravel() for a in arrays]).tolist(), self.n)


def bank_from(numbers: tuple[float, ...], p: int) -> Bank:
    """Return what is believed of the p numbers of one axis, from its numbers in a row."""
    n, of_state = len(STRUCTURES), SIZE * (SIZE + 1) // 2
    count = (len(numbers) - 1 - n * of_state - p * (p + 1) // 2) // (p + n * (SIZE + 2))
    sizes = [count * p, count * n * SIZE, count * n, count * n, n * of_state]
    series, mean, rate, weight, covariance, together = np.split(np.array(numbers[:-1]), np.cumsum(sizes))
    return Bank(
        mean.reshape(count, n, SIZE), _symmetric(covariance.reshape(n, -1), SIZE), rate.reshape(count, n),
        weight.reshape(count, n), _symmetric(together[None], p)[0], series.reshape(count, p), numbers[-1],
    )  # fmt: skip


@functools.cache
def _upper(size: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    return np.triu_indices(size)


def _symmetric(upper: FloatArray, size: int) -> FloatArray:
    i, j = _upper(size)
    full = np.empty((len(upper), size, size))
    full[:, i, j] = full[:, j, i] = upper
    return full


def begin(correlation: FloatArray, signs: tuple[float, ...]) -> Bank:
    """Return what is known before the first session of numbers of a correlation, (…, p, p).

    They are counted in their scatter from their mean.
    """
    n, series = len(STRUCTURES), series_of(correlation, signs)
    covariance = np.zeros((n, SIZE, SIZE))
    covariance[:, range(SIZE), range(SIZE)] = [*_DEVIATIONS**2, 0.0]
    covariance[:, -1, -1] = _SHARE
    shape = (*series.shape[:-1], n)
    log_weight = np.broadcast_to(np.log(_WEIGHT), shape).copy()
    return Bank(np.zeros((*shape, SIZE)), covariance, np.full(shape, 0.5), log_weight, correlation, series, 0.0)


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
    error: FloatArray  # (…, n_series, n_structures)
    scale: FloatArray  # of its t, (…, n_series, n_structures)
    log_weight: FloatArray  # once the session was seen, (…, n_series, n_structures)

    @property
    def relative(self) -> FloatArray:
        """Errors in standard deviations, (…, n_series)."""
        return np.asarray((self.bank.weight * self.error / self.scale).sum(axis=-1))

    @property
    def score(self) -> FloatArray:
        """Normal scores of the errors: on a healthy axis of that structure standard normal and independent."""
        # the smaller tail has all its digits
        tail = np.maximum(scipy.special.stdtr(2.0 * self.bank.shape, -np.abs(self.error / self.scale)), 1e-300)
        return np.asarray(-np.sign(self.error) * scipy.special.ndtri(tail))


def judge(bank: Bank, design: FloatArray, days: float, values: FloatArray, known: BoolArray) -> Judged:
    """Predict a session so many days after the one before, and say by how much its values, (…, p), are off.

    What is not ``known`` is taken as the others let it expect: all combinations are then those of the others alone.
    """
    decay = _CORRELATION**days
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    mean[..., -1] *= decay
    covariance[:, -1, :] *= decay[:, None]
    covariance[:, :, -1] *= decay[:, None]
    covariance[:, -1, -1] += _SHARE * (1.0 - decay**2)
    bank = replace(bank, mean=mean, covariance=covariance)
    cross = covariance @ design
    spread = cross @ design + 1.0 - _SHARE
    predicted = mean @ design
    if not known.all():
        p = known.size
        expected = (bank.weight[..., -p:, :] * predicted[..., -p:, :]).sum(axis=-1)
        off = (values - expected)[..., known, None]
        among = bank.correlation[..., known, :]
        off = among[..., ~known].swapaxes(-1, -2) @ np.linalg.solve(among[..., known], off)
        values = values.copy()
        values[..., ~known] = expected[..., ~known] + off[..., 0]
    error = (bank.series @ values[..., None]) - predicted
    scale = np.sqrt(bank.rate / bank.shape * spread)
    of_t = 2.0 * bank.shape
    log_weight = bank.log_weight - np.log(scale) - 0.5 * (of_t + 1.0) * np.log1p((error / scale) ** 2 / of_t)
    log_weight -= log_sum(log_weight)[..., None]
    return Judged(bank, design, decay, cross / spread[:, None], spread, error, scale, log_weight)


def learn(judged: Judged) -> Bank:
    """Learn a session that has all numbers, of which no more than :data:`LARGEST_LESSON` is believed."""
    bank, gain, spread = judged.bank, judged.gain, judged.spread
    error = np.clip(judged.error, -LARGEST_LESSON * judged.scale, LARGEST_LESSON * judged.scale)
    return replace(
        bank,
        mean=bank.mean + gain * error[..., None],
        covariance=bank.covariance - gain[:, :, None] * gain[:, None, :] * spread[:, None, None],
        rate=bank.rate + 0.5 * error**2 / spread,
        log_weight=judged.log_weight,
        n=bank.n + 1.0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """What the sessions say of each session in which a step may have begun, the oldest first."""

    age: FloatArray  # days since it, (…, n_beginnings)
    merged: FloatArray  # logarithm of what others that it stands for add, as a factor, (…, n_beginnings)
    effect: FloatArray  # of a unit step on what is believed, (…, n_beginnings, n_structures, size of the state)
    information: FloatArray  # Λ, (…, n_beginnings, n_structures)
    cross: FloatArray  # c, (…, n_beginnings, n_series, n_structures)

    def numbers(self) -> tuple[float, ...]:
        """Return all numbers of one axis, beginning by beginning."""
        n = self.age.size
        arrays = (self.age, self.merged, self.effect, self.information, self.cross)
        return tuple(np.hstack([a.reshape(n, a.size // max(n, 1)) for a in arrays]).ravel().tolist())


def weighed_from(numbers: tuple[float, ...], n_series: int) -> Weighed:
    """Return what is weighed of one axis, from its numbers in a row."""
    n = len(STRUCTURES)
    rows = np.array(numbers, dtype=np.float64).reshape(-1, 2 + n * (SIZE + 1 + n_series))
    age, merged, effect, information, cross = np.split(rows, np.cumsum([1, 1, n * SIZE, n]), axis=1)
    return Weighed(age[:, 0], merged[:, 0], effect.reshape(-1, n, SIZE), information, cross.reshape(-1, n_series, n))


def none_weighed(n_series: int, axes: tuple[int, ...] = ()) -> Weighed:
    """Return what is weighed before any session is."""
    n = len(STRUCTURES)
    return Weighed(*(np.zeros((*axes, 0, *shape)) for shape in ((), (), (n, SIZE), (n,), (n_series, n))))


def weigh(
    weighed: Weighed, judged: Judged, days: float, signs: tuple[float, ...], *, limit: float, learns: bool
) -> Weighed:
    """Weigh one more session, and whether a step began in it; half of the limit of ln R is what it may bring alone."""
    p = len(signs)
    age, merged = _one_more(weighed.age + days, -1), _one_more(weighed.merged, -1)
    effect, information = _one_more(weighed.effect, -3), _one_more(weighed.information, -2)
    effect[..., -1] *= judged.decay
    left = 1.0 - effect @ judged.design
    seen = left / np.sqrt(judged.spread)  # of a step, in standard deviations
    word = judged.error / judged.scale  # of a number as large as it is
    combined = limit - 2.0 * _log_density(signs, word.shape[-2] - p)
    largest = np.sqrt((combined + np.log1p(STEP**2)) * (1.0 + STEP**-2))[:, None]
    word[..., :-p, :] = np.clip(judged.score[..., :-p, :], -largest, largest)
    if learns:
        effect = effect + left[..., None] * judged.gain
    cross = _one_more(weighed.cross, -3) + seen[..., :, None, :] * word[..., None, :, :]
    return Weighed(age, merged, effect, information + seen**2, cross)


def _one_more(array: FloatArray, axis: int) -> FloatArray:
    shape = list(array.shape)
    shape[axis] = 1
    return np.concatenate((array, np.zeros(shape)), axis=axis)


def log_evidence(weighed: Weighed, judged: Judged, signs: tuple[float, ...]) -> FloatArray:
    """Return by how much a step since each beginning predicts better than none, (…, n_beginnings, n_combinations).

    Of a loss a step upwards, half-normal, of another combination one of either way; over all structures, with the
    probability of the combination, of which :data:`ANY_WAY` is of those that are none of a loss.
    """
    count, p = n_losses(signs), len(signs)
    cross, known = weighed.cross[..., :-p, :], weighed.information[..., None, :] + STEP**-2
    of_structure = 0.5 * cross**2 / known - 0.5 * np.log(STEP**2 * known)
    of_structure[..., :count, :] += scipy.special.log_ndtr(cross[..., :count, :] / np.sqrt(known))
    of_all = log_sum(judged.log_weight[..., None, :-p, :] + of_structure)
    return np.asarray(of_all + _log_density(signs, cross.shape[-2]))


def _log_density(signs: tuple[float, ...], n_combinations: int) -> FloatArray:
    """Return what is believed of each combination, of a loss twice, since it goes one way only.

    As many numbers as there are or fewer show a loss, each count of them as likely, and those of one count alike (Scott
    & Berger, Ann. Stat. 38 (2010) 2587–2619): that all show it is no rarer than that one of them does.
    """
    known = sum(sign != 0.0 for sign in signs)
    shown = np.array([subset.bit_count() for subset in range(1, n_losses(signs) + 1)], dtype=int)
    others = n_combinations - shown.size
    any_way = 0.0 if not others else ANY_WAY if known else 1.0
    of_losses = 2.0 * (1.0 - any_way) / (known * scipy.special.comb(known, shown)) if known else np.zeros(0)
    return np.asarray(np.log(np.concatenate((of_losses, np.full(others, any_way / max(others, 1))))))


def step_of(weighed: Weighed, judged: Judged, which: int, series: int) -> float:
    """Return the step of a combination since a beginning, in its σ."""
    weight = np.exp(judged.log_weight[series])
    return float(weight @ (weighed.cross[which, series] / (weighed.information[which] + STEP**-2)))


def changes_since(weighed: Weighed, judged: Judged, each: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the step of each number of one axis, its uncertainty, both in σ, and its share of the evidence.

    Step and uncertainty are over all structures and beginnings, weighted by what they say: when it began is not
    known for certain. The shares are the squares of the steps, whitened so that each number keeps as much as can be.
    """
    p = judged.bank.correlation.shape[-1]
    began = np.exp(each - log_sum(each))
    information, cross = weighed.information[:, None, :], weighed.cross[:, -p:]
    known = information + STEP**-2
    of_structure = judged.log_weight[-p:] + 0.5 * cross**2 / known - 0.5 * np.log(known)
    of_structure -= log_sum(of_structure)[..., None]
    weight = began[:, None, None] * np.exp(of_structure)
    steps = cross / information  # without the prior, which would make large steps small
    step: FloatArray = (weight * steps).sum(axis=(0, 2))
    variance = (weight * (1.0 / information + (steps - step[:, None]) ** 2)).sum(axis=(0, 2))
    length, axes = np.linalg.eigh(judged.bank.correlation)
    white = (axes / np.sqrt(length)) @ axes.T @ step
    return step, np.sqrt(variance), white**2 / float(white @ white)


def without_step(bank: Bank, weighed: Weighed, which: int) -> Bank:
    """Give back what the filter has taken of a step since a beginning for level, season or dependence."""
    step = weighed.cross[which] / (weighed.information[which] + STEP**-2)
    step = step * np.sqrt(bank.rate / bank.shape)
    return replace(bank, mean=bank.mean - weighed.effect[which] * step[..., None])


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
        age, merged, weighed.effect, weighed.information, weighed.cross
    ))  # fmt: skip
    return Weighed(*arrays), int(gone[0]) if gone.ndim == 1 else None


def design_row(years: float, change: float = 0.0, warmer: float = 0.0) -> FloatArray:
    """Return the row of a session so long after the first, with change and excess of temperature in their units."""
    angle = 2.0 * np.pi * years
    return np.array([1.0, 1.0 - np.cos(angle), np.sin(angle), change, warmer, 1.0])
