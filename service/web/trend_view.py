"""Turn points of the trend into pictures and lines of a page."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from typing import Final, Literal, TypeVar

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.units import metres
from service.documents.lost_motion import ReadingStanding
from service.documents.measurement import ends_of, falls_of, numbers_of
from service.documents.said import N_
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.calibrations import CalibrationOverview
from service.operations.monitoring.extremes import extremes_of, thin_out
from service.operations.monitoring.history import AxisHistory, HealthyFrequency
from service.report.svg import Frame
from service.report.trend_chart import (
    LOW_NARROW,
    LOW_WIDE,
    NARROW,
    WIDE,
    Band,
    LaneEvent,
    Line,
    Marks,
    TrendPicture,
    trend_chart,
)
from service.store.tables import microseconds_of
from service.store.trend.lost_motion import ChartedReading
from service.store.trend.shown import ShownPoint, ToldColumns
from service.web.forms import ShownRange
from service.web.shown import decimal, with_interval
from service.web.words import CALLED, Words

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


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Points of a trend as they are drawn: all on wide pages, fewer on phones."""

    wide: ToldColumns
    narrow: ToldColumns

    @classmethod
    def of(cls, points: Sequence[ShownPoint], healthy: HealthyFrequency | None = None) -> "Drawn":
        """Return points for the charts of a page.

        ``healthy``: frequencies of the time in which that was learnt are compared with it, as it is known now.
        """
        if healthy is not None:
            points = [_compared(point, healthy) for point in points]
        return cls(ToldColumns.of(points), ToldColumns.of(thinned(points, _ON_A_PHONE)))

    def of_size(self, frame: Frame) -> ToldColumns:
        """Return those of a frame."""
        return self.wide if frame in (WIDE, LOW_WIDE) else self.narrow


def _compared(point: ShownPoint, healthy: HealthyFrequency) -> ShownPoint:
    if point.expected_frequency_hz is not None or point.refusal_reason is not None or point.set_preload_n is not None:
        return point
    conditions = Conditions(metres(point.position_mm), point.payload_kg, point.temperature_c)
    return point._replace(expected_frequency_hz=healthy.at(conditions))


def frequency_charts(
    words: Words, axis_id: str, drawn: Drawn, shown: ShownRange, *,
    history: AxisHistory, events: Sequence[LaneEvent],
) -> Charts:  # fmt: skip
    """Draw by how much frequencies differ from those of the healthy axis at the same place, in percent."""
    band, title = None, words(N_("Natural frequency over time, compared with the baseline at the same place"))
    if history.baseline is not None and history.baseline.prediction_interval_95_percent is not None:
        band = Band(0.0, *history.baseline.prediction_interval_95_percent, words(N_("baseline")))

    def draw(frame: Frame, write: Callable[[str], str]) -> Markup:
        told = drawn.of_size(frame)
        marks = frequency_marks(told, words if frame is WIDE else None, axis_id)
        return trend_chart(TrendPicture(title, "%", shown.start, shown.end, marks, events, band), frame, write)

    return twice(words, draw, WIDE, NARROW)


def frequency_marks(told: ToldColumns, words: Words | None, axis_id: str) -> Marks:
    """Return changes of frequencies as they are drawn; with words each leads to its measurement, and says its value."""
    fall, least, most = (np.array(column, dtype=np.float64) for column in falls_of(told))
    half = (most - least) / 2.0
    written = [
        "—" if math.isnan(value) else f"{decimal(words, f'{-value:+.2f}')} %" if words is not None else ""
        for value in fall.tolist()
    ]
    return _marks_of(told, (-fall, -fall - half, -fall + half), written, words, axis_id)


def preload_charts(
    words: Words, axis_id: str, drawn: Drawn, shown: ShownRange, *,
    history: AxisHistory, events: Sequence[LaneEvent], level: Band | None = None,
) -> Charts:  # fmt: skip
    """Draw the preload with its intervals, the baseline, the line through it, and what happened to the axis.

    ``level`` is drawn where the history holds no baseline of that time.
    """
    band, title, through = level, words(N_("Preload over time")), _through(history)
    baseline = history.baseline
    if baseline is not None and baseline.preload_n is not None and baseline.prediction_interval_95_n is not None:
        band = Band(baseline.preload_n, *baseline.prediction_interval_95_n, words(N_("baseline")))

    def draw(frame: Frame, write: Callable[[str], str]) -> Markup:
        told = drawn.of_size(frame)
        marks = preload_marks(told, words if frame is WIDE else None, axis_id)
        return trend_chart(TrendPicture(title, "N", shown.start, shown.end, marks, events, band, through), frame, write)

    return twice(words, draw, WIDE, NARROW)


def low_charts(
    words: Words, name: tuple[str, str], quantity: Literal["friction_torque_nm", "frequency_hz"], drawn: Drawn,
    shown: ShownRange, *, events: Sequence[LaneEvent] = (),
) -> Charts:  # fmt: skip
    """Draw another quantity of the same measurements, by its title and its unit."""

    def draw(frame: Frame, write: Callable[[str], str]) -> Markup:
        told = drawn.of_size(frame)
        kinds = [
            "refused" if refusal else state for refusal, state in zip(told.refusal_reason, told.state, strict=True)
        ]
        nothing = np.full(len(kinds), math.nan)
        marks = Marks(_seconds(told), numbers_of(getattr(told, quantity)), nothing, nothing, kinds)
        return trend_chart(TrendPicture(*name, shown.start, shown.end, marks, events), frame, write)

    return twice(words, draw, LOW_WIDE, LOW_NARROW)


def reading_charts(
    words: Words, readings: Sequence[ChartedReading], shown: ShownRange, standing: ReadingStanding, *,
    events: Sequence[LaneEvent] = (),
) -> Charts:  # fmt: skip
    """Draw readings with their intervals, and the band of their baseline; what was measured elsewhere is a square."""
    band, title = None, words(CALLED["quantity"][standing.quantity])
    if standing.baseline is not None and standing.baseline_interval_95 is not None:
        band = Band(standing.baseline, *standing.baseline_interval_95, words(N_("baseline")))
    readings = [reading for reading in readings if reading.unit == readings[-1].unit]  # another nut may have another
    within = [reading for reading in readings if shown.start <= reading.at < shown.end]

    def draw(frame: Frame, write: Callable[[str], str]) -> Markup:
        most = MOST_SHOWN if frame is LOW_WIDE else _ON_A_PHONE
        drawn = _extremes_and_newest(within, most)
        value, lower, upper = (
            np.array([getattr(reading, name) for reading in drawn], dtype=np.float64)
            for name in ("value", "interval_lower", "interval_upper")
        )
        kinds = ["unknown" if reading.uncharted else reading.state for reading in drawn]
        marks = Marks(np.array([reading.at.timestamp() for reading in drawn]), value, lower, upper, kinds)
        return trend_chart(
            TrendPicture(title, readings[-1].unit, shown.start, shown.end, marks, events, band), frame, write
        )

    return twice(words, draw, LOW_WIDE, LOW_NARROW)


def _extremes_and_newest(readings: Sequence[ChartedReading], most: int) -> list[ChartedReading]:
    if len(readings) <= most:
        return list(readings)
    each = {microseconds_of(reading.at): reading for reading in readings}
    values = [(at, reading.value, at, reading.value, at) for at, reading in each.items()]
    kept = extremes_of(values[:-1], (most - 1) // 2)
    return [reading for at, reading in each.items() if at in kept or reading is readings[-1]]


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
    events += [LaneEvent(row.at, "work", words(CALLED["work"][row.kind])) for row in history.events]
    if history.baseline is not None:
        events.append(LaneEvent(history.baseline.ended_at, "learnt", words(N_("learnt"))))
    return events


def thinned(points: Sequence[ShownPoint], most: int) -> list[ShownPoint]:
    """Keep so many points at most: the extremes of each stretch, and the last one, which is the present."""
    return [*thin_out(points[:-1], most - 1), *points[-1:]]


def preload_marks(told: ToldColumns, words: Words | None = None, axis_id: str = "") -> Marks:
    """Return preloads as they are drawn; with words each leads to its measurement, and says its value."""
    ends = ends_of(told)
    value, lower, upper = numbers_of(told.preload_n), *map(numbers_of, ends)
    lower[np.isnan(value)] = math.nan
    upper[np.isnan(upper)] = math.inf
    written = (
        [] if words is None else [_value(words, *each) for each in zip(told.preload_n, *ends, strict=True)]
    )  # fmt: skip
    return _marks_of(told, (value, lower, upper), written, words, axis_id)


def _marks_of(
    told: ToldColumns, values: tuple[FloatArray, FloatArray, FloatArray], written: Sequence[str],
    words: Words | None, axis_id: str,
) -> Marks:  # fmt: skip
    kinds = [
        "refused" if refusal else "doubt" if own or places else state
        for refusal, own, places, state in zip(
            told.refusal_reason, told.doubt, told.places_disagree, told.state, strict=True
        )
    ]
    links = [] if words is None else [
        (
            f"/axes/{axis_id}/measurements/{number}",
            f"{moment.replace('T', ' ')} UTC: {words(N_('refused')) if refusal else said}",
        )
        for number, moment, refusal, said in zip(
            told.measurement_id,
            np.datetime_as_string(np.array(told.at_us, "datetime64[us]"), unit="m").tolist(),
            told.refusal_reason, written, strict=True,
        )
    ]  # fmt: skip
    return Marks(_seconds(told), *values, kinds, links)


def _seconds(told: ToldColumns) -> FloatArray:
    """Return when each was measured [s since 1970]."""
    return np.array(told.at_us, dtype=np.float64) / 1e6


def _value(words: Words, preload: float | None, *ends: float | None) -> str:
    value, half = with_interval(words, preload, ends)
    return f"{value} N{f' ± {half}' if half else ''}"


def _through(history: AxisHistory) -> Line | None:
    line = history.line
    if line is None or line.preload_at_end_n is None or line.slope_n_per_year is None:
        return None
    years = (line.ended_at - line.started_at) / timedelta(days=365.25)
    at_start = line.preload_at_end_n - line.slope_n_per_year * years
    return Line((line.started_at, at_start), (line.ended_at, line.preload_at_end_n))
