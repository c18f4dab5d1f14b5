"""Turn points of the trend into pictures and lines of a page."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from typing import Final, TypeVar

from markupsafe import Markup

from service.documents.measurement import interval_of
from service.documents.said import N_
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.calibrations import CalibrationOverview
from service.operations.monitoring.extremes import thin_out
from service.operations.monitoring.history import AxisHistory
from service.report.svg import Frame
from service.report.trend_chart import (
    LOW_NARROW,
    LOW_WIDE,
    NARROW,
    WIDE,
    Band,
    LaneEvent,
    Line,
    Mark,
    TrendPicture,
    trend_chart,
)
from service.store.trend.shown import ShownPoint
from service.web.forms import ShownRange
from service.web.shown import decimal, with_interval
from service.web.words import Words

#: What was done to an axis, in words short enough for a lane.
WORK: Final = {
    "lubricated": N_("lubricated"),
    "nut-replaced": N_("nut replaced"),
    "screw-replaced": N_("screw replaced"),
    "mounting": N_("mounting changed"),
    "other": N_("other work"),
}
#: Points of a picture: as many as a page of 100 kB has room for, each a link to its measurement.
MOST_SHOWN: Final = 120
_ON_A_PHONE: Final = 70


Size = TypeVar("Size")


@dataclass(frozen=True, slots=True)
class Charts:
    """A picture twice: for wide pages and for phones."""

    wide: Markup
    narrow: Markup


def twice(words: Words, draw: Callable[[Size, Callable[[str], str]], Markup], wide: Size, narrow: Size) -> Charts:
    """Draw a picture in both sizes, its numbers as this language writes them."""
    write = partial(decimal, words)
    return Charts(draw(wide, write), draw(narrow, write))


def preload_charts(
    words: Words, axis_id: str, points: Sequence[ShownPoint], shown: ShownRange, *,
    history: AxisHistory, events: Sequence[LaneEvent], level: Band | None = None,
) -> Charts:  # fmt: skip
    """Draw the preload with its intervals, the baseline, the line through it, and what happened to the axis.

    ``level`` is drawn where the history holds no baseline of that time.
    """
    band = level
    if history.baseline is not None:
        lower, upper = history.baseline.prediction_interval_95_n
        band = Band(history.baseline.preload_n, lower, upper, words(N_("baseline")))

    def drawn(frame: Frame, write: Callable[[str], str]) -> Markup:
        chosen = points if frame is WIDE else thinned(points, _ON_A_PHONE)
        marks = [_mark(words, axis_id, point) for point in chosen]
        title, through = words(N_("Preload over time")), _through(history)
        picture = TrendPicture(title, "N", shown.start, shown.end, marks, events, band, through)
        return trend_chart(picture, frame, write, linked=frame is WIDE)

    return twice(words, drawn, WIDE, NARROW)


def low_charts(
    words: Words, name: tuple[str, str], points: Sequence[ShownPoint], shown: ShownRange,
    value_of: Callable[[ShownPoint], float | None], *, events: Sequence[LaneEvent] = (),
) -> Charts:  # fmt: skip
    """Draw another quantity of the same measurements, by its title and its unit."""

    def drawn(frame: Frame, write: Callable[[str], str]) -> Markup:
        chosen = points if frame is LOW_WIDE else thinned(points, _ON_A_PHONE)
        marks = [
            Mark(point.at, or_nan(value_of(point)), math.nan, math.nan, kind, "")
            for point in chosen
            for kind in ["refused" if point.refusal_reason else point.state]
        ]
        return trend_chart(TrendPicture(*name, shown.start, shown.end, marks, events), frame, write)

    return twice(words, drawn, LOW_WIDE, LOW_NARROW)


def lane_of(
    words: Words, alarms: Sequence[AlarmView], calibrations: CalibrationOverview, history: AxisHistory
) -> list[LaneEvent]:
    """Return what happened to an axis besides measurements, for the lane under its trend."""
    calibration = words(N_("calibration %(number)s"))
    events = [
        LaneEvent(activation.activated_at, "calibration", calibration % {"number": activation.calibration_id})
        for activation in calibrations.activations
    ]
    for view in alarms:
        events.append(LaneEvent(view.row.measured_at, "alarm", words(N_("alarm"))))
        cleared = view.last_to("cleared")
        if cleared is not None:
            events.append(LaneEvent(cleared.at, "cleared", words(N_("cleared"))))
    events += [LaneEvent(row.at, "work", words(WORK[row.kind])) for row in history.events]
    if history.baseline is not None:
        events.append(LaneEvent(history.baseline.ended_at, "learnt", words(N_("learnt"))))
    return events


def thinned(points: Sequence[ShownPoint], most: int) -> list[ShownPoint]:
    """Keep so many points at most: the extremes of each stretch, and the last one, which is the present."""
    return [*thin_out(points[:-1], most - 1), *points[-1:]]


def _mark(words: Words, axis_id: str, point: ShownPoint) -> Mark:
    lower, upper = interval_of(point) if point.preload_n is not None else (None, None)
    kind = "refused" if point.refusal_reason else "doubt" if point.doubts else point.state
    value, half = with_interval(words, point.preload_n, (lower, upper))
    text = words(N_("refused")) if point.refusal_reason else f"{value} N{f' ± {half}' if half else ''}"
    return Mark(
        at=point.at,
        value=or_nan(point.preload_n),
        lower=or_nan(lower),
        upper=math.inf if upper is None and lower is not None else or_nan(upper),
        kind=kind,
        words=f"{point.at:%Y-%m-%d %H:%M} UTC: {text}",
        href=f"/axes/{axis_id}/measurements/{point.measurement_id}",
    )


def _through(history: AxisHistory) -> Line | None:
    line = history.line
    if line is None:
        return None
    years = (line.ended_at - line.started_at) / timedelta(days=365.25)
    at_start = line.preload_at_end_n - line.slope_n_per_year * years
    return Line((line.started_at, at_start), (line.ended_at, line.preload_at_end_n))


def or_nan(value: float | None) -> float:
    """Return a value as charts take it: NaN where it is not known."""
    return math.nan if value is None else value
