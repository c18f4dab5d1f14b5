"""Read and write lost motion and torque of an axis, each quantity with a chart of its own.

The tables are called after the first of them, lost motion; torque has others.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from sqlalchemy import ColumnElement, Connection, ScalarSelect, String, and_, delete, insert, select

from service.json_types import JsonObject
from service.store.tables import NullableJson
from service.store.trend.points import Span
from service.store.trend.tables import table_of

#: The quantities, by the sign that lets them rise as the axis gets worse.
LOST_MOTION: Final = "lost-motion"
SIGNS: Final = {LOST_MOTION: 1.0, "drag-torque": -1.0, "screw-order": 1.0, "ball-pass-order": 1.0}


@dataclass(frozen=True, slots=True)
class ChartedReading:
    """One number of one log, as it was sent, and what its chart made of it."""

    axis_number: int
    quantity: str
    at: datetime
    name: str
    position_mm: float
    value: float
    standard_uncertainty: float  # its repeatability
    interval_lower: float  # 95 %
    interval_upper: float
    unit: str
    play_lower_um: float | None  # of lost motion the 95 % interval of that part of it that is play
    play_upper_um: float | None
    n_repeats: int  # reversals, travels or stretches
    temperature_c: float | None
    uncharted: str | None = None  # why it moved no chart
    state: str = "unknown"  # of the chart, after it
    found_in_order: bool = False  # after it somebody looked, and cleared the alarm: the level is learnt anew
    speed_mm_per_s: float | None = None  # of the strokes; lost motion has none

    @property
    def interval_95(self) -> tuple[float, float]:
        """Of the value."""
        return self.interval_lower, self.interval_upper

    @property
    def play_interval_95_um(self) -> tuple[float, float] | None:
        """Of the play; None: not told from wind-up."""
        low, high = self.play_lower_um, self.play_upper_um
        return None if low is None or high is None else (low, high)


@dataclass(frozen=True, slots=True)
class ReadingChart:
    """Where the chart of a quantity stands after the last reading."""

    axis_number: int
    quantity: str
    state: JsonObject
    place_mm: float | None  # at which it watches
    speed_mm_per_s: float | None = None


READINGS = table_of(
    "lost_motion", ChartedReading, key=("axis_number", "quantity", "at"),
    types={
        "quantity": String(20), "name": String(200), "unit": String(8), "uncharted": String(20), "state": String(16),
    },
)  # fmt: skip
CHARTS = table_of(
    "lost_motion_charts", ReadingChart, key=("axis_number", "quantity"),
    types={"quantity": String(20), "state": NullableJson},
)  # fmt: skip
_COLUMNS = [READINGS.c[name] for name in ChartedReading.__slots__]


def _of(axis_number: int, quantity: str) -> ColumnElement[bool]:
    return and_(READINGS.c.axis_number == axis_number, READINGS.c.quantity == quantity)


def readings_at(
    connection: Connection, axis_number: int, quantity: str, moments: Collection[datetime]
) -> list[ChartedReading]:
    """Return the readings that were taken at moments."""
    query = select(*_COLUMNS).where(_of(axis_number, quantity), READINGS.c.at.in_(moments))
    return [ChartedReading(*row) for row in connection.execute(query)]


def readings_of(
    connection: Connection, axis_number: int, quantity: str, span: Span, *, after: datetime | None = None,
    limit: int | None = None,
) -> list[ChartedReading]:  # fmt: skip
    """Return readings of a span in time order, at most so many, those after a moment."""
    query = select(*_COLUMNS).where(_of(axis_number, quantity), *span.bounds(READINGS.c.at)).order_by(READINGS.c.at)
    if after is not None:
        query = query.where(READINGS.c.at > after)
    return [ChartedReading(*row) for row in connection.execute(query if limit is None else query.limit(limit))]


def newest_reading(connection: Connection, axis_number: int, quantity: str) -> ChartedReading | None:
    """Return the last reading."""
    query = select(*_COLUMNS).where(_of(axis_number, quantity))
    row = connection.execute(query.order_by(READINGS.c.at.desc()).limit(1)).one_or_none()
    return None if row is None else ChartedReading(*row)


def newest_readings(
    connection: Connection, axis_number: int | None = None, quantity: str = LOST_MOTION
) -> dict[int, tuple[ChartedReading, datetime | None]]:
    """Return the last reading of one axis or all by number, and when the last was taken that moved the chart."""

    def newest(*those: ColumnElement[bool]) -> ScalarSelect[datetime]:  # by the key, however many there are
        of_chart = (each.c.axis_number == CHARTS.c.axis_number, each.c.quantity == CHARTS.c.quantity)
        query = select(each.c.at).where(*of_chart, *those)
        return query.order_by(each.c.at.desc()).limit(1).correlate(CHARTS).scalar_subquery()

    each = READINGS.alias()
    of_axis = and_(
        READINGS.c.axis_number == CHARTS.c.axis_number,
        READINGS.c.quantity == CHARTS.c.quantity,
        READINGS.c.at == newest(),
    )
    query = select(*_COLUMNS, newest(each.c.uncharted.is_(None)).label("charted_at")).select_from(CHARTS)
    query = query.where(CHARTS.c.quantity == quantity)
    if axis_number is not None:
        query = query.where(CHARTS.c.axis_number == axis_number)
    rows = connection.execute(query.join(READINGS, of_axis))
    return {row.axis_number: (ChartedReading(*row[:-1]), row.charted_at) for row in rows}


def moments_in_order(connection: Connection, axis_number: int, quantity: str) -> list[datetime]:
    """Return when the readings were taken after which somebody found the axis in order, in order of time."""
    query = select(READINGS.c.at).where(_of(axis_number, quantity), READINGS.c.found_in_order)
    return list(connection.scalars(query.order_by(READINGS.c.at)))


def save_readings(connection: Connection, axis_number: int, readings: Iterable[ChartedReading]) -> None:
    """Store readings, new ones and those that are there."""
    for reading in readings:
        connection.execute(delete(READINGS).where(_of(axis_number, reading.quantity), READINGS.c.at == reading.at))
        connection.execute(insert(READINGS), {name: getattr(reading, name) for name in ChartedReading.__slots__})


def read_chart(connection: Connection, axis_number: int, quantity: str) -> ReadingChart | None:
    """Return where the chart stands; None if nothing was measured yet."""
    charts = charts_of(connection, CHARTS.c.axis_number == axis_number, CHARTS.c.quantity == quantity)
    return charts[0] if charts else None


def charts_of(connection: Connection, *those: ColumnElement[bool]) -> list[ReadingChart]:
    """Return where charts stand, of all axes or of those that are meant."""
    query = select(*(CHARTS.c[name] for name in ReadingChart.__slots__)).where(*those)
    return [ReadingChart(*row) for row in connection.execute(query)]


def save_chart(connection: Connection, chart: ReadingChart) -> None:
    """Store where the chart stands."""
    of_chart = (CHARTS.c.axis_number == chart.axis_number, CHARTS.c.quantity == chart.quantity)
    connection.execute(delete(CHARTS).where(*of_chart))
    connection.execute(insert(CHARTS), {name: getattr(chart, name) for name in ReadingChart.__slots__})
