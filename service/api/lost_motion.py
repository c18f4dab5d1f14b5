"""``/v1/axes/{axis}/lost-motion`` and ``…/torque``: what is charted apart from the preload, and how it stands."""

from collections.abc import Sequence
from datetime import datetime
from typing import Annotated, Literal

from fastapi import Query
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from service.api.access import needs
from service.api.http.tables import TABLE_RESPONSE, TableQuery, table
from service.api.services import ServicesOf, api_router
from service.documents.said import in_english
from service.operations.access.scopes import Scope
from service.operations.fields import AnswerModel, AxisId, Moment, RequestModel
from service.operations.monitoring.lost_motion import EXAMPLE, MOST_AT_ONCE, LostMotionIn, TorqueIn, TorqueQuantity
from service.store.trend.points import Span

router = api_router("lost motion")


class LostMotionsIn(RequestModel):
    """Readings of an axis, in any order."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"readings": [EXAMPLE]}]})

    readings: Annotated[list[LostMotionIn], Field(min_length=1, max_length=MOST_AT_ONCE)]


class LostMotionReceipt(BaseModel):
    """How many readings are new, and how many were there already; and how the axis stands with them."""

    accepted: int
    already_there: int
    state: str
    sentence: str


class LostMotionPointOut(AnswerModel):
    """Lost motion at the reversals of one log."""

    at: datetime
    measurement: Annotated[str, Field(validation_alias="name")]
    position_mm: float
    reversal_value_um: Annotated[float, Field(validation_alias="value")]
    reversal_value_standard_uncertainty_um: Annotated[float, Field(validation_alias="standard_uncertainty")]
    reversal_value_interval_95_um: Annotated[tuple[float, float], Field(validation_alias="interval_95")]
    play_interval_95_um: Annotated[
        tuple[float, float] | None, Field(description="of that part of it that is play; null: not told from wind-up")
    ]
    n_reversals: Annotated[int, Field(validation_alias="n_repeats")]
    temperature_c: float | None
    state: Annotated[str, Field(description="of the chart of lost motion, after it")]
    uncharted: Annotated[
        Literal["other-place"] | None,
        Field(description="why it moved no chart: another place than that of the first is not comparable"),
    ]


class LostMotionOut(BaseModel):
    """Readings in time order, and how lost motion stands now; `next_cursor` fetches the following page."""

    axis: str
    state: Annotated[str, Field(description="unknown: not measured, or not lately")]
    since: datetime | None
    sentence: str
    watched_at_mm: Annotated[float | None, Field(description="place of the first reading, the one that is watched")]
    baseline_um: Annotated[float | None, Field(description="null while it is learnt")]
    prediction_interval_95_um: Annotated[
        tuple[float, float] | None, Field(description="in which one more healthy session is expected")
    ]
    false_alarms_per_year: Annotated[float, Field(description="of lost motion, as stated for each chart of the axis")]
    points: list[LostMotionPointOut]
    next_cursor: datetime | None


class ReadingQuery(RequestModel):
    """Which part of the readings."""

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    cursor: Moment | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=10_000)] = 1000


class LostMotionQuery(ReadingQuery, TableQuery):
    """Which part of the readings, and in which form."""


class TorquesIn(RequestModel):
    """Readings of the torque of an axis, in any order."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "readings": [
                        {
                            "at": "2026-11-02T06:00:00Z", "measurement": "warm-up", "position_mm": 300.0,
                            "speed_mm_per_s": 50.0, "quantity": "drag-torque", "value": 0.812, "unit": "N·m",
                            "standard_uncertainty": 0.004, "interval_95": [0.804, 0.820], "n_repeats": 4,
                        }
                    ]
                }
            ]
        }
    )  # fmt: skip

    readings: Annotated[list[TorqueIn], Field(min_length=1, max_length=MOST_AT_ONCE)]


class TorqueReceipt(BaseModel):
    """How many readings are new, and how many were there already."""

    accepted: int
    already_there: int


class TorquePointOut(AnswerModel):
    """Drag torque or an order's amplitude of one log."""

    at: datetime
    measurement: Annotated[str, Field(validation_alias="name")]
    position_mm: float
    value: float
    unit: str
    standard_uncertainty: float
    interval_95: tuple[float, float]
    n_repeats: int
    temperature_c: float | None
    state: Annotated[str, Field(description="of the chart of this quantity, after it")]
    uncharted: Literal["other-place", "other-speed"] | None
    speed_mm_per_s: float


class TorqueOut(BaseModel):
    """Readings of one quantity in time order, and how it stands now; `next_cursor` fetches the following page."""

    axis: str
    quantity: TorqueQuantity
    state: Annotated[str, Field(description="unknown: not measured, or not lately; it raises no alarm of its own")]
    since: datetime | None
    sentence: str
    watched_at_mm: float | None
    watched_at_mm_per_s: float | None
    baseline: Annotated[float | None, Field(description="null while it is learnt")]
    prediction_interval_95: Annotated[
        tuple[float, float] | None, Field(description="in which one more healthy session is expected")
    ]
    false_alarms_per_year: Annotated[float, Field(description="of this quantity, as stated for each chart of the axis")]
    points: list[TorquePointOut]
    next_cursor: datetime | None


@router.post("/axes/{axis}/lost-motion", dependencies=[needs(Scope.WINDOWS_WRITE)])
def post_lost_motion(axis: AxisId, body: LostMotionsIn, services: ServicesOf) -> LostMotionReceipt:
    """Take lost motion as `preload lost-motion` measures it; a reading that is sent once more changes nothing."""
    taken = services.readings.take(axis, body.readings)
    standing = services.readings.standing(axis)
    return LostMotionReceipt(
        accepted=taken.accepted, already_there=taken.already_there, state=standing.state,
        sentence=in_english(standing.sentence),
    )  # fmt: skip


@router.get(
    "/axes/{axis}/lost-motion",
    response_model=LostMotionOut,
    responses={200: TABLE_RESPONSE},
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_lost_motion(
    axis: AxisId, query: Annotated[LostMotionQuery, Query()], services: ServicesOf
) -> LostMotionOut | StreamingResponse:
    """Return what was measured of the lost motion of an axis, and how it stands."""

    def page(query: LostMotionQuery) -> tuple[Sequence[LostMotionPointOut], datetime | None]:
        span = Span(query.start, query.end)
        readings = services.readings.page(axis, span, after=query.cursor, limit=query.limit)
        return [LostMotionPointOut.model_validate(reading) for reading in readings], readings[-1].at if len(
            readings
        ) == query.limit else None

    if query.format is not None:
        return table(f"{axis}-lost-motion", LostMotionPointOut, query, page)
    standing = services.readings.standing(axis)
    points, cursor = page(query)
    return LostMotionOut(
        axis=axis,
        state=standing.state,
        since=standing.since,
        sentence=in_english(standing.sentence),
        watched_at_mm=standing.place_mm,
        baseline_um=standing.baseline,
        prediction_interval_95_um=standing.baseline_interval_95,
        false_alarms_per_year=standing.false_alarms_per_year,
        points=list(points),
        next_cursor=cursor,
    )


@router.post("/axes/{axis}/torque", dependencies=[needs(Scope.WINDOWS_WRITE)])
def post_torque(axis: AxisId, body: TorquesIn, services: ServicesOf) -> TorqueReceipt:
    """Take what `preload torque` measures; a reading that is sent once more changes nothing."""
    taken = services.readings.take(axis, body.readings)
    return TorqueReceipt(accepted=taken.accepted, already_there=taken.already_there)


@router.get("/axes/{axis}/torque/{quantity}", dependencies=[needs(Scope.TRENDS_READ)])
def get_torque(
    axis: AxisId, quantity: TorqueQuantity, query: Annotated[ReadingQuery, Query()], services: ServicesOf
) -> TorqueOut:
    """Return drag torque or the amplitude of an order, and how it stands."""
    span = Span(query.start, query.end)
    readings = services.readings.page(axis, span, after=query.cursor, limit=query.limit, quantity=quantity)
    standing = services.readings.standing(axis, quantity)
    return TorqueOut(
        axis=axis,
        quantity=quantity,
        state=standing.state,
        since=standing.since,
        sentence=in_english(standing.sentence),
        watched_at_mm=standing.place_mm,
        watched_at_mm_per_s=standing.speed_mm_per_s,
        baseline=standing.baseline,
        prediction_interval_95=standing.baseline_interval_95,
        false_alarms_per_year=standing.false_alarms_per_year,
        points=[TorquePointOut.model_validate(reading) for reading in readings],
        next_cursor=readings[-1].at if len(readings) == query.limit else None,
    )


@router.post("/axes/{axis}/torque/{quantity}/found-in-order", dependencies=[needs(Scope.ALARMS_ACK)], status_code=204)
def find_in_order(axis: AxisId, quantity: TorqueQuantity, services: ServicesOf) -> None:
    """Say that the axis was looked at and found in order: the level of this quantity is learnt anew."""
    services.readings.find_in_order(axis, quantity)
