"""Read and write the points of the trend, in the order of their time."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Select,
    SQLColumnExpression,
    String,
    and_,
    bindparam,
    delete,
    func,
    insert,
    select,
    update,
)

from monitor_core.recording import DoubtReason
from service.store.tables import AxisRow
from service.store.trend.tables import stored_rows, table_of


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """A measurement that was judged, as trend and charts need it."""

    axis_number: int
    at: datetime
    measurement_id: int
    name: str
    position_mm: float
    set_preload_n: float | None
    payload_kg: float | None
    temperature_c: float | None
    refusal_reason: str | None
    calibration_id: int | None
    frequency_hz: float | None
    preload_n: float | None
    interval_lower_n: float | None
    interval_upper_n: float | None
    drag_torque_nm: float | None
    feature_s2: float | None
    feature_uncertainty_s2: float | None  # new with this frequency; without a calibration of 1/f²
    epoch: int  # of the charts, when it was judged
    uncharted: str | None  # why it moved no chart
    state: str  # of the axis, after this measurement
    baseline_preload_n: float | None
    doubt: str | None = None  # what speaks against its preload
    feature_scatter_s2: float | None = None  # of an older program: what its interval allows for, new in each session
    learnt_scatter_s2: float | None = None  # from session to session, as the axis had shown before
    place_uncertainty: float | None = None  # of its preload against other places of its session, relative
    friction_torque_nm: float | None = None  # None also of measurements that an older program judged
    shown_scatter_s2: float | None = None  # what its interval allows for, of what the sessions of its axis show
    places_disagree: str | None = None  # how the places of its session contradict each other, in words
    frequency_uncertainty_hz: float | None = None  # its own; None also of measurements that an older program judged
    # of a healthy axis there, with what one more session scatters by; None: a calibration, or the baseline is learnt
    expected_frequency_hz: float | None = None
    expected_frequency_uncertainty_hz: float | None = None
    # None also of measurements that an older program judged
    damping_ratio: float | None = None
    residue: float | None = None  # its magnitude [m/(N·m·s²) or m/(N·s²), as the excitation is]

    @property
    def doubts(self) -> tuple[str, ...]:
        """What speaks against its preload: of its own, and of its session."""
        return doubts_of(self.doubt, self.places_disagree)


def doubts_of(own: str | None, places_disagree: str | None) -> tuple[str, ...]:
    """Return what speaks against a preload: of its own, and of its session."""
    of_session = None if places_disagree is None else str(DoubtReason.PLACES_DISAGREE)
    return tuple(reason for reason in (own, of_session) if reason is not None)


@dataclass(frozen=True, slots=True)
class Span:
    """From when until when: ``start`` is inside, ``end`` is not; None is open."""

    start: datetime | None = None
    end: datetime | None = None

    def holds(self, moment: datetime) -> bool:
        """Return whether a moment lies within."""
        return (self.start is None or moment >= self.start) and (self.end is None or moment < self.end)

    def bounds(self, moment: SQLColumnExpression[datetime]) -> list[ColumnElement[bool]]:
        """Return the conditions of a query that :meth:`holds`."""
        after = [] if self.start is None else [moment >= self.start]
        return after if self.end is None else [*after, moment < self.end]


MOST_SEARCHED = 200
#: Where a page of the trend begins: after this moment and measurement.
Cursor = tuple[datetime, int]

POINTS = table_of(
    "trend_points",
    TrendPoint,
    key=("axis_number", "at", "measurement_id"),
    types={
        **dict.fromkeys(("measurement_id", "calibration_id"), BigInteger()),
        **dict.fromkeys(("refusal_reason", "doubt"), String(40)),
        "name": String(200), "uncharted": String(20), "state": String(16),
    },
)  # fmt: skip
_COLUMNS = [POINTS.c[name] for name in TrendPoint.__slots__]
#: Why a measurement moved no chart that came when they could not be folded again from before it.
TOO_LATE = "too-late"
_IN_TIME = POINTS.c.uncharted.is_distinct_from(TOO_LATE)
_ADD = insert(POINTS)
_OF_AXIS = POINTS.c.axis_number == bindparam("axis")
_THIS = (_OF_AXIS, POINTS.c.at == bindparam("moment"), POINTS.c.measurement_id == bindparam("measurement"))
_POINT, _REMOVE = select(*_COLUMNS).where(*_THIS), delete(POINTS).where(*_THIS)
_NEWEST_FIRST = select(*_COLUMNS).where(_OF_AXIS).order_by(POINTS.c.at.desc(), POINTS.c.measurement_id.desc())
_NEWEST = _NEWEST_FIRST.limit(1)
_BEFORE = _NEWEST.where(POINTS.c.at < bindparam("moment"))


def add_point(connection: Connection, point: TrendPoint) -> None:
    """Store a new point."""
    connection.execute(_ADD, {name: getattr(point, name) for name in TrendPoint.__slots__})


def replace_points(connection: Connection, points: Iterable[TrendPoint]) -> None:
    """Store points anew that are stored already."""
    for point in points:
        remove_point(connection, point)
        add_point(connection, point)


def remove_point(connection: Connection, point: TrendPoint) -> None:
    """Remove a point."""
    connection.execute(_REMOVE, {"axis": point.axis_number, "moment": point.at, "measurement": point.measurement_id})


def say_places(connection: Connection, axis_number: int, epoch: int, span: Span, words: str | None) -> None:
    """Say of the charted points of an epoch in a span how the places of their session disagree."""
    connection.execute(
        update(POINTS)
        .where(
            POINTS.c.axis_number == axis_number,
            *span.bounds(POINTS.c.at),
            POINTS.c.epoch == epoch,
            POINTS.c.refusal_reason.is_(None),
            POINTS.c.uncharted.is_(None),
            POINTS.c.places_disagree.is_distinct_from(words),
        )
        .values(places_disagree=words)
    )


def point_of(connection: Connection, axis_number: int, at: datetime, measurement_id: int) -> TrendPoint | None:
    """Return the point of a measurement; None if it has none yet."""
    values = {"axis": axis_number, "moment": at, "measurement": measurement_id}
    row = connection.execute(_POINT, values).one_or_none()
    return None if row is None else TrendPoint(*row)


def points_after(
    connection: Connection, axis_number: int, epoch: int, after: datetime | None, since: datetime | None
) -> list[TrendPoint]:
    """Return the points of an epoch of the charts, and of those after it, that are later than a moment.

    Those that came too late for the charts are not among them. ``since``: there is nothing older in that epoch.
    """
    query = select(*_COLUMNS).where(POINTS.c.axis_number == axis_number, POINTS.c.epoch >= epoch, _IN_TIME)
    if since is not None and (after is None or since > after):  # of two bounds SQLite would take the first
        query = query.where(POINTS.c.at >= since)
    elif after is not None:
        query = query.where(POINTS.c.at > after)
    return [TrendPoint(*row) for row in connection.execute(query.order_by(POINTS.c.at, POINTS.c.measurement_id))]


def first_of_epoch(connection: Connection, axis_number: int, epoch: int, since: datetime) -> datetime | None:
    """Return when the first point of an epoch was measured, which begins at a moment."""
    query = select(POINTS.c.at).where(
        POINTS.c.axis_number == axis_number, POINTS.c.at >= since, POINTS.c.epoch == epoch, _IN_TIME
    )
    return connection.execute(query.order_by(POINTS.c.at).limit(1)).scalar()


def point_before(connection: Connection, axis_number: int, at: datetime) -> TrendPoint | None:
    """Return the last point before a moment."""
    row = connection.execute(_BEFORE, {"axis": axis_number, "moment": at}).one_or_none()
    return None if row is None else TrendPoint(*row)


def newest_point(connection: Connection, axis_number: int) -> TrendPoint | None:
    """Return the last point."""
    row = connection.execute(_NEWEST, {"axis": axis_number}).one_or_none()
    return None if row is None else TrendPoint(*row)


def points_within(connection: Connection, axis_number: int, span: Span) -> list[TrendPoint]:
    """Return all points of a span, in time order."""
    query = select(*_COLUMNS).where(POINTS.c.axis_number == axis_number, *span.bounds(POINTS.c.at))
    return [TrendPoint(*row) for row in connection.execute(query.order_by(POINTS.c.at, POINTS.c.measurement_id))]


def count_uncharted(connection: Connection, axis_number: int) -> dict[str, int]:
    """Count the points of an axis that moved no chart, by the reason."""
    query = select(POINTS.c.uncharted, func.count().label("number")).where(
        POINTS.c.axis_number == axis_number, POINTS.c.uncharted.is_not(None)
    )
    return {row.uncharted: row.number for row in connection.execute(query.group_by(POINTS.c.uncharted))}


def last_points(connection: Connection) -> dict[int, TrendPoint]:
    """Return the newest point of every axis, by its number."""
    axes = AxisRow.metadata.tables[AxisRow.__tablename__]
    same = and_(
        POINTS.c.axis_number == axes.c.number,
        POINTS.c.at == axes.c.last_measured_at,
        POINTS.c.measurement_id == axes.c.last_measurement_id,
    )
    # from the axes outwards: the database would rather pass all points than look up one of each axis
    newest = connection.execute(select(*_COLUMNS).select_from(axes.outerjoin(POINTS, same)))
    return {row.axis_number: TrendPoint(*row) for row in newest if row.axis_number is not None}


def _preloads(*, newest: bool) -> Select[tuple[datetime, float]]:
    searched = select(POINTS.c.at, POINTS.c.preload_n, POINTS.c.epoch).where(
        _OF_AXIS, POINTS.c.at >= bindparam("since")
    )
    nearest = searched.order_by(POINTS.c.at.desc() if newest else POINTS.c.at).limit(MOST_SEARCHED).subquery()
    return (
        select(nearest.c.at, nearest.c.preload_n)
        .where(nearest.c.epoch == bindparam("epoch"), nearest.c.preload_n.is_not(None))
        .order_by(nearest.c.at.desc() if newest else nearest.c.at)
        .limit(bindparam("most"))
    )


_FIRST_PRELOADS, _NEWEST_PRELOADS = _preloads(newest=False), _preloads(newest=True)


def preloads(
    connection: Connection, axis_number: int, epoch: int, since: datetime, limit: int, *, newest: bool
) -> list[float]:
    """Return the first or the newest preloads of an epoch of the charts since a moment, in time order.

    Among the first, or newest, :data:`MOST_SEARCHED` measurements: an axis that is refused for months answers at once.
    """
    values = {"axis": axis_number, "epoch": epoch, "since": since, "most": limit}
    chosen = stored_rows(connection, _NEWEST_PRELOADS if newest else _FIRST_PRELOADS, values)
    return [preload for _, preload in sorted(chosen)]


_COUNTED = _NEWEST_FIRST.limit(bindparam("most")).subquery().c
_COUNTS = select(
    func.count(),
    func.count(_COUNTED.refusal_reason),
    func.count(func.coalesce(_COUNTED.doubt, _COUNTED.places_disagree)),
    func.count() - func.count(_COUNTED.temperature_c),
    func.count() - func.count(_COUNTED.friction_torque_nm),
)


class Quality(NamedTuple):
    """How good the newest measurements are."""

    n: int
    n_refused: int
    n_in_doubt: int
    n_without_temperature: int
    n_without_friction_torque: int


def quality_of_newest(connection: Connection, axis_number: int, most: int) -> Quality | None:
    """Tell how good so many of the newest measurements are; None if nothing was measured yet."""
    quality = Quality._make(*stored_rows(connection, _COUNTS, {"axis": axis_number, "most": most}))
    return quality if quality.n else None
