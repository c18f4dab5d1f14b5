"""What the history of an axis says: what is normal, where the trend goes, how often it alarms falsely.

These records are what the pages show and what the API sends.
"""

from datetime import datetime
from typing import Literal

import scipy
from pydantic import BaseModel, ConfigDict

from monitor_core.preload import Calibration, preload_from_feature
from monitor_core.trend import FEWEST_SESSIONS, DetectorState, FoundRate, TrendLine


class _View(BaseModel):
    model_config = ConfigDict(frozen=True)


class LentBySisters(_View):
    """What axes of the same type have lent."""

    n_sisters: int
    weight_in_scatter: float  # of what is known of the scatter [-]
    contradicted: bool  # by the axis' own first sessions: nothing that they lent is used


class BaselineView(_View):
    """What is normal: mean, and the 95 % prediction interval of one more healthy session."""

    preload_n: float
    prediction_interval_95_n: tuple[float, float]
    size: int  # sessions
    n_measurements: int
    autocorrelation: float
    started_at: datetime
    ended_at: datetime
    not_seen: tuple[str, ...]
    looks_lubricated_at: datetime | None  # it was said, or friction rose at once: the level was open
    sisters: LentBySisters


class AlertView(_View):
    """An alert that stands: how far the preload is off, and what to do."""

    raised_at: datetime
    since: datetime
    direction: Literal["rise", "fall"]
    mean_change_n: float
    n_sessions: int
    sentence: str


class LineView(_View):
    """The line through the trend in newtons a year, at the preload where it ends; losses are negative."""

    preload_at_end_n: float
    slope_n_per_year: float
    interval_95_n_per_year: tuple[float, float]
    interval_kind: Literal["confidence"]
    started_at: datetime
    ended_at: datetime
    n_sessions: int


class FalseAlarmsView(_View):
    """False alarms a year: as stated, and as the history of the axis says; null where it is too short to say."""

    stated_per_year: float
    n_sessions: int
    found_per_year: float | None
    interval_95_per_year: tuple[float, float] | None
    interval_kind: Literal["confidence"] = "confidence"
    sentence: str


#: What a baseline has not seen that was learnt while the preload fell, as temperature or friction may do.
_COVERED = "a preload that stays: it fell while it was learnt, and temperature or friction changed with it"


def baseline_view(state: DetectorState, calibration: Calibration) -> BaselineView | None:
    """Say what is normal; None while it is learnt."""
    baseline, prior = state.baseline, state.prior
    if baseline is None:
        return None
    interval = baseline.prediction_interval()
    # the feature falls as the preload rises, so its upper end is the lower preload
    lower, upper = (preload_from_feature(end, calibration.coefficients) for end in (interval.upper, interval.lower))
    used = state.prior_in_use
    weight = min(used.degrees_of_freedom / baseline.degrees_of_freedom, 1.0) if used is not None else 0.0
    n_sisters = 0 if prior is None else prior.n_sisters
    lent = LentBySisters(n_sisters=n_sisters, weight_in_scatter=weight, contradicted=state.contradicted)
    return BaselineView(
        preload_n=preload_from_feature(baseline.mean, calibration.coefficients),
        prediction_interval_95_n=(lower, upper),
        size=baseline.size,
        n_measurements=baseline.n_observations,
        autocorrelation=baseline.autocorrelation,
        started_at=baseline.started_at,
        ended_at=baseline.ended_at,
        not_seen=(*baseline.not_seen, *([_COVERED] if state.covered else [])),
        looks_lubricated_at=baseline.lubricated_at,
        sisters=lent,
    )


#: What to do about an alert that stands, by where the preload has gone.
_ALERT = {
    "rise": (
        "since {since:%Y-%m-%d} the preload is on average {change:.0f} N above what was learnt as healthy, over "
        "{count} sessions. That is no loss, but nothing tightens by itself: are payload, temperature and position as "
        "stated, was the machine worked on? A small rise is learnt after {settled} sessions; a larger one, once it is "
        "explained, by activating a new calibration"
    ),
    "fall": (
        "since {since:%Y-%m-%d} the preload is on average {change:.0f} N below what was learnt as healthy, over "
        "{count} sessions, which is not enough for an alarm: measure again, at another position too"
    ),
}


def alert_view(state: DetectorState, calibration: Calibration, settled: int) -> AlertView | None:
    """Return the alert that stands; a rise settles in so many sessions."""
    run, baseline = state.charts.ewma_run, state.baseline
    if state.alert is None or state.alarm is not None or run is None or baseline is None:
        return None
    change = preload_from_feature(baseline.mean + run.total / run.count, calibration.coefficients)
    change -= preload_from_feature(baseline.mean, calibration.coefficients)
    direction: Literal["rise", "fall"] = "fall" if state.charts.ewma > 0.0 else "rise"
    words = _ALERT[direction].format(since=run.since, change=abs(change), count=run.count, settled=settled)
    return AlertView(
        raised_at=state.alert.raised_at,
        since=run.since,
        direction=direction,
        mean_change_n=change,
        n_sessions=run.count,
        sentence=words,
    )


def line_view(line: TrendLine, calibration: Calibration) -> LineView:
    """Return the line through the trend in newtons a year, with the confidence interval of its slope."""
    preload = preload_from_feature(line.at_end.value, calibration.coefficients)
    per_feature = -3.0 * preload / line.at_end.value  # preload = (g/k3)^-3
    reach = float(scipy.special.stdtrit(line.slope.degrees_of_freedom, 0.975)) * line.slope.standard_uncertainty
    lower, upper = sorted(per_feature * (line.slope.value + side * reach) for side in (-1.0, 1.0))
    return LineView(
        preload_at_end_n=preload,
        slope_n_per_year=per_feature * line.slope.value,
        interval_95_n_per_year=(lower, upper),
        interval_kind="confidence",
        started_at=line.started_at,
        ended_at=line.ended_at,
        n_sessions=line.n_sessions,
    )


def false_alarms_view(stated: float, rate: FoundRate | None, n_sessions: int) -> FalseAlarmsView:
    """Compare the stated rate of false alarms a year with what the history of an axis says, if it is long enough."""
    if rate is None:
        return FalseAlarmsView(
            stated_per_year=stated,
            n_sessions=n_sessions,
            found_per_year=None,
            interval_95_per_year=None,
            sentence=(
                f"stated {stated:g} a year; the history of this axis says nothing yet: {FEWEST_SESSIONS} sessions are "
                f"needed, got {n_sessions}"
            ),
        )
    lower, upper = rate.interval.lower, rate.interval.upper
    return FalseAlarmsView(
        stated_per_year=stated,
        n_sessions=n_sessions,
        found_per_year=rate.rate,
        interval_95_per_year=(lower, upper),
        interval_kind="confidence",
        sentence=(
            f"stated {stated:g} a year; the last {n_sessions} sessions of this axis, in blocks of a fortnight, say "
            f"{rate.rate:.1f} ({lower:.1f} to {upper:.1f})"
        ),
    )
