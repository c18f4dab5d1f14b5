"""``GET /v1/axes/{axis}/trend`` and single measurements with the evidence behind their value."""

import hashlib
from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, Field

from service.api.fields import AxisId, RequestModel, RowId
from service.api.services import Services, services
from service.json_types import JsonObject
from service.operations.fields import Moment
from service.operations.monitoring.trend import thin_out
from service.store.tables import MeasurementRow

router = APIRouter(prefix="/v1", tags=["trend"])


class TrendPoint(BaseModel):
    """One measurement: a preload with its 95 % coverage interval, or the reason why there is none."""

    measurement_id: int
    measurement: str
    at: datetime
    position_mm: float
    status: Literal["judged", "refused"]
    frequency_hz: float | None
    preload_n: float | None
    interval_95_n: tuple[float | None, float | None] | None
    drag_torque_nm: Annotated[float | None, Field(description="the second, independent indicator")]
    state: str | None
    refusal_reason: str | None


class TrendOut(BaseModel):
    """Measurements in time order; `next_cursor` fetches the following page."""

    axis: str
    points: list[TrendPoint]
    next_cursor: str | None


class WindowEntry(BaseModel):
    """A window of a measurement and whether it was accepted."""

    started_at: datetime
    refusal_reason: str | None
    refusal_detail: str | None


class MeasurementOut(BaseModel):
    """One measurement: the whole outcome, its windows, and the frequency response in the band."""

    measurement_id: int
    measurement: str
    at: datetime
    status: str
    outcome: JsonObject | None
    windows: list[WindowEntry]
    response: JsonObject | None


class TrendQuery(RequestModel):
    """Which part of the trend, and how finely."""

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    max_points: Annotated[int, Field(ge=2, le=10_000)] | None = Field(
        default=None, description="resolution: of each stretch of a page the lowest and the highest preload are kept"
    )
    cursor: Annotated[str, Field(max_length=200)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=10_000)] = 1000


def trend_point(row: MeasurementRow) -> TrendPoint:
    """Return a measurement as a point of the trend."""
    return TrendPoint(
        measurement_id=row.id,
        measurement=row.name,
        at=row.started_at,
        position_mm=row.position_mm,
        status=row.status,
        frequency_hz=row.frequency_hz,
        preload_n=row.preload_n,
        interval_95_n=None if row.preload_n is None else (row.interval_lower_n, row.interval_upper_n),
        drag_torque_nm=(row.outcome or {}).get("drag_torque_nm"),
        state=row.monitor_state,
        refusal_reason=row.refusal_reason,
    )


@router.get("/axes/{axis}/trend", response_model=TrendOut, responses={304: {"description": "not modified"}})
def get_trend(
    axis: AxisId, query: Annotated[TrendQuery, Query()], request: Request, on: Annotated[Services, Depends(services)]
) -> Response:
    """Return the trend of an axis, refused measurements included."""
    page = on.trend.page(axis, start=query.start, end=query.end, cursor=query.cursor, limit=query.limit)
    rows = page.measurements if query.max_points is None else thin_out(page.measurements, query.max_points)
    out = TrendOut(axis=axis, points=[trend_point(row) for row in rows], next_cursor=page.next_cursor)
    content = out.model_dump_json().encode()
    etag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    if etag in _etags(request.headers.get("if-none-match", "")):
        return Response(status_code=304, headers={"ETag": etag})
    return Response(content, media_type="application/json", headers={"ETag": etag})


def _etags(header: str) -> list[str]:
    return [item.strip().removeprefix("W/") for item in header.split(",")]


@router.get("/axes/{axis}/measurements/{measurement}", response_model=MeasurementOut)
def get_measurement(axis: AxisId, measurement: RowId, on: Annotated[Services, Depends(services)]) -> MeasurementOut:
    """Return one measurement with everything its value rests on."""
    row, windows = on.trend.measurement(axis, measurement)
    return MeasurementOut(
        measurement_id=row.id,
        measurement=row.name,
        at=row.started_at,
        status=row.status,
        outcome=row.outcome,
        windows=[
            WindowEntry(started_at=w.started_at, refusal_reason=w.refusal_reason, refusal_detail=w.refusal_detail)
            for w in windows
        ],
        response=row.response,
    )
