"""``GET /v1/axes/{axis}/trend``: measurements in time order, as points, as columns of numbers, or as a table."""

import hashlib
from collections.abc import Sequence
from datetime import datetime
from functools import partial
from typing import Annotated, Any, Final, Literal

import numpy as np
from fastapi import Query, Request, Response
from pydantic import BaseModel, Field
from pydantic_core import to_json

from monitor_core.recording import DoubtReason
from service.api.access import needs
from service.api.axes import StaleOut
from service.api.http.tables import TABLE_CONTENT, TableQuery, columns_of, table
from service.api.services import Services, ServicesOf, api_router
from service.documents.measurement import ends_of, falls_of
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, Moment
from service.operations.monitoring.extremes import thin_out
from service.operations.monitoring.trend import Only, TrendPage
from service.settings import VERSION
from service.store.rejudged import Stale
from service.store.trend.points import Span
from service.store.trend.shown import ToldColumns

router = api_router("trend")


class TrendPointOut(BaseModel):
    """One measurement: a preload with its 95 % coverage interval, or the reason why there is none."""

    measurement_id: int
    measurement: str
    at: datetime
    position_mm: float
    status: Literal["judged", "refused"]
    frequency_hz: float | None
    preload_n: float | None
    interval_95_n: tuple[float | None, float | None] | None
    friction_torque_nm: Annotated[float | None, Field(description="over all moves: the second, independent indicator")]
    drag_torque_nm: Annotated[float | None, Field(description="of the travels at constant velocity, ISO 3408-3")]
    state: str | None
    refusal_reason: str | None
    uncharted: Annotated[str | None, Field(description="why an accepted measurement moved no chart")]
    calibration: Annotated[int | None, Field(description="by which it was judged")]
    doubt: Annotated[str | None, Field(description="what speaks against the preload; its measurement says it in words")]
    frequency_fall_percent: Annotated[
        float | None, Field(description="without a calibration: below the frequency of the healthy axis there")
    ] = None
    frequency_fall_interval_95_percent: tuple[float | None, float | None] | None = None


class TrendOut(BaseModel):
    """Measurements in time order; `next_cursor` fetches the following page."""

    axis: str
    points: list[TrendPointOut]
    next_cursor: str | None
    stale: Annotated[StaleOut | None, Field(description="while the history is judged anew: by which job")] = None


#: Media type of columns, and how many digits their numbers have: intervals are wider by a thousand times and more.
COLUMNS_TYPE: Final = "application/vnd.preload-monitor.columns+json"
DIGITS: Final = 9
_COLUMNS: Final = columns_of(TrendPointOut)
_KINDS: Final = {int: "integer", float: "number"}
_COLUMNS_SCHEMA: Final[JsonObject] = {
    "type": "object",
    "description": "What TrendOut holds in a third of its size: for each column that a table has a list of its values, "
    f"with numbers of {DIGITS} digits. A list of one value holds it for all measurements.",
    "properties": {
        "axis": {"type": "string"},
        "columns": {
            "type": "object",
            "properties": {
                column.name: {"type": "array", "items": {"type": [_KINDS.get(column.type, "string"), "null"]}}
                for column in _COLUMNS
            },
        },
        "next_cursor": {"type": ["string", "null"]},
        "stale": {"anyOf": [{"$ref": "#/components/schemas/StaleOut"}, {"type": "null"}]},
    },
}
_ANSWERS: Final[JsonObject] = {"content": {**TABLE_CONTENT, COLUMNS_TYPE: {"schema": _COLUMNS_SCHEMA}}}


class TrendQuery(TableQuery):
    """Which part of the trend, and how finely."""

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    max_points: Annotated[int, Field(ge=2, le=10_000)] | None = Field(
        default=None, description="resolution: of each stretch of a page the lowest and the highest preload are kept"
    )
    resolution: Annotated[int, Field(ge=2, le=10_000)] | None = Field(
        default=None,
        description="so many points at most over the whole span, however long: of each stretch of it the extremes, "
        "without preloads that were set on purpose",
    )
    order: Literal["oldest-first", "newest-first"] = "oldest-first"
    only: Only | None = Field(
        default=None, description="refused ones, or those in doubt; a page may hold few and still have a next_cursor"
    )
    cursor: Annotated[str, Field(max_length=200)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=10_000)] = 1000
    form: Literal["points", "columns"] = Field(
        default="points", description="columns: a list for each member in place of an object for each measurement"
    )


@router.get(
    "/axes/{axis}/trend",
    response_model=TrendOut,
    responses={200: _ANSWERS, 304: {"description": "not modified"}},
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_trend(axis: AxisId, query: Annotated[TrendQuery, Query()], request: Request, services: ServicesOf) -> Response:
    """Return the trend of an axis, refused measurements included."""
    if query.format is not None:
        return table(f"{axis}-trend", TrendPointOut, query, partial(_records, axis, services))
    seen = _etags(request.headers.get("if-none-match", ""))
    if seen and (etag := _etag(query, *services.trend.revision(axis))) in seen:
        return Response(status_code=304, headers={"ETag": etag})
    page = _page(axis, services, query)
    columns = _columns(page.points, at=_written(page.points.at_us))
    told, media_type = (
        (_points(columns), "application/json") if query.form == "points" else (_shortened(columns), COLUMNS_TYPE)
    )
    out = {"axis": axis, query.form: told, "next_cursor": page.next_cursor, "stale": page.stale}
    content = to_json(out, inf_nan_mode="null")  # without a model: to make one of each point takes twice as long as all
    return Response(content, media_type=media_type, headers={"ETag": _etag(query, page.revision, page.stale)})


#: Values of all measurements by the name of a column, as a table has it.
Columns = dict[str, Sequence[Any]]


def _written(at_us: Sequence[int]) -> list[str]:
    """Return moments as JSON has them: whole seconds without a fraction, as pydantic writes them."""
    moments = np.array(at_us, dtype="datetime64[us]")
    return [text.replace(".000000", "") for text in np.datetime_as_string(moments, timezone="UTC").tolist()]


def _columns(told: ToldColumns, at: Sequence[datetime | str]) -> Columns:
    of_session, (lower, upper) = str(DoubtReason.PLACES_DISAGREE), ends_of(told)
    fall, least, most = falls_of(told)
    return {
        "measurement_id": told.measurement_id,
        "measurement": told.name,
        "at": at,
        "position_mm": told.position_mm,
        "status": ["judged" if reason is None else "refused" for reason in told.refusal_reason],
        "frequency_hz": told.frequency_hz,
        "preload_n": told.preload_n,
        "interval_95_n.lower": lower,
        "interval_95_n.upper": upper,
        "friction_torque_nm": told.friction_torque_nm,
        "drag_torque_nm": told.drag_torque_nm,
        "state": told.state,
        "refusal_reason": told.refusal_reason,
        "uncharted": told.uncharted,
        "calibration": told.calibration_id,
        "doubt": [
            own or (None if places is None else of_session)
            for own, places in zip(told.doubt, told.places_disagree, strict=True)
        ],
        "frequency_fall_percent": fall,
        "frequency_fall_interval_95_percent.lower": least,
        "frequency_fall_interval_95_percent.upper": most,
    }


def _points(columns: Columns) -> list[dict[str, object]]:
    """Return what each measurement is told by: the members of TrendPointOut."""
    for interval, of in (
        ("interval_95_n", "preload_n"),
        ("frequency_fall_interval_95_percent", "frequency_fall_percent"),
    ):
        ends = zip(columns.pop(f"{interval}.lower"), columns.pop(f"{interval}.upper"), strict=True)
        columns[interval] = [None if value is None else both for value, both in zip(columns[of], ends, strict=True)]
    values = [columns[name] for name in TrendPointOut.model_fields]
    return [dict(zip(TrendPointOut.model_fields, row, strict=True)) for row in zip(*values, strict=True)]


def _shortened(columns: Columns) -> Columns:
    """Return columns with few digits, and one value alone where it is that of all measurements."""
    shortened = dict[str, Sequence[Any]]()
    for column in _COLUMNS:
        values = columns[column.name]
        if len(values) > 1 and values[0] == values[-1] and values.count(values[0]) == len(values):
            values = values[:1]
        shortened[column.name] = rounded(values) if column.type is float else values
    return shortened


#: Up to 10^22 they are exact, so that what is divided by one is the double nearest to a number of so many digits.
_POWERS: Final = np.array([float(f"1e{exponent}") for exponent in range(23)])


def rounded(values: Sequence[float | None]) -> list[float]:
    """Return numbers to so many digits, None as NaN; very small and very large ones stay as they are."""
    numbers = np.array(values, dtype=np.float64)
    within = (np.abs(numbers) > 10.0 ** (DIGITS - 22)) & (np.abs(numbers) < 10.0**DIGITS)
    scale = _POWERS[DIGITS - 1 - np.floor(np.log10(np.abs(numbers[within]))).astype(int)]
    numbers[within] = np.rint(numbers[within] * scale) / scale
    return list(numbers.tolist())


def _records(axis: str, services: Services, query: TrendQuery) -> tuple[list[dict[str, object]], str | None]:
    page = _page(axis, services, query)
    return _points(_columns(page.points, at=page.points.at)), page.next_cursor


def _page(axis: str, services: Services, query: TrendQuery) -> TrendPage[ToldColumns]:
    span, newest_first = Span(query.start, query.end), query.order == "newest-first"
    if query.resolution is not None:
        page = services.trend.at_resolution(axis, span, query.resolution)
        points = page.points[::-1] if newest_first else page.points
    elif query.only is None and query.max_points is None:
        return services.trend.told(axis, span, cursor=query.cursor, limit=query.limit, newest_first=newest_first)
    else:
        page = services.trend.page(
            axis, span, cursor=query.cursor, limit=query.limit, newest_first=newest_first, only=query.only
        )
        points = thin_out(page.points, query.limit if query.max_points is None else query.max_points)
    return TrendPage(ToldColumns.of(points), page.next_cursor, page.revision, page.stale)


def _etag(query: TrendQuery, revision: int, stale: Stale | None) -> str:
    asked = f"{VERSION} {query.model_dump_json()} {stale}"
    return f'"{revision}-{hashlib.sha256(asked.encode()).hexdigest()[:16]}"'


def _etags(header: str) -> list[str]:
    return [item.strip().removeprefix("W/") for item in header.split(",") if header]
