"""Draw what was measured over time: points with intervals, the baseline's band, refused ones hollow, a lane of events.

One drawing for pages, reports and print: colours are those of the style sheet, shapes say the same without colour. What
axes of one type have left of their baselines is drawn on the same axis of time.
"""

import html
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from service.report.svg import Axis, Frame, axis_over, element, image, joined, label, path_through, value_grid

_HOUR, _DAY = timedelta(hours=1), timedelta(days=1)
_STEPS: Final = (
    *(timedelta(minutes=minutes) for minutes in (1, 5, 15, 30)),
    *(_HOUR * hours for hours in (1, 3, 6, 12)),
    *(_DAY * days for days in (1, 2, 4, 7, 14)),
)
#: Steps in months, where days are too many.
_MONTHS: Final = (1, 2, 3, 6, 12, 24, 60, 120)
_MONTH = 30.4 * _DAY
_EPOCH: Final = datetime(2000, 1, 3, tzinfo=UTC)  # a Monday, so that steps of weeks begin with one


def time_ticks(start: datetime, end: datetime, most: int) -> list[tuple[datetime, str]]:
    """Return at most so many round moments between two others, each with its label."""
    span = end - start
    for step in _STEPS:
        if span / step <= most - 1:
            first_tick = _EPOCH + -(-(start - _EPOCH) // step) * step
            moments = [first_tick + i * step for i in range(most) if first_tick + i * step <= end]
            return [(moment, f"{moment:%H:%M}" if step < _DAY else f"{moment:%m-%d}") for moment in moments]
    months = next((months for months in _MONTHS if span / (months * _MONTH) <= most - 1), _MONTHS[-1])
    count = start.year * 12 + start.month - 1
    number = -(-(count + 1) // months) * months
    ticks: list[tuple[datetime, str]] = []
    while (moment := datetime(number // 12, number % 12 + 1, 1, tzinfo=UTC)) <= end and len(ticks) < most:
        ticks.append((moment, f"{moment:%Y-%m}" if months < 12 else f"{moment:%Y}"))
        number += months
    return ticks


#: Width of a character of 16 units of height, on the wide side.
_CHARACTER: Final = 9.2
_RADIUS: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Measurements in a chart, column by column; a value that is not known is NaN, and stands at the foot."""

    at: FloatArray  # [s since 1970]
    value: FloatArray
    lower: FloatArray  # NaN where no interval is drawn
    upper: FloatArray  # infinite where it is open
    kind: Sequence[str]  # state of the axis after it, or "refused" or "doubt"
    links: Sequence[tuple[str, str]] = ()  # address and words of each, where it leads to its measurement


@dataclass(frozen=True, slots=True)
class LaneEvent:
    """What happened to an axis besides measurements: calibration, alarm, work."""

    at: datetime
    kind: str
    words: str


@dataclass(frozen=True, slots=True)
class Band:
    """A level with the interval around it in which one more healthy measurement is expected."""

    level: float
    lower: float
    upper: float
    words: str


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line through the trend."""

    start: tuple[datetime, float]
    end: tuple[datetime, float]


@dataclass(frozen=True, slots=True)
class Wedge:
    """Where values would lie if they went on as they do: a projection, with its interval."""

    at: Sequence[datetime]
    values: Sequence[float]
    lower: Sequence[float]
    upper: Sequence[float]


#: Room for the axis of time, and for a lane of events above it.
_WITH_LANE: Final = 58.0
WIDE: Final = Frame(1180.0, 300.0, 70.0, 8, 5, _WITH_LANE)
NARROW: Final = Frame(388.0, 250.0, 56.0, 5, 4, _WITH_LANE)
LOW_WIDE: Final = Frame(1180.0, 170.0, 70.0, 8, 3)
LOW_NARROW: Final = Frame(388.0, 150.0, 56.0, 5, 3)


@dataclass(frozen=True, slots=True)
class TrendPicture:
    """All that a chart shows."""

    title: str
    unit: str
    start: datetime
    end: datetime
    marks: Marks
    events: Sequence[LaneEvent] = ()
    band: Band | None = None
    line: Line | None = None
    wedge: Wedge | None = None


def trend_chart(shown: TrendPicture, frame: Frame, write: Callable[[str], str]) -> Markup:
    """Draw a chart; ``write`` puts a number into the language of the page.

    If its marks lead to their measurements, the picture is a group for a screen reader, else an image.
    """
    time = _TimeAxis(shown.start.timestamp(), shown.end.timestamp(), frame.left + 8.0, frame.right - 8.0)
    scale = _scale(shown, frame)
    parts = [
        _band(shown.band, scale, frame),
        _grid(scale, frame, write, shown.unit),
        _times(time, time_ticks(shown.start, shown.end, frame.places), frame),
        _line(shown.line, time, scale, frame),
        _wedge(shown.wedge, time, scale),
        _lane(shown.events, time, frame),
        _marks(shown.marks, time, scale, frame),
    ]
    return element(
        "svg",
        *parts,
        viewBox=f"0 0 {frame.width:g} {frame.height:g}",
        width=frame.width,
        height=frame.height,
        role="group" if shown.marks.links else "img",
        aria_label=shown.title,
        data_from=shown.start.isoformat(),
        data_to=shown.end.isoformat(),
        data_left=frame.left + 8.0,
        data_right=frame.right - 8.0,
    )


def sparkline(values: Sequence[float | None], kind: str, words: str) -> Markup:
    """Draw the course of the newest values, without axes; the last one is marked."""
    shown = np.array([math.nan if value is None else value for value in values])
    if np.isnan(shown).all():
        return Markup()
    y = axis_over(shown, 25.0, 7.0)(shown)  # the mark of the last one and its outline are 7 high about it
    x = np.linspace(4.0, 112.0, shown.size) if shown.size > 1 else np.array([112.0])
    last = int(np.flatnonzero(~np.isnan(shown))[-1])
    return element(
        "svg",
        element("path", d=path_through(x, y), class_="spark"),
        element("path", d=_shape(kind, float(x[last]), float(y[last])), class_=f"mark {kind}"),
        viewBox="0 0 120 32",
        width=120.0,
        height=32.0,
        role="img",
        aria_label=words,
    )


@dataclass(frozen=True, slots=True)
class _TimeAxis:
    start: float  # [s since 1970], as all here
    end: float
    left: float
    right: float

    @property
    def per_second(self) -> float:
        return (self.right - self.left) / ((self.end - self.start) or 1.0)

    def places(self, at: FloatArray) -> FloatArray:
        return self.left + (at - self.start) * self.per_second

    def place(self, moment: datetime) -> float:
        return self.left + (moment.timestamp() - self.start) * self.per_second

    def holds(self, moment: datetime) -> bool:
        return self.start <= moment.timestamp() <= self.end


def _scale(shown: TrendPicture, frame: Frame) -> Axis:
    """Return the axis of values: over all of them, and over intervals that are not much wider than what they are of."""
    values, ends = shown.marks.value, np.concatenate([shown.marks.lower, shown.marks.upper])
    levels = [] if shown.band is None else [shown.band.lower, shown.band.upper]
    ahead = [] if shown.wedge is None else [*shown.wedge.lower, *shown.wedge.upper]
    shown_values = np.concatenate([values[np.isfinite(values)], levels, ahead])
    if shown_values.size:
        reach = 1.5 * max(float(np.ptp(shown_values)), 0.2 * float(np.abs(shown_values).max()))
        ends = np.clip(ends[np.isfinite(ends)], shown_values.min() - reach, shown_values.max() + reach)
    return axis_over(np.concatenate([shown_values, ends]), frame.bottom - 18.0, frame.top)


def _grid(scale: Axis, frame: Frame, write: Callable[[str], str], unit: str) -> Markup:
    named = label(unit, frame.left - 6.0, frame.bottom + 4.0, text_anchor="end", class_="quiet")
    return joined([value_grid(scale, frame.left, frame.right, frame.values, write), named])


def _times(time: _TimeAxis, ticks: Sequence[tuple[datetime, str]], frame: Frame) -> Markup:
    drawn = [element("line", x1=frame.left, y1=frame.bottom, x2=frame.right, y2=frame.bottom, class_="grid")]
    for moment, words in ticks:
        x, half = time.place(moment), _CHARACTER * len(words) / 2.0
        drawn.append(element("line", x1=x, y1=frame.bottom, x2=x, y2=frame.bottom + 5.0, class_="grid"))
        if x - half > 0.0 and x + half < frame.width:
            drawn.append(label(words, x, frame.height - 8.0, text_anchor="middle", class_="quiet"))
    return joined(drawn)


def _band(band: Band | None, scale: Axis, frame: Frame) -> Markup:
    if band is None:
        return Markup()
    ends = scale(np.array([band.lower, band.upper, band.level]))
    lower, upper, level = np.clip(ends, frame.top, frame.bottom).tolist()
    width = frame.right - frame.left
    return joined([
        element("rect", x=frame.left, y=upper, width=width, height=max(lower - upper, 0.0), class_="band"),
        element("line", x1=frame.left, y1=level, x2=frame.right, y2=level, class_="level"),
    ])  # fmt: skip


def _wedge(wedge: Wedge | None, time: _TimeAxis, scale: Axis) -> Markup:
    if wedge is None:
        return Markup()
    x = np.array([time.place(moment) for moment in wedge.at])
    lower, upper, values = (scale(np.array(ends)) for ends in (wedge.lower, wedge.upper, wedge.values))
    around = path_through(np.concatenate([x, x[::-1]]), np.concatenate([upper, lower[::-1]]))
    return joined([
        element("path", d=f"{around}z", class_="wedge"),
        element("path", d=path_through(x, values), class_="ahead"),
    ])  # fmt: skip


def _line(line: Line | None, time: _TimeAxis, scale: Axis, frame: Frame) -> Markup:
    if line is None:
        return Markup()
    ends = [(time.place(moment), float(scale(value))) for moment, value in (line.start, line.end)]
    (x1, y1), (x2, y2) = ends
    if x2 <= frame.left or x1 >= frame.right:
        return Markup()
    slope = (y2 - y1) / (x2 - x1) if x2 > x1 else 0.0
    left, right = max(x1, frame.left), min(x2, frame.right)
    return element(
        "line", x1=left, y1=y1 + slope * (left - x1), x2=right, y2=y1 + slope * (right - x1), class_="through"
    )


def _lane(events: Sequence[LaneEvent], time: _TimeAxis, frame: Frame) -> Markup:
    held = sorted((event for event in events if time.holds(event.at)), key=lambda event: event.at)
    if frame.below < _WITH_LANE:
        return joined([_event_line(time.place(event.at), frame, event.kind) for event in held])
    drawn, free_from, y = [], frame.left, frame.bottom + 22.0
    places = [*(time.place(event.at) for event in held), frame.width + 5.0]
    for event, x, following in zip(held, places, places[1:], strict=False):
        drawn.append(_event_line(x, frame, event.kind))
        drawn.append(element("path", d=f"M{x:.1f} {y - 14.0:.1f}l5 10h-10z", class_=f"event {event.kind}"))
        width = _CHARACTER * len(event.words)
        if x + 8.0 >= free_from and x + 8.0 + width <= following - 5.0:
            drawn.append(label(event.words, x + 8.0, y - 2.0, class_="quiet"))
            free_from = x + 16.0 + width
    return joined(drawn)


def _event_line(x: float, frame: Frame, kind: str) -> Markup:
    return element("line", x1=x, y1=frame.top, x2=x, y2=frame.bottom, class_=f"event {kind}")


def _marks(marks: Marks, time: _TimeAxis, scale: Axis, frame: Frame) -> Markup:
    known, x = np.isfinite(marks.value), time.places(marks.at).tolist()
    value, lower, upper = (
        np.clip(scale(values), frame.top, frame.bottom).tolist() for values in (marks.value, marks.lower, marks.upper)
    )
    whiskers = defaultdict[str, list[str]](list)
    for i in np.flatnonzero(known & np.isfinite(marks.lower)).tolist():
        whiskers[marks.kind[i]].append(f"M{x[i]:.1f} {lower[i]:.1f}V{upper[i]:.1f}")
    heights = np.where(known, value, frame.bottom - 8.0).tolist()
    shapes = [_shape(*mark) for mark in zip(marks.kind, x, heights, strict=True)]
    drawn = [_path(f"whisker {kind}", "".join(lines)) for kind, lines in whiskers.items()]
    if marks.links:
        drawn += [
            f'<a href="{html.escape(address)}" tabindex="-1"><title>{html.escape(said)}</title>'
            f"{_path(f'mark {kind}', shape)}</a>"
            for (address, said), kind, shape in zip(marks.links, marks.kind, shapes, strict=True)
        ]
    else:
        alike = defaultdict[str, list[str]](list)
        for kind, shape in zip(marks.kind, shapes, strict=True):
            alike[kind].append(shape)
        drawn += [_path(f"mark {kind}", "".join(outlines)) for kind, outlines in alike.items()]
    return Markup("".join(drawn))  # noqa: S704 - outlines are numbers and letters; kinds, addresses and words are escaped


def _path(style: str, outline: str) -> str:
    """Write an element of which there are hundreds; :func:`element` looks at each of its parts."""
    return f'<path d="{outline}" class="{html.escape(style)}"></path>'


def _shape(kind: str, x: float, y: float) -> str:
    """Return the outline of a mark: its shape says the state without any colour."""
    r = _RADIUS
    match kind:
        case "alarm":
            return f"M{x - 5:.1f} {y - 4:.1f}h10l-5 9z"
        case "alert":
            return f"M{x:.1f} {y - 5:.1f}l5 5l-5 5l-5-5z"
        case "doubt":
            return f"M{x - r:.1f} {y - r:.1f}l8 8m0-8l-8 8"
        case "unknown":
            return f"M{x - r:.1f} {y - r:.1f}h8v8h-8z"
        case _:
            return f"M{x - r:.1f} {y:.1f}a4 4 0 1 0 8 0a4 4 0 1 0-8 0"


#: Lines look different without any colour.
DASHES = ("", "8 4", "2 4", "10 4 2 4", "4 3", "12 3")


@dataclass(frozen=True, slots=True)
class ShareLine:
    """An axis: when, and what share of its baseline; the own one is strong."""

    name: str
    at: Sequence[datetime]
    share: Sequence[float]
    is_own: bool = False


def sisters_chart(title: str, lines: Sequence[ShareLine], frame: Frame, write: Callable[[str], str]) -> Markup:
    """Draw all lines in one picture; each has a number at its end, as in the table by it."""
    moments = [moment for line in lines for moment in line.at]
    start, end = min(moments), max(moments)
    time = _TimeAxis(start.timestamp(), end.timestamp(), frame.left + 8.0, frame.right - 28.0)
    shares = 100.0 * np.array([share for line in lines for share in line.share])
    scale = axis_over(shares, frame.bottom - 8.0, frame.top)
    drawn = [_grid(scale, frame, write, "%")]
    for moment, words in time_ticks(start, end, frame.places):
        drawn.append(label(words, time.place(moment), frame.height - 8.0, text_anchor="middle", class_="quiet"))
    for number, line in enumerate(lines):
        x = np.array([time.place(moment) for moment in line.at])
        y = np.asarray(scale(100.0 * np.array(line.share)))
        dashes = "" if line.is_own else DASHES[1 + number % (len(DASHES) - 1)]
        drawn.append(
            element(
                "path", d=path_through(x, y), class_="sister own" if line.is_own else "sister", stroke_dasharray=dashes
            )
        )
        drawn.append(label(str(number + 1), float(x[-1]) + 6.0, float(y[-1]) + 5.0))
    return image(frame.width, frame.height, title, *drawn)
