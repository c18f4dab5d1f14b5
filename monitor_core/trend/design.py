"""Choose the limits of the charts for a wanted false-alarm rate, given that the baseline is an estimate."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import optimize, special

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.trend.run_length import cusum_run_length, ewma_run_length, shewhart_run_length

#: EWMA weight: remembers about the last ten measurements.
EWMA_WEIGHT = 0.2
#: Two standard deviations of the EWMA: less is no hint, however many alerts are allowed.
LOWEST_EWMA_LIMIT = 2.0 * math.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT))
#: An alert lasts about so many measurements, until the average has forgotten what raised it.
ALERT_DURATION = 10.0
#: Share of the false alarms that the Shewhart rule would cause if it were alone.
SHEWHART_SHARE = 0.1
#: The Shewhart rule waits for the next measurement to confirm.
SHEWHART_CONSECUTIVE = 2


class LossDirection(StrEnum):
    """Which way the trended quantity goes when preload is lost."""

    FALL = "fall"  #: preload in newtons, drag torque, natural frequency
    RISE = "rise"  #: the preload feature of Nguyen's Eq. (8)


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """What the owner of an axis decides.

    The false-alarm rate is the expected number in the first year on a learned baseline, with a new one learned after
    each false alarm; simulated healthy axes meet it to 3 %. In later years it is lower, since misjudged baselines have
    been replaced. Who leaves false alarms standing sees 1.2 times as many: a misjudged baseline stays. The rate of
    alerts is an upper estimate (3 to 4 for the default of 4); an alert teaches no new baseline.
    """

    false_alarms_per_year: float = 1.0
    false_alerts_per_year: float = 4.0
    measurements_per_year: float = 365.0
    baseline_size: int = 20
    loss: LossDirection = LossDirection.FALL

    def __post_init__(self) -> None:
        for name in ("false_alarms_per_year", "false_alerts_per_year", "measurements_per_year"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise OutsideValidityError(f"{name} must be positive and finite; got {getattr(self, name)}")
        if self.baseline_size < 3:
            raise OutsideValidityError(f"baseline_size must be at least 3; got {self.baseline_size}")


@dataclass(frozen=True, slots=True)
class DetectorDesign:
    """Limits that meet the settings. Solved once, used for every measurement."""

    settings: DetectorSettings
    cusum_reference: float
    cusum_limit: float
    shewhart_limit: float
    ewma_limit: float

    @property
    def largest_increment(self) -> float:
        """Most that one measurement may add to the CUSUM: half its limit, so that no outlier alarms alone."""
        return 0.5 * self.cusum_limit

    @property
    def largest_residual(self) -> float:
        """Magnitude above which a residual counts as this much, in CUSUM and EWMA."""
        return self.cusum_reference + self.largest_increment


@dataclass(frozen=True, slots=True, eq=False)
class BaselineErrors:
    """Quadrature over what an estimated baseline may get wrong: the residuals that a healthy axis then shows."""

    shift: FloatArray  # mean of the residual, shape (n_nodes,)
    scale: FloatArray  # standard deviation of the residual, shape (n_nodes,)
    weight: FloatArray  # sums to 1, shape (n_nodes,)


def baseline_errors(baseline_size: int, n_mean: int = 15, n_scatter: int = 15) -> BaselineErrors:
    r"""Return nodes and weights over the sampling distribution of the baseline's mean and scatter.

    The mean errs by :math:`\delta \sim N(0, 1/m)` and the scatter by the factor :math:`\sqrt{\chi^2_{m-1}/(m-1)}`,
    independently; the residual divided by :math:`s\sqrt{1+1/m}` is then normal with the shift and scale returned. Nodes
    are those of Gauss–Hermite: for the scatter by way of its normal score.
    """
    mean, mean_weight = special.roots_hermitenorm(n_mean)
    score, score_weight = special.roots_hermitenorm(n_scatter)
    half_dof = 0.5 * (baseline_size - 1)
    scatter = np.sqrt(special.gammaincinv(half_dof, special.ndtr(score)) / half_dof)
    divisor = scatter * math.sqrt(1.0 + 1.0 / baseline_size)
    shift = mean[:, None] / math.sqrt(baseline_size) / divisor[None, :]
    weight = np.outer(mean_weight / mean_weight.sum(), score_weight / score_weight.sum())
    return BaselineErrors(shift.ravel(), np.broadcast_to(1.0 / divisor, shift.shape).ravel(), weight.ravel())


def expected_false_alarms(run_length: FloatArray, weight: FloatArray, n_measurements: int) -> float:
    """Predict the number of false alarms in the first measurements that are watched.

    Each axis drew one of the baselines, and an alarm that proves false is cleared by learning a new one; between alarms
    the hazard is constant. The count is the flow through that cycle, learning not counted. (The rate of 1/ARL for ever
    on the same baseline would be dominated by a few misjudged baselines that alarm every other week, and no owner puts
    up with that.)

    Given are the average run length on each baseline and the probability of each, shape (n_nodes,), and the number of
    measurements on a learned baseline.

    Examples
    --------
    Four baselines in five never alarm, the fifth does at once. An axis goes on drawing until it has a good one:

    >>> round(expected_false_alarms(np.array([1e12, 1.0]), np.array([0.8, 0.2]), 100), 3)
    0.25
    """
    hazard = 1.0 / run_length
    watching = weight
    # a year may have a million measurements: they are passed block by block
    block = 1 << max(n_measurements.bit_length() // 2 - 1, 0)
    over_block = np.linalg.matrix_power(np.diag(1.0 - hazard) + np.outer(weight, hazard), block)
    alarms_of_block, total = _alarms_of(hazard, weight, block), 0.0
    for _ in range(n_measurements // block):
        total += float(alarms_of_block @ watching)
        watching = over_block @ watching
    return total + float(_alarms_of(hazard, weight, n_measurements % block) @ watching)


def _alarms_of(hazard: FloatArray, weight: FloatArray, n_measurements: int) -> FloatArray:
    """Return how many alarms an axis on each baseline has in the next measurements, shape (n_nodes,)."""
    alarms, total = hazard, np.zeros_like(hazard)
    for _ in range(n_measurements):
        total = total + alarms
        alarms = (1.0 - hazard) * alarms + float(weight @ alarms) * hazard
    return total


def cusum_reference(false_alarms_per_year: float, baseline_size: int) -> float:
    r"""Choose the reference value of the CUSUM, in standard deviations.

    .. math::

        k = \frac14 + \frac{\max(0, z_{1-a})}{\sqrt m}

    A quarter finds slow wear soonest. But a baseline of m measurements whose mean errs by more than k lets the sum
    drift into an alarm on a healthy axis: where alarms are to be rarer than a = one a year (a < ½), k also covers that
    error of the baseline, so that its remaining probability is about a.
    """
    z = -float(special.ndtri(min(false_alarms_per_year, 0.5)))
    return 0.25 + z / math.sqrt(baseline_size)


def design_detector(settings: DetectorSettings) -> DetectorDesign:
    """Solve the limits of CUSUM, Shewhart rule and EWMA from the wanted rates.

    Alarm: the CUSUM beyond its limit, or :data:`SHEWHART_CONSECUTIVE` residuals in a row beyond the Shewhart limit,
    which alone would cause :data:`SHEWHART_SHARE` of the rate. Alert: the EWMA beyond its limit on either side, because
    a rise of preload is no loss but tells that something has changed.

    ``OutsideValidityError`` if the wanted number of false alarms is so large that no limit gives it.
    """
    errors = baseline_errors(settings.baseline_size)
    shift, scale = errors.shift, errors.scale
    n_measurements = max(1, round(settings.measurements_per_year))
    reference = cusum_reference(settings.false_alarms_per_year, settings.baseline_size)

    def alarms(run_length: FloatArray) -> float:
        return expected_false_alarms(run_length, errors.weight, n_measurements)

    def shewhart_alarms(limit: float) -> float:
        return alarms(shewhart_run_length(limit, shift=shift, scale=scale, consecutive=SHEWHART_CONSECUTIVE))

    shewhart_limit = _solve(shewhart_alarms, SHEWHART_SHARE * settings.false_alarms_per_year)

    def all_alarms(limit: float) -> float:
        run_length = cusum_run_length(
            limit,
            reference=reference,
            shift=shift,
            scale=scale,
            largest_increment=0.5 * limit,
            confirmed_limit=shewhart_limit,
        )
        return alarms(run_length)

    cusum_limit = _solve(all_alarms, settings.false_alarms_per_year)
    largest_residual = reference + 0.5 * cusum_limit

    def alerts(limit: float) -> float:
        run_length = ewma_run_length(
            limit, weight=EWMA_WEIGHT, shift=shift, scale=scale, largest_residual=largest_residual
        )
        return float(errors.weight @ (n_measurements / (run_length + ALERT_DURATION)))

    often_enough = alerts(LOWEST_EWMA_LIMIT) <= settings.false_alerts_per_year
    ewma_limit = LOWEST_EWMA_LIMIT if often_enough else _solve(alerts, settings.false_alerts_per_year)
    return DetectorDesign(settings, reference, cusum_limit, shewhart_limit, ewma_limit)


def _solve(expected_number: Callable[[float], float], wanted: float) -> float:
    """Find the limit at which a falling expectation meets the wanted number."""
    lower, upper = 0.5, 1.0
    while expected_number(lower) < wanted:
        lower *= 0.5
        if lower < 1e-3:
            raise OutsideValidityError(f"no limit gives as many as {wanted:g} false alarms in a year; ask for fewer")
    while expected_number(upper) > wanted:
        lower, upper = upper, 1.5 * upper
    # the logarithm is nearly straight in the limit; an expectation of exactly 0 lies far below every wanted number
    return float(optimize.brentq(lambda x: math.log(max(expected_number(x), 1e-300) / wanted), lower, upper, xtol=1e-3))
