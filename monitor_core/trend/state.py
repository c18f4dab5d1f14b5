"""Records of the detector: what it remembers of an axis, and what it reports."""

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from monitor_core.trend.baseline import Baseline, Observation
from monitor_core.uncertainty import Estimate


class TrendStatus(StrEnum):
    """State of an axis. *Not looked at* is not *healthy*."""

    UNKNOWN = "unknown"  #: nothing accepted yet, or nothing recently
    LEARNING = "learning"  #: the baseline is being collected; no loss can be noticed
    NORMAL = "normal"
    ALERT = "alert"  #: early warning: something changed, up or down
    ALARM = "alarm"  #: preload is being lost, at the stated false-alarm rate


class Chart(StrEnum):
    """Which chart gave the evidence."""

    CUSUM = "cusum"
    SHEWHART = "shewhart"
    EWMA = "ewma"


@dataclass(frozen=True, slots=True)
class Run:
    """Measurements in a row that speak for a change: when they began, and what they sum up to."""

    since: datetime
    count: int
    total: float  # sum of the differences from the baseline's mean, in the unit of the observations

    def mean_change(self, baseline: Baseline) -> Estimate:
        """Return the mean difference from the baseline, its standard uncertainty from the scatter of both."""
        uncertainty = baseline.scatter * math.sqrt(1.0 / self.count + 1.0 / baseline.size)
        return Estimate(self.total / self.count, uncertainty, baseline.degrees_of_freedom)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Why the axis went into alert or alarm: as it was when that happened."""

    chart: Chart
    raised_at: datetime
    value: float  # of the chart, in standard deviations, positive towards loss
    limit: float
    onset: datetime  # estimated begin of the change
    change: Estimate  # mean difference from the baseline since the onset, in the unit of the observations


@dataclass(frozen=True, slots=True)
class DetectorState:
    """Everything the detector remembers. Plain values only: a caller stores it between measurements.

    Chart values and residuals are in standard deviations, positive towards loss.
    """

    status: TrendStatus = TrendStatus.UNKNOWN
    since: datetime | None = None  # when the status was entered
    last_at: datetime | None = None  # latest observation
    learning: tuple[Observation, ...] = ()  # the baseline as far as it is collected
    baseline: Baseline | None = None
    residual: float = 0.0
    cusum: float = 0.0
    ewma: float = 0.0
    cusum_run: Run | None = None  # since the CUSUM left zero
    shewhart_run: Run | None = None  # residuals in a row beyond the Shewhart limit
    ewma_run: Run | None = None  # since the EWMA changed its sign
    alarm: Evidence | None = None
    alert: Evidence | None = None
    quiet_alarm: int = 0  # measurements in a row with the alarm's charts under the release level
    quiet_alert: int = 0


def state_at(state: DetectorState, at: datetime, maximum_age: timedelta) -> TrendStatus:
    """Tell what is known at some time: silence makes a state unknown, but does not end an alarm.

    Silence is a latest accepted measurement older than ``maximum_age``, or none.
    """
    if state.last_at is None:
        return TrendStatus.UNKNOWN
    if at - state.last_at > maximum_age and state.status is not TrendStatus.ALARM:
        return TrendStatus.UNKNOWN
    return state.status
