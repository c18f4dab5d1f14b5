r"""Learn what a healthy axis does from session to session, and predict the next one with all that is not known yet.

The value of session t, nine structures side by side, each weighted by how well it has predicted:

.. math:: y_t = x_t^\mathsf{T} \beta + e_t + w_t, \qquad e_t = \varphi^{\Delta t} e_{t-\Delta t} + v_t

with the level, a season of a year, temperature, its change in a day and friction in x; e an autoregression of first
order with the share s of the scatter σ², and white noise w with the rest (AR(1) plus noise: Lu & Reynolds, J. Qual.
Technol. 31 (1999) 259–274). A structure is one pair φ, s. Coefficients and σ² are learnt with the normal–inverse-gamma
prior of Bayesian linear regression, as a Kalman filter in units of σ² (West & Harrison, Bayesian Forecasting and
Dynamic Models, 2nd ed., Springer, 1997, section 4.5); the prediction is then Student's t with 2a degrees of freedom,
wider wherever a covariate goes beyond what was seen, and a mixture over the structures. Its probability integral makes
every residual standard normal and independent of those before, as long as the axis is healthy and one of the structures
is near.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cached_property

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.trend.observation import Session

DAY = timedelta(days=1)
YEAR = timedelta(days=365.25)


@dataclass(frozen=True, slots=True)
class Structure:
    """How the sessions of an axis depend on each other."""

    correlation: float  # φ, of sessions a day apart
    share: float  # s, of the scatter that is correlated
    weight: float  # before anything is known


STRUCTURES = (
    Structure(0.0, 0.0, 0.34),
    Structure(0.15, 1.0, 0.06),
    Structure(0.3, 1.0, 0.08),
    Structure(0.45, 1.0, 0.06),
    Structure(0.6, 0.5, 0.10),
    Structure(0.6, 1.0, 0.08),
    Structure(0.8, 1.0, 0.08),
    Structure(0.85, 0.5, 0.08),
    Structure(0.96, 0.4, 0.12),
)
_CORRELATION = np.array([structure.correlation for structure in STRUCTURES])
_SHARE = np.array([structure.share for structure in STRUCTURES])
_WHITE = 1.0 - _SHARE
#: Level, season (two), change of the temperature in a day, temperature, friction torque; the autoregression is the last
#: member of the state. The change stands for a structure that lags behind its thermometer.
N_COEFFICIENTS = 6
_SIZE = N_COEFFICIENTS + 1
_DEPENDENCE = N_COEFFICIENTS
_UPPER = np.triu_indices(_SIZE)
#: A coefficient is known in units of the scatter: per this many kelvin ...
KELVIN = 10.0
#: ... and per this share of the friction torque.
FRICTION_SHARE = 0.25
#: A friction torque that rises from one session to the next by so many of its usual steps, and by such a share, looks
#: like lubrication: fresh grease resists, while a loss of preload lets friction fall. Of the steps so many are needed.
JUMP, LEAST_JUMP, FEWEST_STEPS = 5.0, 0.1, 10
#: By so many standard deviations of a session lubrication may move the level. More would hide larger losses that come
#: with it, and no more of lubrications.
LUBRICATION = 1.0
#: What nothing is known about: the level.
_OPEN = 100.0
#: One session may say so many standard deviations, not more.
LARGEST_LESSON = 4.0


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a healthy axis before its first session: by default little, from sisters more."""

    weights: tuple[float, ...] = tuple(structure.weight for structure in STRUCTURES)
    # season (two), per 10 K in a day, per 10 K, per quarter of the friction torque, in the unit of the observations
    coefficients: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    deviations: tuple[float, ...] = (0.8, 0.8, 4.0, 2.0, 2.0)  # of these coefficients, in units of the scatter
    variance: float | None = None  # σ², in the squared unit of the observations
    degrees_of_freedom: float = 1.0  # of this variance
    n_sisters: int = 0  # that it was learnt from


@dataclass(frozen=True, slots=True)
class Covariate:
    """What was seen of a covariate."""

    reference: float  # its first value
    lowest: float
    highest: float
    mean: float
    squares: float  # sum of the squared deviations from the mean
    count: int

    def with_value(self, value: float) -> "Covariate":
        """Return what was seen with one more value."""
        deviation = value - self.mean
        mean = self.mean + deviation / (self.count + 1)
        squares = self.squares + deviation * (value - mean)
        low, high = min(self.lowest, value), max(self.highest, value)
        return Covariate(self.reference, low, high, mean, squares, self.count + 1)

    @property
    def variance(self) -> float:
        """Variance of what was seen."""
        return self.squares / max(self.count - 1, 1)


class Numbers:
    """Arrays that belong together. They are shared, and never changed once a state holds them."""

    __slots__ = ()

    def numbers(self) -> FloatArray:
        """Return all numbers, as a store keeps them."""
        raise NotImplementedError

    def __eq__(self, other: object) -> bool:
        """Tell whether all numbers are the same."""
        return isinstance(other, type(self)) and np.array_equal(self.numbers(), other.numbers())

    def __hash__(self) -> int:
        """Return the same for the same numbers."""
        return hash(self.numbers().tobytes())


class Bank(Numbers):
    r"""Posterior of all structures; variances in units of σ². The structures are the last axis of all arrays.

    Of each structure, shape (size + 1, size + 1, n_structures), ``joint`` is

    .. math:: J = \begin{pmatrix} C & m \\ m^\mathsf{T} & -2b \end{pmatrix}

    with mean m and covariance C of the state, and the rate b of the inverse gamma of σ². A value y of the design x is
    learnt by one subtraction (a sweep: Goodnight, Am. Stat. 33 (1979) 149–158), of which C, m and b have the gain, the
    error and its square:

    .. math:: J - u u^\mathsf{T} / s, \qquad u = \begin{pmatrix} C x \\ m^\mathsf{T} x - y \end{pmatrix}

    with s the variance of the value in units of σ². ``shape`` is the other parameter of the inverse gamma, which counts
    sessions and so is common; ``log_weight``, (n_structures,), the logarithm of the probability of each structure.
    """

    __slots__ = ("joint", "log_weight", "shape", "weight")

    def __init__(self, joint: FloatArray, shape: float, log_weight: FloatArray) -> None:
        """Take the arrays as they are."""
        self.joint, self.shape, self.log_weight = joint, shape, log_weight
        self.weight: FloatArray = np.exp(log_weight)  # probability of each structure

    @property
    def mean(self) -> FloatArray:
        """Of the state, (size, n_structures)."""
        return self.joint[-1, :-1]

    @property
    def covariance(self) -> FloatArray:
        """Of the state, (size, size, n_structures)."""
        return self.joint[:-1, :-1]

    @property
    def rate(self) -> FloatArray:
        """Rate b of the inverse gamma of σ², (n_structures,)."""
        return np.asarray(-0.5 * self.joint[-1, -1])

    @property
    def variance(self) -> float:
        """Scatter σ² as it is believed now."""
        return float(self.weight @ self.joint[-1, -1]) / (-2.0 * self.shape)

    def with_covariance(self, added: FloatArray) -> "Bank":
        """Return the same with so much more covariance of the state."""
        joint = self.joint.copy()
        joint[:-1, :-1] += added
        return Bank(joint, self.shape, self.log_weight)

    def numbers(self) -> FloatArray:
        """Return mean, upper triangle of the covariance, a, b and ln weight of each structure."""
        of_all = (np.full(len(STRUCTURES), self.shape), self.rate, self.log_weight)
        return np.vstack((self.mean, self.covariance[_UPPER], *of_all)).T

    @classmethod
    def of(cls, numbers: FloatArray) -> "Bank":
        """Return the bank of such numbers, in a row or not."""
        columns = numbers.reshape(len(STRUCTURES), _SIZE + len(_UPPER[0]) + 3).T
        joint = np.empty((_SIZE + 1, _SIZE + 1, len(STRUCTURES)))
        joint[:-1, :-1][_UPPER] = joint[:-1, :-1][_UPPER[::-1]] = columns[_SIZE:-3]
        joint[:-1, -1] = joint[-1, :-1] = columns[:_SIZE]
        joint[-1, -1] = -2.0 * columns[-2]
        return cls(joint, float(columns[-3, 0]), columns[-1].copy())


@dataclass(frozen=True, slots=True)
class Belief:
    """What was learnt of a healthy axis."""

    started_at: datetime
    last_at: datetime  # start of the last session, learnt or not
    ended_at: datetime  # end of the last session that was learnt
    zero: float  # values are counted from here, in their unit
    bank: Bank
    n_sessions: int = 0
    n_observations: int = 0
    within_squares: float = 0.0  # of the observations about the mean of their session
    temperature: Covariate | None = None
    friction_torque: Covariate | None = None
    change: Covariate | None = None  # of the temperature in a day, in units of KELVIN
    friction_step: Covariate | None = None  # of the friction torque, from one session to the next [N·m]
    latest_temperature: float | None = None  # of the last session, learnt or not; None if it was not stated
    latest_friction: float | None = None  # the same of the friction torque
    lubricated_at: datetime | None = None  # the last session before which it was, or that looks so


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a healthy axis was expected to show in a session, by structure, and what follows from it for the belief."""

    bank: Bank  # at the time of the session
    design: FloatArray  # row x of the session, (size + 1,), the last member 0
    swept: FloatArray  # u of :class:`Bank`, (size + 1, n_structures)
    spread: FloatArray  # variance s of the value in units of σ², (n_structures,)
    noise: float  # variance that this session has on top, in units of σ²
    difference: float  # by how much the session is off what was expected of it
    decay: FloatArray  # of the autoregression since the session before, (n_structures,)
    lubricated: bool  # so it was said, or looks: the level is open to it
    squares: FloatArray  # 2b s, the degrees of freedom times the squared scale, (n_structures,)
    scale: FloatArray  # of Student's t, (n_structures,)

    @property
    def unlearnt(self) -> float:
        """Share of the variance of the prediction that is due to the coefficients, not to the scatter of sessions."""
        of_coefficients = self.swept[:N_COEFFICIENTS] - self.bank.joint[_DEPENDENCE, :N_COEFFICIENTS]
        share = self.design[:N_COEFFICIENTS] @ of_coefficients / self.spread
        # more than all where the dependence takes back some of it
        return float(self.bank.weight @ np.minimum(np.maximum(share, 0.0), 1.0))

    @cached_property
    def log_weight(self) -> FloatArray:
        """Logarithm of the weight of each structure once the session is known."""
        unexpected = np.log1p(self.swept[-1] ** 2 / self.squares)
        relative = self.bank.log_weight - 0.5 * np.log(self.squares) - (self.bank.shape + 0.5) * unexpected
        return np.asarray(relative - np.logaddexp.reduce(relative))

    def residual(self, moved: float = 0.0) -> float:
        r"""Return the residual as its normal score, :math:`z = \Phi^{-1}(F(y))`, of the value moved by so much."""
        ratio, weight = (moved - self.swept[-1]) / self.scale, self.bank.weight
        below = float(weight @ scipy.special.stdtr(2.0 * self.bank.shape, ratio))
        if below <= 0.5:
            return float(scipy.special.ndtri(max(below, 1e-300)))
        # the smaller tail has all its digits
        above = float(weight @ scipy.special.stdtr(2.0 * self.bank.shape, -ratio))
        return -float(scipy.special.ndtri(max(above, 1e-300)))


def begin(first: Session, prior: Prior, variance: float) -> Belief:
    """Return the belief before anything is learnt of an axis whose first session is given, with a rough variance."""
    joint = np.zeros((_SIZE + 1, _SIZE + 1, len(STRUCTURES)))
    for i, deviation in enumerate((_OPEN, *prior.deviations)):
        joint[i, i] = deviation**2
    joint[_DEPENDENCE, _DEPENDENCE] = _SHARE
    for i, coefficient in enumerate(prior.coefficients, start=1):
        joint[i, -1] = joint[-1, i] = coefficient
    joint[-1, -1] = -prior.degrees_of_freedom * (variance if prior.variance is None else prior.variance)
    weights = np.array(prior.weights)
    bank = Bank(joint, 0.5 * prior.degrees_of_freedom, np.log(weights / weights.sum()))
    return Belief(first.started_at, first.started_at, first.last_at, first.value, bank)


def reopened(belief: Belief) -> Belief:
    """Forget the level, and keep what was learnt of scatter, dependence, season and covariates."""
    opened = np.zeros((_SIZE, _SIZE, 1))
    opened[0, 0] = _OPEN**2
    return replace(belief, bank=belief.bank.with_covariance(opened))


def predict(belief: Belief, session: Session) -> Prediction:
    """Predict a session that is later than all that was learnt."""
    before = belief.bank
    decay = _CORRELATION ** ((session.started_at - belief.last_at) / DAY)
    joint = before.joint.copy()
    joint[_DEPENDENCE, _DEPENDENCE] -= _SHARE  # what differs from its long run is forgotten
    joint[_DEPENDENCE] *= decay
    joint[:, _DEPENDENCE] *= decay
    joint[_DEPENDENCE, _DEPENDENCE] += _SHARE
    lubricated = _is_lubricated(belief, session)
    if lubricated:
        joint[0, 0] += LUBRICATION**2
    bank = Bank(joint, before.shape, before.log_weight)

    design, unknown = _design(belief, session)
    swept = applied(design, joint)
    swept[-1] -= session.value - belief.zero
    noise = _noise(belief, bank.variance, session)
    spread = design @ swept + (_WHITE + noise)
    if any(unknown):
        spread += _of_unknown(bank, unknown)
    squares = -joint[-1, -1] * spread
    scale = np.sqrt(squares / (2.0 * bank.shape))
    difference = -float(bank.weight @ swept[-1])
    return Prediction(bank, design, swept, spread, noise, difference, decay, lubricated, squares, scale)


def applied(design: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the sum over the first axis, weighted by a design."""
    return np.asarray((design @ rows.reshape(len(design), -1)).reshape(rows.shape[1:]))


def learn(belief: Belief, prediction: Prediction, session: Session) -> Belief:
    """Learn a session, of which no more than :data:`LARGEST_LESSON` standard deviations are believed."""
    bank, lubricated, lesson = prediction.bank, prediction.lubricated, _lesson(prediction)
    learnt = Bank(bank.joint - lesson[:, None] * lesson, bank.shape + 0.5, prediction.log_weight)
    return Belief(
        belief.started_at,
        session.started_at,
        session.last_at,
        belief.zero,
        learnt,
        belief.n_sessions + 1,
        belief.n_observations + session.count,
        belief.within_squares + session.squares,
        _seen(belief.temperature, session.temperature),
        _seen(belief.friction_torque, session.friction_torque),
        _seen(belief.change, _change(belief, session)),
        belief.friction_step if lubricated else _seen(belief.friction_step, _step(belief, session)),
        session.temperature,
        session.friction_torque,
        session.started_at if lubricated else belief.lubricated_at,
    )


def pass_over(belief: Belief, prediction: Prediction, session: Session) -> Belief:
    """Follow the autoregression over a session that something speaks against, and learn nothing else of it.

    The filter of Schmidt, which considers the uncertainty of the coefficients and does not update them: of what the
    session would teach, the row and the column of the autoregression.
    """
    bank, lesson = prediction.bank, _lesson(prediction)
    joint = bank.joint.copy()
    joint[_DEPENDENCE] -= lesson[_DEPENDENCE] * lesson
    joint[:, _DEPENDENCE] = joint[_DEPENDENCE]
    return replace(
        belief,
        last_at=session.started_at,
        bank=Bank(joint, bank.shape, bank.log_weight),
        latest_temperature=session.temperature,
        latest_friction=session.friction_torque,
        lubricated_at=session.started_at if prediction.lubricated else belief.lubricated_at,
    )


def _lesson(prediction: Prediction) -> FloatArray:
    """Return u of :class:`Bank` over the square root of s, with as much of the error as is believed."""
    lesson = prediction.swept / np.sqrt(prediction.spread)
    largest = LARGEST_LESSON * np.sqrt(prediction.bank.rate / prediction.bank.shape)
    lesson[-1] = np.minimum(np.maximum(lesson[-1], -largest), largest)
    return np.asarray(lesson)


def learnt_from(sessions: Sequence[Session], start: Belief) -> Belief:
    """Learn sessions one after another."""
    belief = start
    for session in sessions:
        belief = learn(belief, predict(belief, session), session)
    return belief


def healthy_value(belief: Belief, at: datetime) -> tuple[float, float]:
    """Return what is normal at some time under the mean conditions, and its standard uncertainty."""
    bank, row = belief.bank, _season(belief, at)[:N_COEFFICIENTS]
    for i, covariate in enumerate((_scaled(belief.temperature, None, KELVIN), _friction(belief.friction_torque, None))):
        row[N_COEFFICIENTS - 2 + i] = covariate
    of_row = applied(row, bank.joint[:N_COEFFICIENTS])
    centre, own = of_row[-1], bank.rate / bank.shape * (row @ of_row[:N_COEFFICIENTS])
    mean = float(bank.weight @ centre)
    return belief.zero + mean, math.sqrt(max(float(bank.weight @ (own + (centre - mean) ** 2)), 0.0))


def _season(belief: Belief, at: datetime) -> FloatArray:
    angle = 2.0 * math.pi * ((at - belief.started_at) / YEAR)
    return np.array([1.0, 1.0 - math.cos(angle), math.sin(angle), 0.0, 0.0, 0.0, 1.0, 0.0])


def _design(belief: Belief, session: Session) -> tuple[FloatArray, tuple[float, ...]]:
    """Return the row of a session, and the variance of each covariate that was not measured in it."""
    row, change = _season(belief, session.started_at), _change(belief, session)
    row[3] = change or 0.0
    row[4] = _scaled(belief.temperature, session.temperature, KELVIN)
    row[5] = _friction(belief.friction_torque, session.friction_torque)
    return row, (
        _variance_unless_known(belief.change, change, 1.0),
        _variance_unless_known(belief.temperature, session.temperature, KELVIN),
        _variance_unless_known(belief.friction_torque, session.friction_torque, _friction_unit(belief.friction_torque)),
    )


def _change(belief: Belief, session: Session) -> float | None:
    return change_in_a_day(belief.latest_temperature, session.temperature, session.started_at - belief.last_at)


def _step(belief: Belief, session: Session) -> float | None:
    before, now = belief.latest_friction, session.friction_torque
    return None if before is None or now is None else now - before


def _is_lubricated(belief: Belief, session: Session) -> bool:
    """Tell whether that was said, or friction has risen at once, as it does with fresh grease and not with a loss."""
    if session.lubricated:
        return True
    usual, step = belief.friction_step, _step(belief, session)
    if usual is None or usual.count < FEWEST_STEPS or step is None or belief.latest_friction is None:
        return False
    return step > max(JUMP * math.sqrt(usual.variance), LEAST_JUMP * abs(belief.latest_friction))


def _scaled(seen: Covariate | None, value: float | None, unit: float) -> float:
    """Return a covariate from its reference on, its mean where it was not measured."""
    if seen is None or unit == 0.0:
        return 0.0
    return ((seen.mean if value is None else value) - seen.reference) / unit


def change_in_a_day(before: float | None, now: float | None, apart: timedelta) -> float | None:
    """Return by how much it has grown warmer within a day, in units of :data:`KELVIN`; None if that is not known.

    Between two sessions the temperature is taken to go straight on.
    """
    return None if before is None or now is None else (now - before) / KELVIN * min(1.0, DAY / apart)


def _friction(seen: Covariate | None, value: float | None) -> float:
    return _scaled(seen, value, _friction_unit(seen))


def _friction_unit(seen: Covariate | None) -> float:
    return 0.0 if seen is None else FRICTION_SHARE * abs(seen.reference)


def _variance_unless_known(seen: Covariate | None, value: float | None, unit: float) -> float:
    return seen.variance / unit**2 if seen is not None and value is None and unit > 0.0 else 0.0


def _of_unknown(bank: Bank, unknown: tuple[float, ...]) -> FloatArray:
    """Return what covariates that were not measured add to the variance of a value, in units of σ²."""
    which = slice(N_COEFFICIENTS - len(unknown), N_COEFFICIENTS)
    own = np.diagonal(bank.covariance).T[which]
    return np.asarray(np.array(unknown) @ (bank.mean[which] ** 2 * (bank.shape / bank.rate) + own))


def _noise(belief: Belief, variance: float, session: Session) -> float:
    """Return the variance that a session has on top, of fewer measurements than usual or by their own word."""
    if variance <= 0.0:
        return 0.0
    of_few = 0.0
    repeated = belief.n_observations - belief.n_sessions
    if repeated > 0:
        within = belief.within_squares / repeated
        of_few = within * (1.0 / session.count - belief.n_sessions / belief.n_observations)
    return max(0.0, of_few, session.own_variance - variance) / variance


def _seen(covariate: Covariate | None, value: float | None) -> Covariate | None:
    if value is None:
        return covariate
    return Covariate(value, value, value, value, 0.0, 1) if covariate is None else covariate.with_value(value)
