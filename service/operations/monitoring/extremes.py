"""Draw any span of a trend with a given number of points: long ones from what its hours and days hold."""

from collections.abc import Sequence
from datetime import timedelta
from itertools import pairwise
from operator import itemgetter

from sqlalchemy import Connection

from service.store.trend.points import Span
from service.store.trend.rollups import DAY, HOUR, Extremes, begin_of, extremes_held, number_held
from service.store.trend.shown import PageOf, ShownPoint, page_of_points, points_at

_LOWEST, _HIGHEST = itemgetter(1), itemgetter(3)
#: So many measurements, or hours, are read for each point that is wanted at most.
READ_PER_POINT = 4


def extremes(connection: Connection, axis_number: int, span: Span, resolution: int) -> list[ShownPoint]:
    """Return the lowest and the highest preload of each of so many stretches of a span, in time order.

    Extremes are kept because a reader looks for them; a mean would hide the low value that matters. A stretch without
    a preload is shown by its first measurement. Preloads that were set on purpose are left out: no axis wore so.
    """
    n_measurements, n_hours = number_held(connection, axis_number, span)
    most = READ_PER_POINT * resolution
    if n_measurements <= most:
        return thin_out(_history(page_of_points(connection, axis_number, PageOf(span, most + 1))), resolution)
    units = [HOUR] if n_hours <= most else [DAY, HOUR]
    stretches = _stretches(_held(connection, axis_number, span, units), max(resolution // 2, 1))
    return _history(points_at(connection, axis_number, set[int]().union(*map(_shown_of, stretches))))


def _history(points: Sequence[ShownPoint]) -> list[ShownPoint]:
    return [point for point in points if point.set_preload_n is None]


def thin_out(points: Sequence[ShownPoint], most: int) -> list[ShownPoint]:
    """Keep so many points at most, as :func:`extremes` does."""
    if len(points) <= most:
        return list(points)
    each = [_extremes_at(point) for point in points]
    kept = extremes_of(each, max(most // 2, 1))
    return [point for point, alone in zip(points, each, strict=True) if alone[0] in kept]


def _held(connection: Connection, axis_number: int, span: Span, units: Sequence[timedelta]) -> list[Extremes]:
    """Return what a span holds: whole days and hours as they are summed up, measurements at its edges."""
    if span.start is not None and span.end is not None and span.start >= span.end:
        return []
    if not units:
        points = page_of_points(connection, axis_number, PageOf(span, 10**6))
        return [_extremes_at(point) for point in _history(points)]
    unit, smaller = units[0], units[1:]
    begin = None if span.start is None else begin_of(span.start + unit - timedelta(microseconds=1), unit)
    end = None if span.end is None else begin_of(span.end, unit)
    if begin is not None and end is not None and begin >= end:
        return _held(connection, axis_number, span, smaller)
    head = [] if begin is None else _held(connection, axis_number, Span(span.start, begin), smaller)
    tail = [] if end is None else _held(connection, axis_number, Span(end, span.end), smaller)
    return head + extremes_held(connection, axis_number, unit, Span(begin, end)) + tail


def extremes_of(held: Sequence[Extremes], n_stretches: int) -> set[int]:
    """Return when the extremes of each of so many stretches were measured [µs]."""
    return set[int]().union(*map(_shown_of, _stretches(held, n_stretches)))


def _stretches(held: Sequence[Extremes], n_stretches: int) -> list[Sequence[Extremes]]:
    """Part what is held into so many stretches at most, alike in how much they hold; none is empty."""
    edges = [i * len(held) // n_stretches for i in range(n_stretches + 1)]
    return [held[begin:end] for begin, end in pairwise(edges) if begin < end]


def _shown_of(stretch: Sequence[Extremes]) -> set[int]:
    """Return when the extremes of a stretch were measured, without a preload its first measurement [µs]."""
    valued = [part for part in stretch if part[2] is not None]
    if not valued:
        return {stretch[0][0]}
    extremes_at = min(valued, key=_LOWEST)[2], max(valued, key=_HIGHEST)[4]
    return {at for at in extremes_at if at is not None}


def _extremes_at(point: ShownPoint) -> Extremes:
    valued = None if point.preload_n is None else point.at_us
    return point.at_us, point.preload_n, valued, point.preload_n, valued
