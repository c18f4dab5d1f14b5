"""Read the points of the trend as they are shown and as they go out: what many rows need, and no more."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import lru_cache
from operator import attrgetter
from typing import NamedTuple

from sqlalchemy import (
    ARRAY,
    BigInteger,
    Connection,
    Select,
    any_,
    bindparam,
    func,
    select,
    tuple_,
    type_coerce,
)

from service.store.tables import microseconds_of, moment_of
from service.store.trend.points import POINTS, Cursor, Span, doubts_of
from service.store.trend.tables import stored_rows


class ShownPoint(NamedTuple):
    """What is shown of a measurement that was judged; its moment as it is stored, since few of many are read as one."""

    at_us: int  # since 1970
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
    friction_torque_nm: float | None
    feature_s2: float | None
    uncharted: str | None
    state: str
    baseline_preload_n: float | None
    doubt: str | None
    feature_scatter_s2: float | None
    learnt_scatter_s2: float | None
    shown_scatter_s2: float | None
    places_disagree: str | None
    frequency_uncertainty_hz: float | None
    expected_frequency_hz: float | None
    expected_frequency_uncertainty_hz: float | None

    @property
    def at(self) -> datetime:
        """When it was measured."""
        return moment_of(self.at_us)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What speaks against its preload: of its own, and of its session."""
        return doubts_of(self.doubt, self.places_disagree)


class ToldColumns(NamedTuple):
    """What goes out of many points: a column of each quantity, since to make an object of each takes longest."""

    at_us: Sequence[int]
    measurement_id: Sequence[int]
    name: Sequence[str]
    position_mm: Sequence[float]
    refusal_reason: Sequence[str | None]
    calibration_id: Sequence[int | None]
    frequency_hz: Sequence[float | None]
    preload_n: Sequence[float | None]
    interval_lower_n: Sequence[float | None]
    interval_upper_n: Sequence[float | None]
    drag_torque_nm: Sequence[float | None]
    friction_torque_nm: Sequence[float | None]
    feature_s2: Sequence[float | None]
    uncharted: Sequence[str | None]
    state: Sequence[str]
    doubt: Sequence[str | None]
    feature_scatter_s2: Sequence[float | None]
    learnt_scatter_s2: Sequence[float | None]
    shown_scatter_s2: Sequence[float | None]
    places_disagree: Sequence[str | None]
    frequency_uncertainty_hz: Sequence[float | None]
    expected_frequency_hz: Sequence[float | None]
    expected_frequency_uncertainty_hz: Sequence[float | None]

    @property
    def at(self) -> list[datetime]:
        """When each was measured."""
        return [moment_of(at_us) for at_us in self.at_us]

    @classmethod
    def of(cls, points: Sequence[ShownPoint]) -> "ToldColumns":
        """Return the columns of points."""
        return cls._of_rows([_TOLD(point) for point in points])

    @classmethod
    def _of_rows(cls, rows: Sequence[Sequence[object]]) -> "ToldColumns":
        return cls._make(zip(*rows, strict=True)) if rows else cls._make(() for _ in cls._fields)


_TOLD = attrgetter(*ToldColumns._fields)
_AT_US = type_coerce(POINTS.c.at, BigInteger)
_ORDER = (POINTS.c.at, POINTS.c.measurement_id)
_KEY = tuple_(_AT_US, POINTS.c.measurement_id)
_CURSOR = tuple_(bindparam("after_us", type_=BigInteger), bindparam("after_id", type_=BigInteger))


def _of_axis(names: Sequence[str]) -> Select[tuple[object, ...]]:
    columns = [_AT_US.label(name) if name == "at_us" else POINTS.c[name] for name in names]
    return select(*columns).where(POINTS.c.axis_number == bindparam("axis"))


#: One parameter for all moments, which SQLite takes as a text in JSON: with one each, to write them out takes longest.
_AT_MOMENTS = {
    "postgresql": _of_axis(ShownPoint._fields)
    .where(any_(bindparam("moments", type_=ARRAY(BigInteger))) == _AT_US)
    .order_by(*_ORDER),
    "sqlite": _of_axis(ShownPoint._fields)
    .where(_AT_US.in_(select(func.json_each(bindparam("moments")).table_valued("value").c.value)))
    .order_by(*_ORDER),
}


@dataclass(frozen=True, slots=True)
class PageOf:
    """Which points are read: those in a span beyond a cursor, so many at most, in time order or newest first."""

    span: Span
    limit: int
    after: Cursor | None = None
    newest_first: bool = False


def page_of_points(connection: Connection, axis_number: int, asked: PageOf) -> list[ShownPoint]:
    """Return a page of the trend point by point."""
    return list(map(ShownPoint._make, _rows(connection, axis_number, asked, ShownPoint._fields)))


def page_of_columns(connection: Connection, axis_number: int, asked: PageOf) -> tuple[ToldColumns, bool]:
    """Return a page of the trend as columns, and whether there is more beyond it."""
    rows = _rows(connection, axis_number, replace(asked, limit=asked.limit + 1), ToldColumns._fields)
    return ToldColumns._of_rows(rows[: asked.limit]), len(rows) > asked.limit


def points_at(connection: Connection, axis_number: int, moments: Iterable[int]) -> list[ShownPoint]:
    """Return the points at these moments, in microseconds since 1970, in time order."""
    database = connection.dialect.name
    listed = sorted(moments)
    values: dict[str, object] = {"axis": axis_number, "moments": json.dumps(listed) if database == "sqlite" else listed}
    return list(map(ShownPoint._make, stored_rows(connection, _AT_MOMENTS[database], values)))


def _rows(connection: Connection, axis_number: int, asked: PageOf, names: tuple[str, ...]) -> list[tuple[object, ...]]:
    start, end, after = asked.span.start, asked.span.end, asked.after
    values = {"axis": axis_number, "most": asked.limit}
    if start is not None:
        values["start"] = microseconds_of(start)
    if end is not None:
        values["end"] = microseconds_of(end)
    if after is not None:
        values |= {"after_us": microseconds_of(after[0]), "after_id": after[1]}
    return stored_rows(connection, _page(names, frozenset(values), asked.newest_first), values)


@lru_cache(maxsize=64)  # to build a statement takes longer than to run it
def _page(names: tuple[str, ...], stated: frozenset[str], newest_first: bool) -> Select[tuple[object, ...]]:
    query = _of_axis(names).limit(bindparam("most"))
    if "start" in stated:
        query = query.where(bindparam("start") <= _AT_US)
    if "end" in stated:
        query = query.where(bindparam("end") > _AT_US)
    if "after_us" in stated:  # a row value, which the key of the table answers; an OR would pass all that came before
        query = query.where(_CURSOR > _KEY if newest_first else _CURSOR < _KEY)
    return query.order_by(*(column.desc() for column in _ORDER)) if newest_first else query.order_by(*_ORDER)
