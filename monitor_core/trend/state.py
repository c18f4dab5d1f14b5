"""Define what the detector remembers of an axis and reports of it: its state, its evidence, its charts."""

import math
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from enum import StrEnum

from monitor_core.trend.baseline import Baseline, baseline_of
from monitor_core.trend.belief import Belief, Prediction, Prior
from monitor_core.trend.charts import SESSIONS_PER_YEAR, DetectorDesign
from monitor_core.trend.lasting_loss import Beginnings, LastingLoss
from monitor_core.trend.observation import Session
from monitor_core.uncertainty import Estimate


class TrendStatus(StrEnum):
    """State of an axis. *Not looked at* is not *healthy*."""

    UNKNOWN = "unknown"  #: nothing accepted yet, or nothing recently
    LEARNING = "learning"  #: the baseline is being collected; only a loss that goes on all the while is noticed
    NORMAL = "normal"
    ALERT = "alert"  #: early warning: something changed, up or down
    ALARM = "alarm"  #: preload is being lost, at the stated false-alarm rate


class Chart(StrEnum):
    """Which chart gave the evidence."""

    CUSUM = "cusum"
    SHEWHART = "shewhart"
    SHIRYAEV_ROBERTS = "shiryaev-roberts"
    EWMA = "ewma"
    TREND = "trend"  #: of the sessions that the baseline was to be learnt from


@dataclass(frozen=True, slots=True)
class Run:
    """Sessions in a row that speak for a change: when they began, and what they sum up to."""

    since: datetime
    count: int
    total: float  # sum of the differences from what was expected, in the unit of the observations

    def mean_change(self, baseline: Baseline) -> Estimate:
        """Return the mean difference from what was expected, its standard uncertainty from the scatter of both."""
        uncertainty = math.hypot(baseline.scatter_of_mean(self.count), baseline.standard_uncertainty)
        return Estimate(self.total / self.count, uncertainty, baseline.degrees_of_freedom)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Why the axis went into alert or alarm: as it was when that happened."""

    chart: Chart
    raised_at: datetime
    value: float  # of the chart: standard deviations, positive towards loss, or the logarithm of the evidence
    limit: float
    onset: datetime  # estimated begin of the change
    # mean difference from what was expected since the onset, in the unit of the observations; of a trend, which has no
    # baseline to differ from, all of what it changed by since the onset, and the level that it had there
    change: Estimate
    level: float | None = None


@dataclass(frozen=True, slots=True)
class Charts:
    """The charts after a session. Values and residuals are in standard deviations, positive towards loss."""

    residual: float = 0.0
    reference: float = 0.0  # of the CUSUM at this session: a quarter, and what the baseline may be wrong by
    cusum: float = 0.0
    ewma: float = 0.0
    cusum_run: Run | None = None  # since the CUSUM left zero
    shewhart_run: Run | None = None  # residuals in a row beyond the Shewhart limit
    ewma_run: Run | None = None  # since the EWMA changed its sign
    lasting: LastingLoss | None = None  # what all sessions together say; None while an alarm stands
    alarm: Evidence | None = None
    alert: Evidence | None = None
    quiet_alarm: int = 0  # sessions in a row with the alarm's charts under the release level
    quiet_alert: int = 0


class Foreseen:
    """What comes of a session if it ends as it is: how it was expected by ``known``, and what it says of a loss."""

    __slots__ = ("beginnings", "design", "lasting", "prediction", "teaches")

    def __init__(
        self,
        prediction: Prediction,
        beginnings: Beginnings,
        lasting: LastingLoss | None,
        design: DetectorDesign,
        *,
        teaches: bool,
    ) -> None:
        """Keep what was found, and the limits at the pace of the axis."""
        self.prediction, self.beginnings, self.lasting = prediction, beginnings, lasting
        self.design, self.teaches = design, teaches


@dataclass(frozen=True, slots=True)
class DetectorState:
    """Everything the detector remembers. A caller stores it between measurements, but ``foreseen``.

    A session is judged from its first measurement on and learnt when it is over: ``before`` are the charts before it,
    ``charts`` with what it has so far. How often sessions come is counted from the first on, whatever becomes of them;
    silence counts for a month at most.
    ``learnt`` is what is believed of the healthy axis; ``known`` has learnt the
    sessions, too, that something speaks against, and takes its place when nothing does any more. ``beginnings`` are
    what the sessions that are over say of a loss that lasts.
    """

    status: TrendStatus = TrendStatus.UNKNOWN
    since: datetime | None = None  # when the status was entered
    last_at: datetime | None = None  # latest observation
    first_at: datetime | None = None  # start of the first session, later by long silences, and ...
    n_sessions: int = 0  # ... how many began since
    session: Session | None = None  # that is going on
    learning: tuple[Session, ...] = ()  # the baseline as far as it is collected
    prior: Prior | None = None  # what sisters lend
    contradicted: bool = False  # by the axis' own first sessions: nothing lent is used
    covered: bool = False  # by temperature or friction, which went with it: a fall while the baseline was learnt
    learnt: Belief | None = None
    known: Belief | None = None
    beginnings: Beginnings = field(default_factory=Beginnings)
    before: Charts = Charts()
    charts: Charts = Charts()
    # of the session that is going on, so that it is told once; None: not told yet
    foreseen: Foreseen | None = field(default=None, compare=False, repr=False)

    @property
    def baseline(self) -> Baseline | None:
        """What is learnt, for people; until then, None, only a trend raises an alarm."""
        return None if self.learnt is None or self.known is None else baseline_of(self.learnt)

    @property
    def prior_in_use(self) -> Prior | None:
        """What sisters lend, unless the axis' own first sessions contradict it."""
        return None if self.contradicted else self.prior

    def of(self, design: DetectorDesign) -> DetectorDesign:
        """Return the limits at the pace at which the sessions of this axis come, once its baseline shows one."""
        if self.first_at is None or self.known is None or self.last_at is None:
            return design
        now = self.last_at if self.session is None else self.session.started_at
        span = (now - self.first_at) / timedelta(days=SESSIONS_PER_YEAR)
        return design.at_pace((self.n_sessions - 1) / span) if span > 0.0 else design

    @property
    def alarm(self) -> Evidence | None:
        """Evidence of the alarm that stands."""
        return self.charts.alarm

    @property
    def alert(self) -> Evidence | None:
        """Evidence of the alert that stands."""
        return self.charts.alert

    @property
    def cusum(self) -> float:
        """Sum of what exceeds chance, in standard deviations."""
        return self.charts.cusum


def state_at(state: DetectorState, at: datetime, maximum_age: timedelta) -> TrendStatus:
    """Tell what is known at some time: silence makes a state unknown, but does not end an alarm.

    Silence is a latest accepted measurement older than ``maximum_age``, or none.
    """
    if state.last_at is None:
        return TrendStatus.UNKNOWN
    if at - state.last_at > maximum_age and state.status is not TrendStatus.ALARM:
        return TrendStatus.UNKNOWN
    return state.status
