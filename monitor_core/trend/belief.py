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
#: Level, season (two), change of the temperature in a day, temperature, friction torque; the autoregression is the last
#: member of the state. The change stands for a structure that lags behind its thermometer.
N_COEFFICIENTS = 6
_SIZE = N_COEFFICIENTS + 1
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


@dataclass(frozen=True, slots=True)
class Belief:
    """What was learnt of a healthy axis."""

    started_at: datetime
    last_at: datetime  # start of the last session, learnt or not
    ended_at: datetime  # end of the last session that was learnt
    zero: float  # values are counted from here, in their unit
    numbers: tuple[float, ...]  # of :class:`_Bank`, one structure after another
    n_sessions: int = 0
    n_observations: int = 0
    within_squares: float = 0.0  # of the observations about the mean of their session
    temperature: Covariate | None = None
    friction_torque: Covariate | None = None
    change: Covariate | None = None  # of the temperature in a day, in units of KELVIN
    friction_step: Covariate | None = None  # of the friction torque, from one session to the next [N·m]
    latest_temperature: float | None = None  # of the last session, learnt or not; None if it was not stated
    latest_friction: float | None = None  # the same of the friction torque
    lubricated_at: datetime | None = None  # the last session that looked so


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Posterior of all structures; variances in units of σ². Shapes (n_structures, …)."""

    mean: FloatArray  # (…, size)
    covariance: FloatArray  # (…, size, size)
    shape: FloatArray  # a of the inverse gamma of σ²
    rate: FloatArray  # its b
    log_weight: FloatArray

    @property
    def weight(self) -> FloatArray:
        """Probability of each structure."""
        relative = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(relative / relative.sum())

    @property
    def variance(self) -> float:
        """Scatter σ² as it is believed now."""
        return float(self.weight @ (self.rate / self.shape))

    def numbers(self) -> tuple[float, ...]:
        """Return all numbers in a row."""
        upper = self.covariance[:, _UPPER[0], _UPPER[1]]
        columns = [self.mean, upper, self.shape[:, None], self.rate[:, None], self.log_weight[:, None]]
        return tuple(np.hstack(columns).ravel().tolist())


def _bank_of(numbers: Sequence[float]) -> Bank:
    rows = np.array(numbers, dtype=np.float64).reshape(len(STRUCTURES), -1)
    covariance = np.empty((len(STRUCTURES), _SIZE, _SIZE))
    upper = rows[:, _SIZE:-3]
    covariance[:, _UPPER[0], _UPPER[1]] = upper
    covariance[:, _UPPER[1], _UPPER[0]] = upper
    return Bank(rows[:, :_SIZE], covariance, rows[:, -3], rows[:, -2], rows[:, -1])


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a healthy axis will show in a session, by structure, and what follows from it for the belief."""

    bank: Bank  # at the time of the session
    design: FloatArray  # row of the session, (size,)
    cross: FloatArray  # covariance times design, (n_structures, size)
    spread: FloatArray  # variance of the value in units of σ², (n_structures,)
    noise: float  # variance that this session has on top, in units of σ²
    centre: FloatArray  # (n_structures,), from the zero of the belief
    zero: float
    decay: FloatArray  # of the autoregression since the session before, (n_structures,)
    lubricated: bool  # so it looks: the level is open to it

    @property
    def scale(self) -> FloatArray:
        """Scale of Student's t by structure."""
        return np.asarray(np.sqrt(self.bank.rate / self.bank.shape * self.spread))

    @property
    def value(self) -> float:
        """Expected value."""
        return self.zero + float(self.bank.weight @ self.centre)

    @property
    def unlearnt(self) -> float:
        """Share of the variance of the prediction that is due to the coefficients, not to the scatter of sessions."""
        own = self.bank.covariance[:, :-1, :-1] @ self.design[:-1] @ self.design[:-1]
        return float(self.bank.weight @ np.clip(own / self.spread, 0.0, 1.0))

    def error(self, value: float) -> FloatArray:
        """Return by how much a value is off, by structure."""
        return np.asarray(value - self.zero - self.centre)

    @property
    def gain(self) -> FloatArray:
        """What a unit error teaches of the state, (n_structures, size)."""
        return np.asarray(self.cross / self.spread[:, None])

    @property
    def gain_of_dependence(self) -> FloatArray:
        """The same where only the autoregression is followed."""
        gain = np.zeros_like(self.cross)
        gain[:, -1] = self.cross[:, -1] / self.spread
        return gain

    def log_weight(self, error: FloatArray) -> FloatArray:
        """Return the logarithm of the weight of each structure once a session was off by so much."""
        degrees = 2.0 * self.bank.shape
        evidence = (
            scipy.special.gammaln(0.5 * (degrees + 1.0)) - scipy.special.gammaln(0.5 * degrees)
            - 0.5 * np.log(degrees * math.pi)
            - np.log(self.scale) - 0.5 * (degrees + 1.0) * np.log1p((error / self.scale) ** 2 / degrees)
        )  # fmt: skip
        relative = self.bank.log_weight + evidence
        return np.asarray(relative - np.logaddexp.reduce(relative))

    def residual(self, value: float) -> float:
        r"""Return the residual of a value as its normal score, :math:`z = \Phi^{-1}(F(y))`."""
        ratio = self.error(value) / self.scale
        degrees, weight = 2.0 * self.bank.shape, self.bank.weight
        below = float(weight @ scipy.special.stdtr(degrees, ratio))
        above = float(weight @ scipy.special.stdtr(degrees, -ratio))
        # the smaller of both has all its digits
        score = scipy.special.ndtri(max(min(below, above), 1e-300))
        return float(score if below < above else -score)


def begin(first: Session, prior: Prior, variance: float) -> Belief:
    """Return the belief before anything is learnt of an axis whose first session is given, with a rough variance."""
    count = len(STRUCTURES)
    mean = np.zeros((count, _SIZE))
    mean[:, 1:N_COEFFICIENTS] = prior.coefficients
    covariance = np.zeros((count, _SIZE, _SIZE))
    covariance[:, range(_SIZE), range(_SIZE)] = [_OPEN**2, *(d**2 for d in prior.deviations), 0.0]
    covariance[:, -1, -1] = _SHARE
    shape = np.full(count, 0.5 * prior.degrees_of_freedom)
    rate = shape * (variance if prior.variance is None else prior.variance)
    bank = Bank(mean, covariance, shape, rate, np.log(prior.weights))
    return Belief(first.started_at, first.started_at, first.last_at, first.value, bank.numbers())


def reopened(belief: Belief) -> Belief:
    """Forget the level, and keep what was learnt of scatter, dependence, season and covariates."""
    bank = _bank_of(belief.numbers)
    bank.covariance[:, 0, 0] += _OPEN**2
    return with_bank(belief, bank)


def predict(belief: Belief, session: Session) -> Prediction:
    """Predict a session that is later than all that was learnt."""
    bank = _bank_of(belief.numbers)
    decay = _CORRELATION ** ((session.started_at - belief.last_at) / DAY)
    bank.mean[:, -1] *= decay
    bank.covariance[:, -1, :] *= decay[:, None]
    bank.covariance[:, :, -1] *= decay[:, None]
    bank.covariance[:, -1, -1] += _SHARE * (1.0 - decay**2)
    lubricated = _looks_lubricated(belief, session)
    if lubricated:
        bank.covariance[:, 0, 0] += LUBRICATION**2

    design, unknown = _design(belief, session)
    cross = bank.covariance @ design
    noise = _noise(belief, bank, session)
    spread = cross @ design + 1.0 - _SHARE + noise + _of_unknown(bank, unknown)
    return Prediction(bank, design, cross, spread, noise, bank.mean @ design, belief.zero, decay, lubricated)


def learn(belief: Belief, prediction: Prediction, session: Session) -> Belief:
    """Learn a session, of which no more than :data:`LARGEST_LESSON` standard deviations are believed."""
    bank, scale, gain, lubricated = prediction.bank, prediction.scale, prediction.gain, prediction.lubricated
    error = prediction.error(session.value)
    believed = np.clip(error, -LARGEST_LESSON * scale, LARGEST_LESSON * scale)
    learnt = Bank(
        bank.mean + gain * believed[:, None],
        bank.covariance - gain[:, :, None] * prediction.cross[:, None, :],
        bank.shape + 0.5,
        bank.rate + 0.5 * believed**2 / prediction.spread,
        prediction.log_weight(error),
    )
    return replace(
        belief,
        last_at=session.started_at,
        ended_at=session.last_at,
        numbers=learnt.numbers(),
        n_sessions=belief.n_sessions + 1,
        n_observations=belief.n_observations + session.count,
        within_squares=belief.within_squares + session.squares,
        temperature=_seen(belief.temperature, session.temperature),
        friction_torque=_seen(belief.friction_torque, session.friction_torque),
        change=_seen(belief.change, _change(belief, session)),
        friction_step=belief.friction_step if lubricated else _seen(belief.friction_step, _step(belief, session)),
        latest_temperature=session.temperature,
        latest_friction=session.friction_torque,
        lubricated_at=session.started_at if lubricated else belief.lubricated_at,
    )


def pass_over(belief: Belief, prediction: Prediction, session: Session) -> Belief:
    """Follow the autoregression over a session that something speaks against, and learn nothing else of it.

    The filter of Schmidt, which considers the uncertainty of the coefficients and does not update them.
    """
    bank, scale = prediction.bank, prediction.scale
    error = prediction.error(session.value)
    error = np.clip(error, -LARGEST_LESSON * scale, LARGEST_LESSON * scale)
    gain = prediction.gain_of_dependence
    both = gain[:, :, None] * prediction.cross[:, None, :]
    square = gain[:, :, None] * gain[:, None, :] * prediction.spread[:, None, None]
    followed = replace(
        bank,
        mean=bank.mean + gain * error[:, None],
        covariance=bank.covariance - both - both.transpose(0, 2, 1) + square,
    )
    return replace(
        belief,
        last_at=session.started_at,
        numbers=followed.numbers(),
        latest_temperature=session.temperature,
        latest_friction=session.friction_torque,
        lubricated_at=session.started_at if prediction.lubricated else belief.lubricated_at,
    )


def learnt_from(sessions: Sequence[Session], start: Belief) -> Belief:
    """Learn sessions one after another."""
    belief = start
    for session in sessions:
        belief = learn(belief, predict(belief, session), session)
    return belief


def bank_of(belief: Belief) -> Bank:
    """Return the posterior of all structures."""
    return _bank_of(belief.numbers)


def with_bank(belief: Belief, bank: Bank) -> Belief:
    """Return a belief with another posterior of its structures."""
    return replace(belief, numbers=bank.numbers())


def healthy_value(belief: Belief, at: datetime) -> tuple[float, float]:
    """Return what is normal at some time under the mean conditions, and its standard uncertainty."""
    bank = _bank_of(belief.numbers)
    row = _season(belief, at)
    for i, covariate in enumerate((_scaled(belief.temperature, None, KELVIN), _friction(belief.friction_torque, None))):
        row[N_COEFFICIENTS - 2 + i] = covariate
    row = row[:-1]
    centre = bank.mean[:, :-1] @ row
    own = bank.rate / bank.shape * (bank.covariance[:, :-1, :-1] @ row @ row)
    mean = float(bank.weight @ centre)
    return belief.zero + mean, math.sqrt(max(float(bank.weight @ (own + (centre - mean) ** 2)), 0.0))


def _season(belief: Belief, at: datetime) -> FloatArray:
    angle = 2.0 * math.pi * ((at - belief.started_at) / YEAR)
    return np.array([1.0, 1.0 - math.cos(angle), math.sin(angle), 0.0, 0.0, 0.0, 1.0])


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


def _looks_lubricated(belief: Belief, session: Session) -> bool:
    """Tell whether the friction torque has risen at once, as it does with fresh grease and not with a loss."""
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
    added = np.zeros(len(STRUCTURES))
    for i, variance in enumerate(unknown, start=N_COEFFICIENTS - len(unknown)):
        if variance > 0.0:
            added += variance * (bank.mean[:, i] ** 2 / (bank.rate / bank.shape) + bank.covariance[:, i, i])
    return added


def _noise(belief: Belief, bank: Bank, session: Session) -> float:
    """Return the variance that a session has on top, of fewer measurements than usual or by their own word."""
    variance = bank.variance
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
