"""Keep what each hour and each day of the trend holds, so that years are drawn without being read."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy import Column, Connection, Integer, bindparam, delete, func, insert, select

from service.store.trend.points import POINTS, Span
from service.store.trend.tables import stored_rows, table_of

HOUR, DAY = timedelta(hours=1), timedelta(days=1)
_BEGIN_OF_TIME, _END_OF_TIME = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Rollup:
    """What an hour, a day, or several of them hold; a preload that was set on purpose is no extreme of a history."""

    starts_at: datetime
    n_measurements: int
    n_refused: int
    first_at: datetime
    lowest_n: float | None
    lowest_at: datetime | None
    highest_n: float | None
    highest_at: datetime | None


#: When preload was lowest and highest in a stretch of time, as it is stored: first measurement [µs since 1970], lowest
#: preload and its moment, highest one and its moment. Years are drawn from thousands of them, of which few are shown.
Extremes = tuple[int, float | None, int | None, float | None, int | None]


_ROLLUPS = table_of(
    "trend_rollups",
    Rollup,
    Column("axis_number", Integer, primary_key=True),
    Column("span_s", Integer, primary_key=True),  # 3600 or 86400
    key=("starts_at",),
    types={},
)
_COLUMNS = [_ROLLUPS.c[name] for name in Rollup.__slots__]
_OF_HOUR = select(POINTS.c.at, POINTS.c.refusal_reason, POINTS.c.preload_n, POINTS.c.set_preload_n).where(
    POINTS.c.axis_number == bindparam("axis"), POINTS.c.at >= bindparam("begin"), POINTS.c.at < bindparam("end")
)
_SET_ON_PURPOSE = select(POINTS.c.axis_number, POINTS.c.at).where(POINTS.c.set_preload_n.is_not(None))
_BEGIN_WITHIN = (
    _ROLLUPS.c.axis_number == bindparam("axis"),
    _ROLLUPS.c.span_s == bindparam("span"),
    _ROLLUPS.c.starts_at >= bindparam("begin"),
    _ROLLUPS.c.starts_at < bindparam("end"),
)
_HELD = select(*_COLUMNS).where(*_BEGIN_WITHIN).order_by(_ROLLUPS.c.starts_at)
_EXTREMES = (
    select(*(_ROLLUPS.c[name] for name in ("first_at", "lowest_n", "lowest_at", "highest_n", "highest_at")))
    .where(*_BEGIN_WITHIN)
    .order_by(_ROLLUPS.c.starts_at)
)
_NUMBER_HELD = select(func.coalesce(func.sum(_ROLLUPS.c.n_measurements), 0), func.count()).where(*_BEGIN_WITHIN)
_FORGET = delete(_ROLLUPS).where(
    _ROLLUPS.c.axis_number == bindparam("axis"),
    _ROLLUPS.c.span_s == bindparam("span"),
    _ROLLUPS.c.starts_at == bindparam("begin"),
)
_ADD = insert(_ROLLUPS)


def sum_up(connection: Connection, axis_number: int, moments: Iterable[datetime]) -> None:
    """Sum up the hours and days anew that these moments lie in: hours from their points, days from their hours."""
    hours = {begin_of(moment, HOUR) for moment in moments}
    for hour in hours:
        _store(connection, axis_number, HOUR, hour, merge(hour, _points_of(connection, axis_number, hour)))
    for day in {begin_of(hour, DAY) for hour in hours}:
        merged = merge(day, rollups(connection, axis_number, HOUR, Span(day, day + DAY)))
        _store(connection, axis_number, DAY, day, merged)


def leave_out_set_preloads(connection: Connection) -> None:
    """Sum up anew what holds preloads that were set on purpose, which an older program took for extremes."""
    moments: dict[int, list[datetime]] = {}
    for axis_number, at in connection.execute(_SET_ON_PURPOSE).all():
        moments.setdefault(axis_number, []).append(at)
    for axis_number, of_axis in moments.items():
        sum_up(connection, axis_number, of_axis)


def rollups(connection: Connection, axis_number: int, span: timedelta, within: Span) -> list[Rollup]:
    """Return the hours or the days that begin within a span of time."""
    return [Rollup(*row) for row in connection.execute(_HELD, _begin_within(axis_number, span, within))]


def extremes_held(connection: Connection, axis_number: int, span: timedelta, within: Span) -> list[Extremes]:
    """Return the extremes of the hours or the days that begin within a span of time."""
    return stored_rows(connection, _EXTREMES, _begin_within(axis_number, span, within))


def number_held(connection: Connection, axis_number: int, within: Span) -> tuple[int, int]:
    """Return how many measurements the days hold that touch a span of time, and in how many hours at most."""
    days = Span(None if within.start is None else begin_of(within.start, DAY), within.end)
    ((n_measurements, n_days),) = connection.execute(_NUMBER_HELD, _begin_within(axis_number, DAY, days))
    return int(n_measurements), 24 * n_days


def _begin_within(axis_number: int, span: timedelta, within: Span) -> dict[str, object]:
    begin, end = within.start or _BEGIN_OF_TIME, within.end or _END_OF_TIME
    return {"axis": axis_number, "span": _seconds(span), "begin": begin, "end": end}


def merge(starts_at: datetime, parts: Iterable[Rollup]) -> Rollup | None:
    """Return what several stretches of time hold together; None if that is nothing."""
    parts = list(parts)
    if not parts:
        return None
    valued = [part for part in parts if part.lowest_n is not None]
    lowest = min(valued, key=lambda part: (part.lowest_n, part.lowest_at), default=None)
    highest = max(valued, key=lambda part: (part.highest_n, part.highest_at), default=None)
    return Rollup(
        starts_at,
        sum(part.n_measurements for part in parts),
        sum(part.n_refused for part in parts),
        min(part.first_at for part in parts),
        None if lowest is None else lowest.lowest_n,
        None if lowest is None else lowest.lowest_at,
        None if highest is None else highest.highest_n,
        None if highest is None else highest.highest_at,
    )


def begin_of(moment: datetime, span: timedelta) -> datetime:
    """Return when the hour or day of a moment begins, in UTC."""
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return moment - since % span


def _points_of(connection: Connection, axis_number: int, hour: datetime) -> list[Rollup]:
    values = {"axis": axis_number, "begin": hour, "end": hour + HOUR}
    points = []
    for at, reason, preload, set_preload in connection.execute(_OF_HOUR, values):
        worn, when = (preload, at) if preload is not None and set_preload is None else (None, None)
        points.append(Rollup(at, 1, int(reason is not None), at, worn, when, worn, when))
    return points


def _store(
    connection: Connection, axis_number: int, span: timedelta, starts_at: datetime, rollup: Rollup | None
) -> None:
    connection.execute(_FORGET, {"axis": axis_number, "span": _seconds(span), "begin": starts_at})
    if rollup is not None:
        columns = {name: getattr(rollup, name) for name in Rollup.__slots__}
        connection.execute(_ADD, {"axis_number": axis_number, "span_s": _seconds(span)} | columns)


def _seconds(span: timedelta) -> int:
    return span // timedelta(seconds=1)
