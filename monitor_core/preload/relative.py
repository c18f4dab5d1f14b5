r"""Watch 1/f² without a calibration: bring it to the mean conditions of the axis by a law that the axis itself shows.

Without a preload that is known, k3 is not, and there are no newtons; what is left of Eq. (8) of Nguyen et al. (2018)
at table positions x, payloads m and temperatures T,

.. math:: \frac{1}{f^2} = c + \theta_1 x + \theta_2 x^2 + \theta_3 m + \theta_4 T + s_j + e

is a mixed model: c follows the preload, :math:`s_j` is common to what is measured in session j (wear, mounting,
lubrication), e is new in every measurement. Where sessions visit several places, they tell θ by what differs *within*
each of them, so that wear does not pass for position; where each session has one place, they tell it by as much as
sessions agree. Both are one least squares with the variances of s and e estimated from the data (C. R. Henderson,
Biometrics 9 (1953) 226–252: fitting constants, iterated).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.preload.feature import UNKNOWN_TEMPERATURE_COEFFICIENT
from monitor_core.preload.prior import CONTRADICTION
from monitor_core.recording import Conditions
from monitor_core.uncertainty import Interval, IntervalKind

#: Rounds of estimating both variances at most; each leaves a small part of the change of the one before, and they end
#: where that is a thousandth.
_ROUNDS, _SETTLED = 30, 1e-3
#: Share of the part that depends on the preload in 1/f² where no drive model tells it (type B: from published axes).
UNSTATED_SHARE = Interval(0.05, 0.8, IntervalKind.COVERAGE)
#: Where the table stood at the fixed bearing itself, or nothing was carried, what a change is compared with [m], [kg].
_LEAST_POSITION, _LEAST_PAYLOAD = 0.05, 1.0
#: Temperature of an axis of which none is stated: never, and then it does not matter, or now and then [°C].
_ROOM = 20.0
_N = 4  # terms
#: Variance that the law of a drive model keeps in each direction, in units of what the term may change: of rounding.
_LEAST_WIDTH = 1e-10


def condition_terms(conditions: Conditions) -> FloatArray:
    """Return x [m], x² [m²], payload [kg] and temperature [°C], shape (4,).

    A payload that is not stated is none, a temperature that is not stated that of a room.
    """
    x, temperature = conditions.position, conditions.temperature
    return np.array([x, x**2, conditions.payload_mass or 0.0, _ROOM if temperature is None else temperature])


@dataclass(frozen=True, slots=True)
class SessionSums:
    """What a session says of the law: means and sums of products of the conditions' terms and 1/f², in this order."""

    count: int = 0
    mean: tuple[float, ...] = (0.0,) * (_N + 1)
    products: tuple[float, ...] = (0.0,) * (_N + 1) ** 2  # of deviations from the mean, row by row
    own_variance: float = 0.0  # mean of what the measurements state of 1/f² [s⁴]

    def with_measurement(self, inverse_square: float, variance: float, conditions: Conditions) -> "SessionSums":
        """Add a measurement: 1/f² [s²], its own variance [s⁴] (recursive mean and products after Welford)."""
        count = self.count + 1
        row, mean = np.append(condition_terms(conditions), inverse_square), np.array(self.mean)
        deviation = row - mean
        moved = mean + deviation / count
        products = np.array(self.products) + np.outer(deviation, row - moved).ravel()
        own = self.own_variance + (variance - self.own_variance) / count
        return SessionSums(count, tuple(moved.tolist()), tuple(products.tolist()), own)


@dataclass(frozen=True, slots=True)
class ConditionLaw:
    """How 1/f² follows position and payload: coefficients of :func:`condition_terms`, and what they are relative to."""

    coefficients: tuple[float, ...]  # [s²/m], [s²/m²], [s²/kg], [s²/K]
    covariance: tuple[float, ...]  # row by row, shape (4, 4)
    reference: tuple[float, ...]  # mean terms of the sessions that it was learnt from

    def shift(self, conditions: Conditions) -> float:
        """Return what 1/f² is above that at the reference, because of its conditions [s²]."""
        return float(np.array(self.coefficients) @ (condition_terms(conditions) - self.reference))

    def uncertainty(self, conditions: Conditions) -> float:
        """Return the standard uncertainty of :meth:`shift` [s²]."""
        apart = condition_terms(conditions) - self.reference
        return float(np.sqrt(max(apart @ np.reshape(self.covariance, (_N, _N)) @ apart, 0.0)))

    def uncertainty_between(self, conditions: Conditions, seen: Sequence[Conditions]) -> float:
        """Return what the law leaves open of a difference from the baseline, beyond what its scatter holds [s²].

        0 at the places and payloads that the baseline has seen: as
        :func:`monitor_core.preload.systematic_uncertainty_between` has it for a calibration.
        """
        of_baseline = max((self.uncertainty(each) for each in seen), default=0.0)
        return max(0.0, self.uncertainty(conditions) - of_baseline)

    def at_reference(self, sums: SessionSums) -> tuple[float, float]:
        """Return the mean of a session at the reference [s²], and the sum of squared deviations from it [s⁴]."""
        theta = np.array(self.coefficients)
        mean, products = np.array(sums.mean), np.reshape(sums.products, (_N + 1, _N + 1))
        against = np.append(-theta, 1.0)
        return float(mean[_N] - theta @ (mean[:_N] - self.reference)), float(against @ products @ against)


@dataclass(frozen=True, slots=True)
class DriveLaw:
    r"""What a drive model lets expect of :math:`1/f^2 = c + \theta_1 x + \theta_2 x^2` before anything is measured."""

    coefficients: tuple[float, ...]  # c [s²], θ₁ [s²/m], θ₂ [s²/m²], at a preload that nobody set
    covariance: tuple[float, ...]  # row by row, shape (3, 3)

    def given(self, level: float, x: float, x_squared: float) -> tuple[FloatArray, FloatArray] | None:
        """Return mean and covariance of θ₁ and θ₂ where 1/f² has a level at mean x and x²; None if that contradicts.

        Conditional normal distribution; what is less probable than :data:`CONTRADICTION` is another axis.
        """
        mean, covariance = np.array(self.coefficients), np.reshape(self.covariance, (3, 3))
        at = np.array([1.0, x, x_squared])
        variance, off = float(at @ covariance @ at), level - float(at @ mean)
        if off**2 > float(scipy.special.chdtri(1, CONTRADICTION)) * variance:
            return None
        gain = covariance @ at / variance
        return (mean + gain * off)[1:], (covariance - np.outer(gain, at @ covariance))[1:, 1:]


def learn_law(sessions: Sequence[SessionSums], drive: DriveLaw | None = None) -> ConditionLaw:
    """Fit how 1/f² follows position and payload to the sessions of an axis.

    What they do not tell is as unknown as physics leaves it (type B, standard uncertainties): 1/f² may change by all of
    itself over the way to the fixed bearing, or with twice the payload, and with temperature as
    :data:`~monitor_core.preload.feature.UNKNOWN_TEMPERATURE_COEFFICIENT` has it. A law of one place corrects nothing
    there, and says of other places that nothing is known. Where a drive model says it, and the axis has the level that
    the model lets expect, how 1/f² follows the position is as unknown as the model leaves it: the more the sessions
    tell, the less that counts.

    Parameters
    ----------
    sessions : sequence of SessionSums
        One at least.
    drive : DriveLaw, optional
        Of the drive model of the axis, for no payload: sessions under one do not use it.

    Returns
    -------
    ConditionLaw
        Relative to the mean terms of the sessions.
    """
    mean = np.array([session.mean for session in sessions])
    products = np.sum([np.reshape(session.products, (_N + 1, _N + 1)) for session in sessions], axis=0)
    count = np.array([session.count for session in sessions], dtype=np.float64)
    reference = mean[:, :_N].mean(axis=0)
    level = float(mean[:, _N].mean())
    x, payload = max(reference[0], _LEAST_POSITION), max(reference[2], _LEAST_PAYLOAD)
    usual = level * np.array([1.0 / x, 1.0 / x**2, 1.0 / payload, UNKNOWN_TEMPERATURE_COEFFICIENT])
    # in units of what each may change, so that nothing depends on a unit
    scale = usual / level
    expected, precision = np.zeros(_N), np.eye(_N)
    if drive is not None and not reference[2]:
        given = drive.given(level, float(reference[0]), float(reference[1]))
        if given is not None:
            expected[:2] = given[0] / usual[:2]
            precision[:2, :2] = np.linalg.inv(given[1] / np.outer(usual[:2], usual[:2]) + _LEAST_WIDTH * np.eye(2))
    terms, y = (mean[:, :_N] - reference) * scale, (mean[:, _N] - level) / level
    within, toward = products[:_N, :_N] * np.outer(scale, scale), products[:_N, _N] * scale / level
    squares = products[_N, _N] / level**2
    own = float(np.mean([session.own_variance for session in sessions])) / level**2
    n_within, n_between = float(np.sum(count - 1.0)), len(sessions) - 1.0

    error = max(own, np.finfo(np.float64).eps)
    between = max(float(np.var(y)), error)
    theta, covariance = expected, np.linalg.inv(precision)
    for _ in range(_ROUNDS):
        before = error + between
        weight = 1.0 / (between + error / count)
        centred = terms - weight @ terms / weight.sum()
        off = y - weight @ y / weight.sum()
        of_within, of_between = within / error, (centred * weight[:, np.newaxis]).T @ centred
        covariance = np.linalg.inv(precision + of_within + of_between)
        theta = covariance @ (precision @ expected + toward / error + (centred * weight[:, np.newaxis]).T @ off)
        dof = n_within - float(np.trace(covariance @ of_within))
        left = squares - 2.0 * theta @ toward + theta @ within @ theta
        error = max(left / dof, own, np.finfo(np.float64).eps) if dof > 0.5 else error
        dof = n_between - float(np.trace(covariance @ of_between))
        scatter = off - centred @ theta
        if dof > 0.5:
            between = max(float(scatter @ scatter) / dof - error * float(np.mean(1.0 / count)), 0.0)
        if abs(error + between - before) <= _SETTLED * before:
            break
    return ConditionLaw(
        tuple((theta * usual).tolist()),
        tuple((covariance * np.outer(usual, usual)).ravel().tolist()),
        tuple(reference.tolist()),
    )


def preload_lost(rise: float, share: float) -> float:
    r"""Return which share of the preload is lost where 1/f² has risen by a share of itself, if that is preload [-].

    .. math:: 1 - \frac{P}{P_0} = 1 - \left(1 + \frac{D}{s}\right)^{-3}, \qquad D = \frac{f_0^2}{f^2} - 1

    Eq. (8) of Nguyen et al. (2018) at one place: with s the share of :math:`k_3 / \sqrt[3]{P_0}` in :math:`1/f_0^2`. A
    rise of 1/f² that is negative is a preload that has grown; all of it has at :math:`D \le -s`.

    Examples
    --------
    A frequency that falls by 1 % where the paper's axis has s = 0.14 (Table 2 and 3, 100 N):

    >>> round(preload_lost(0.99**-2 - 1, 0.14), 2)
    0.33
    """
    left = 1.0 + rise / share
    return 1.0 - left**-3.0 if left > 0.0 else -np.inf


def preload_lost_interval(rise: Interval, share: Interval) -> Interval:
    """Return between which shares of the preload is lost, by the intervals of rise and share; 0 at least [-]."""
    lower, upper = preload_lost(rise.lower, share.upper), preload_lost(rise.upper, share.lower)
    return Interval(max(lower, 0.0), max(upper, 0.0), IntervalKind.COVERAGE, rise.level)
