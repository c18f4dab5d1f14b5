"""Read and write what was measured of the lost motion of an axis, and where its chart stands."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, Connection, ScalarSelect, String, and_, delete, insert, select

from service.json_types import JsonObject
from service.store.tables import NullableJson
from service.store.trend.points import Span
from service.store.trend.tables import table_of


@dataclass(frozen=True, slots=True)
class LostMotionReading:
    """Lost motion at the reversals of one log, as it was sent, and what its chart made of it."""

    axis_number: int
    at: datetime
    name: str
    position_mm: float
    reversal_value_um: float
    standard_uncertainty_um: float  # its repeatability
    interval_lower_um: float  # 95 %
    interval_upper_um: float
    play_lower_um: float | None  # 95 % interval of that part of it that is play
    play_upper_um: float | None
    n_reversals: int
    temperature_c: float | None
    uncharted: str | None = None  # why it moved no chart
    state: str = "unknown"  # of the chart, after it
    found_in_order: bool = False  # after it somebody looked, and cleared the alarm: the level is learnt anew

    @property
    def interval_95_um(self) -> tuple[float, float]:
        """Of the reversal value."""
        return self.interval_lower_um, self.interval_upper_um

    @property
    def play_interval_95_um(self) -> tuple[float, float] | None:
        """Of the play; None: not told from wind-up."""
        low, high = self.play_lower_um, self.play_upper_um
        return None if low is None or high is None else (low, high)


@dataclass(frozen=True, slots=True)
class LostMotionChart:
    """Where the chart stands after the last reading."""

    axis_number: int
    state: JsonObject
    place_mm: float | None  # at which it watches


READINGS = table_of(
    "lost_motion", LostMotionReading, key=("axis_number", "at"),
    types={"name": String(200), "uncharted": String(20), "state": String(16)},
)  # fmt: skip
CHARTS = table_of("lost_motion_charts", LostMotionChart, key=("axis_number",), types={"state": NullableJson})
_COLUMNS = [READINGS.c[name] for name in LostMotionReading.__slots__]


def readings_at(connection: Connection, axis_number: int, moments: Collection[datetime]) -> list[LostMotionReading]:
    """Return the readings that were taken at moments."""
    query = select(*_COLUMNS).where(READINGS.c.axis_number == axis_number, READINGS.c.at.in_(moments))
    return [LostMotionReading(*row) for row in connection.execute(query)]


def readings_of(
    connection: Connection, axis_number: int, span: Span, *, after: datetime | None = None,
    limit: int | None = None,
) -> list[LostMotionReading]:  # fmt: skip
    """Return readings of a span in time order, at most so many, those after a moment."""
    of_axis = (READINGS.c.axis_number == axis_number, *span.bounds(READINGS.c.at))
    query = select(*_COLUMNS).where(*of_axis).order_by(READINGS.c.at)
    if after is not None:
        query = query.where(READINGS.c.at > after)
    return [LostMotionReading(*row) for row in connection.execute(query if limit is None else query.limit(limit))]


def newest_reading(connection: Connection, axis_number: int) -> LostMotionReading | None:
    """Return the last reading."""
    query = select(*_COLUMNS).where(READINGS.c.axis_number == axis_number)
    row = connection.execute(query.order_by(READINGS.c.at.desc()).limit(1)).one_or_none()
    return None if row is None else LostMotionReading(*row)


def newest_readings(
    connection: Connection, axis_number: int | None = None
) -> dict[int, tuple[LostMotionReading, datetime | None]]:
    """Return the last reading of one axis or all by number, and when the last was taken that moved the chart."""

    def newest(*those: ColumnElement[bool]) -> ScalarSelect[datetime]:  # by the key, however many there are
        query = select(each.c.at).where(each.c.axis_number == CHARTS.c.axis_number, *those)
        return query.order_by(each.c.at.desc()).limit(1).correlate(CHARTS).scalar_subquery()

    each = READINGS.alias()
    of_axis = and_(READINGS.c.axis_number == CHARTS.c.axis_number, READINGS.c.at == newest())
    query = select(*_COLUMNS, newest(each.c.uncharted.is_(None)).label("charted_at")).select_from(CHARTS)
    if axis_number is not None:
        query = query.where(CHARTS.c.axis_number == axis_number)
    rows = connection.execute(query.join(READINGS, of_axis))
    return {row.axis_number: (LostMotionReading(*row[:-1]), row.charted_at) for row in rows}


def moments_in_order(connection: Connection, axis_number: int) -> list[datetime]:
    """Return when the readings were taken after which somebody found the axis in order, in order of time."""
    query = select(READINGS.c.at).where(READINGS.c.axis_number == axis_number, READINGS.c.found_in_order)
    return list(connection.scalars(query.order_by(READINGS.c.at)))


def save_readings(connection: Connection, axis_number: int, readings: Iterable[LostMotionReading]) -> None:
    """Store readings, new ones and those that are there."""
    for reading in readings:
        connection.execute(delete(READINGS).where(READINGS.c.axis_number == axis_number, READINGS.c.at == reading.at))
        connection.execute(insert(READINGS), {name: getattr(reading, name) for name in LostMotionReading.__slots__})


def read_chart(connection: Connection, axis_number: int) -> LostMotionChart | None:
    """Return where the chart stands; None if nothing was measured yet."""
    query = select(*(CHARTS.c[name] for name in LostMotionChart.__slots__)).where(CHARTS.c.axis_number == axis_number)
    row = connection.execute(query).one_or_none()
    return None if row is None else LostMotionChart(*row)


def all_charts(connection: Connection) -> list[LostMotionChart]:
    """Return where the charts of all axes stand."""
    query = select(*(CHARTS.c[name] for name in LostMotionChart.__slots__))
    return [LostMotionChart(*row) for row in connection.execute(query)]


def save_chart(connection: Connection, chart: LostMotionChart) -> None:
    """Store where the chart stands."""
    connection.execute(delete(CHARTS).where(CHARTS.c.axis_number == chart.axis_number))
    connection.execute(insert(CHARTS), {name: getattr(chart, name) for name in LostMotionChart.__slots__})
