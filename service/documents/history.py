"""What the history of an axis says: what is normal, where the trend goes, how often it alarms falsely.

These records are what the pages show and what the API sends.
"""

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

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

    preload_n: float | None  # null without a calibration, as all that is in newtons
    prediction_interval_95_n: tuple[float, float] | None
    size: int  # sessions
    n_measurements: int
    autocorrelation: float
    started_at: datetime
    ended_at: datetime
    not_seen: tuple[str, ...]
    looks_lubricated_at: datetime | None  # it was said, or friction rose at once: the level was open
    sisters: LentBySisters
    prediction_interval_95_percent: tuple[float, float] | None = None  # of the frequency, of it; without a calibration


class AlertView(_View):
    """An alert that stands: how far the preload is off, and what to do."""

    raised_at: datetime
    since: datetime
    direction: Literal["rise", "fall"]
    mean_change_n: float | None
    n_sessions: int
    sentence: str
    mean_change_percent: float | None = None  # of the frequency; without a calibration


class LineView(_View):
    """The line through the trend since its last change, in newtons a year; losses are negative.

    Without a calibration it is in percent of the frequency.
    """

    preload_at_end_n: float | None
    slope_n_per_year: float | None
    interval_95_n_per_year: tuple[float, float] | None
    interval_kind: Literal["confidence"]
    started_at: datetime
    ended_at: datetime
    n_sessions: int
    slope_percent_per_year: float | None = None
    interval_95_percent_per_year: tuple[float, float] | None = None
    changed_at: datetime | None = Field(
        default=None, description="first session after the last change of level or slope; null: none is evident"
    )

    @property
    def change_a_day(self) -> tuple[float, float] | None:
        """Present change of the preload a day with half of its 95 % interval [N]; None without a calibration."""
        if self.slope_n_per_year is None or self.interval_95_n_per_year is None:
            return None
        lower, upper = self.interval_95_n_per_year
        return self.slope_n_per_year / _DAYS_A_YEAR, 0.5 * (upper - lower) / _DAYS_A_YEAR


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


def baseline_view(state: DetectorState, calibration: Calibration | None) -> BaselineView | None:
    """Say what is normal; None while it is learnt."""
    baseline, prior = state.baseline, state.prior
    if baseline is None:
        return None
    interval = baseline.prediction_interval()
    # the feature falls as preload and frequency rise, so its upper end is the lower of them
    ends = (interval.upper, interval.lower)
    if calibration is None:
        lower, upper = (_percent_of_frequency(end / baseline.mean - 1.0) for end in ends)
        level: dict[str, object] = {
            "preload_n": None, "prediction_interval_95_n": None, "prediction_interval_95_percent": (lower, upper),
        }  # fmt: skip
    else:
        lower, upper = (preload_from_feature(end, calibration.coefficients) for end in ends)
        level = {
            "preload_n": preload_from_feature(baseline.mean, calibration.coefficients),
            "prediction_interval_95_n": (lower, upper),
        }
    used = state.prior_in_use
    weight = min(used.degrees_of_freedom / baseline.degrees_of_freedom, 1.0) if used is not None else 0.0
    n_sisters = 0 if prior is None else prior.n_sisters
    lent = LentBySisters(n_sisters=n_sisters, weight_in_scatter=weight, contradicted=state.contradicted)
    return BaselineView(
        **level,
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
        "since {since:%Y-%m-%d} the {what} is on average {change} above what was learnt as healthy, over "
        "{count} sessions. That is no loss, but nothing tightens by itself: are payload, temperature and position as "
        "stated, was the machine worked on? A small rise is learnt after {settled} sessions; a larger one, once it is "
        "explained, by activating a new calibration"
    ),
    "fall": (
        "since {since:%Y-%m-%d} the {what} is on average {change} below what was learnt as healthy, over "
        "{count} sessions, which is not enough for an alarm: measure again, at another position too"
    ),
}


def alert_view(state: DetectorState, calibration: Calibration | None, settled: int) -> AlertView | None:
    """Return the alert that stands; a rise settles in so many sessions."""
    run, baseline = state.charts.ewma_run, state.baseline
    if state.alert is None or state.alarm is not None or run is None or baseline is None:
        return None
    mean = baseline.mean + run.total / run.count
    if calibration is None:
        percent = _percent_of_frequency(mean / baseline.mean - 1.0)
        what, words_of_it = "frequency", f"{abs(percent):.2g} %"
        change: dict[str, float | None] = {"mean_change_n": None, "mean_change_percent": percent}
    else:
        newtons = preload_from_feature(mean, calibration.coefficients)
        newtons -= preload_from_feature(baseline.mean, calibration.coefficients)
        what, words_of_it, change = "preload", f"{abs(newtons):.0f} N", {"mean_change_n": newtons}
    direction: Literal["rise", "fall"] = "fall" if state.charts.ewma > 0.0 else "rise"
    words = _ALERT[direction].format(
        since=run.since, what=what, change=words_of_it, count=run.count, settled=settled
    )  # fmt: skip
    return AlertView(
        raised_at=state.alert.raised_at,
        since=run.since,
        direction=direction,
        n_sessions=run.count,
        sentence=words,
        **change,
    )


#: Steps that a projection is told in, and how far it goes at most.
_STEPS, _LONGEST_AHEAD = 13, timedelta(days=90)
_DAYS_A_YEAR = 365.25


@dataclass(frozen=True, slots=True)
class ProjectedPreload:
    """Where the preload would go if it went on as it does now: a projection, no measurement."""

    line: LineView
    at: list[datetime]
    preload_n: list[float]
    lower_n: list[float]  # of the 95 % prediction interval of one session
    upper_n: list[float]


def projected_preload(line: TrendLine, calibration: Calibration, view: LineView) -> ProjectedPreload:
    """Project the line as far as it reaches back, and 90 days at most: straight in newtons, as its ``view`` is."""
    per_feature = _newtons_per_feature(line, calibration)
    reach = min(line.ended_at - line.started_at, _LONGEST_AHEAD)
    ahead = [reach * step / (_STEPS - 1) for step in range(_STEPS)]
    features = [line.ahead(each / timedelta(days=_DAYS_A_YEAR)) for each in ahead]
    at_end = preload_from_feature(line.at_end.value, calibration.coefficients)
    value = [at_end + per_feature * (feature.value - line.at_end.value) for feature in features]
    half = [abs(per_feature) * feature.expanded_uncertainty for feature in features]
    return ProjectedPreload(
        view,
        [line.ended_at + each for each in ahead],
        value,
        [max(v - h, 0.0) for v, h in zip(value, half, strict=True)],
        [v + h for v, h in zip(value, half, strict=True)],
    )


def _newtons_per_feature(line: TrendLine, calibration: Calibration) -> float:
    """Return what the preload changes by with the feature, where the line ends: P = (g/k3)^-3."""
    return -3.0 * preload_from_feature(line.at_end.value, calibration.coefficients) / line.at_end.value


def line_view(line: TrendLine, calibration: Calibration | None, changed_at: datetime | None = None) -> LineView:
    """Return the line through the trend in newtons a year, or percent, with the confidence interval of its slope."""
    preload = None if calibration is None else preload_from_feature(line.at_end.value, calibration.coefficients)
    # a frequency is g^-1/2
    per_feature = -50.0 / line.at_end.value if calibration is None else _newtons_per_feature(line, calibration)
    reach = line.slope.expanded_uncertainty
    lower, upper = sorted(per_feature * (line.slope.value + side * reach) for side in (-1.0, 1.0))
    view = LineView(
        preload_at_end_n=preload,
        slope_n_per_year=per_feature * line.slope.value,
        interval_95_n_per_year=(lower, upper),
        interval_kind="confidence",
        started_at=line.started_at,
        ended_at=line.ended_at,
        n_sessions=line.n_sessions,
        changed_at=changed_at,
    )
    if calibration is not None:
        return view
    of_frequency = {"slope_percent_per_year": view.slope_n_per_year, "interval_95_percent_per_year": (lower, upper)}
    return view.model_copy(update=of_frequency | {"slope_n_per_year": None, "interval_95_n_per_year": None})


def _percent_of_frequency(rise: float) -> float:
    """Return the change of a frequency whose 1/f² has risen by a share of itself, in percent."""
    return 100.0 * (1.0 / math.sqrt(1.0 + rise) - 1.0)


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


@dataclass(frozen=True, slots=True)
class HistoryColumn:
    """What a history says under one calibration."""

    calibration: int | None
    state: str  # of the axis after the last measurement
    n_measurements: int
    n_refused: int
    states: dict[str, int]  # after how many measurements the axis stood so
    n_alarms: int
    first_alarm_at: datetime | None
    alarms_at: tuple[datetime, ...]  # when the measurements were made that raised them
    median_preload_n: float | None
    median_interval_95_n: tuple[float | None, float | None]  # of the lower and of the upper ends; None: mostly open


@dataclass(frozen=True, slots=True)
class Comparison:
    """How an axis stood and stands, or would stand, side by side."""

    dry_run: bool
    same_alarms: bool
    waveforms_gone: int  # measurements that stand as they were judged before
    old: HistoryColumn
    new: HistoryColumn


COMPARISON = TypeAdapter(Comparison)
