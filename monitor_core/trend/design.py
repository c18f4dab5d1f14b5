"""Choose the limits of the charts for a wanted false-alarm rate.

The residuals that the charts are fed with have what the baseline does not know in them already: on a healthy axis they
are standard normal and independent (:mod:`monitor_core.trend.belief`), and the run lengths of the tables hold.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from enum import StrEnum

import scipy

from monitor_core.errors import OutsideValidityError
from monitor_core.trend.run_length import cusum_run_length, ewma_run_length, shewhart_run_length

#: Most sessions that a year is counted with: one a day.
SESSIONS_PER_YEAR = 365.0
#: Reference of the CUSUM: a quarter finds slow wear soonest.
CUSUM_REFERENCE = 0.25
#: EWMA weight: remembers about the last ten sessions.
EWMA_WEIGHT = 0.2
#: Two standard deviations of the EWMA: less is no hint, however many alerts are allowed.
LOWEST_EWMA_LIMIT = 2.0 * math.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT))
#: An alert lasts about so many sessions, until the average has forgotten what raised it.
ALERT_DURATION = 10.0
#: Share of the false alarms that the Shewhart rule would cause if it were alone.
SHEWHART_SHARE = 0.1
#: Share of the false alarms that are left to the weighing of all sessions together: so many are none of the other two.
EVIDENCE_SHARE = 0.1
#: The Shewhart rule waits for the next session to confirm.
SHEWHART_CONSECUTIVE = 2


class LossDirection(StrEnum):
    """Which way the trended quantity goes when preload is lost."""

    FALL = "fall"  #: preload in newtons, drag torque, natural frequency
    RISE = "rise"  #: the preload feature of Nguyen's Eq. (8)


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """What the owner of an axis decides.

    The false-alarm rate is the expected number in a year of a healthy axis. Measurements within
    :data:`monitor_core.trend.observation.SESSION` are one session, of which there is one a day at most. The baseline
    needs so many sessions and such a span; it goes on learning as long as nothing speaks against it. The rate of alerts
    is an upper estimate.
    """

    false_alarms_per_year: float = 1.0
    false_alerts_per_year: float = 4.0
    measurements_per_year: float = 365.0
    baseline_size: int = 20
    baseline_span: timedelta = timedelta(days=14)
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
    cusum_reference: float  # where the baseline is known for certain
    cusum_limit: float
    shewhart_limit: float
    ewma_limit: float
    evidence_limit: float  # of ln R, see :mod:`monitor_core.trend.lasting_loss`

    @property
    def sessions_per_year(self) -> float:
        """Sessions that the rates are counted over."""
        return min(self.settings.measurements_per_year, SESSIONS_PER_YEAR)

    @property
    def largest_increment(self) -> float:
        """Most that one session may add to the CUSUM: half its limit, so that no outlier alarms alone."""
        return 0.5 * self.cusum_limit

    @property
    def largest_residual(self) -> float:
        """Magnitude above which a residual counts as this much, in CUSUM and EWMA."""
        return self.cusum_reference + self.largest_increment


def design_detector(settings: DetectorSettings) -> DetectorDesign:
    """Solve the limits of CUSUM, Shewhart rule and EWMA, and that of all sessions together, from the wanted rates.

    Alarm: the CUSUM beyond its limit, or :data:`SHEWHART_CONSECUTIVE` residuals in a row beyond the Shewhart limit,
    which alone would cause :data:`SHEWHART_SHARE` of the rate; both together cause all of it but
    :data:`EVIDENCE_SHARE`. Or the evidence of :mod:`monitor_core.trend.lasting_loss` beyond as many sessions as lie
    between two false alarms: by itself it alarms no oftener than stated, and mostly where the others do.

    Alert: the EWMA beyond its limit on either side, because a rise of preload is no loss but tells that something has
    changed.

    ``OutsideValidityError`` if the wanted number of false alarms is so large that no limit gives it.
    """
    n_sessions = min(settings.measurements_per_year, SESSIONS_PER_YEAR)

    def shewhart_alarms(limit: float) -> float:
        return n_sessions / float(shewhart_run_length(limit, consecutive=SHEWHART_CONSECUTIVE))

    shewhart_limit = _solve(shewhart_alarms, SHEWHART_SHARE * settings.false_alarms_per_year)

    def all_alarms(limit: float) -> float:
        run_length = cusum_run_length(
            limit, reference=CUSUM_REFERENCE, largest_increment=0.5 * limit, confirmed_limit=shewhart_limit
        )
        return n_sessions / float(run_length)

    cusum_limit = _solve(all_alarms, (1.0 - EVIDENCE_SHARE) * settings.false_alarms_per_year)
    largest_residual = CUSUM_REFERENCE + 0.5 * cusum_limit

    def alerts(limit: float) -> float:
        run_length = ewma_run_length(limit, weight=EWMA_WEIGHT, largest_residual=largest_residual)
        return n_sessions / (float(run_length) + ALERT_DURATION)

    often_enough = alerts(LOWEST_EWMA_LIMIT) <= settings.false_alerts_per_year
    ewma_limit = LOWEST_EWMA_LIMIT if often_enough else _solve(alerts, settings.false_alerts_per_year)
    evidence_limit = math.log(n_sessions / settings.false_alarms_per_year)
    return DetectorDesign(settings, CUSUM_REFERENCE, cusum_limit, shewhart_limit, ewma_limit, evidence_limit)


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
    def excess(x: float) -> float:
        return math.log(max(expected_number(x), 1e-300) / wanted)

    return float(scipy.optimize.brentq(excess, lower, upper, xtol=1e-3))
