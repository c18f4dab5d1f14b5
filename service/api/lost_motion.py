"""``/v1/axes/{axis}/lost-motion``: what an axis loses where it turns back, and how that stands."""

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
from service.operations.monitoring.lost_motion import EXAMPLE, MOST_AT_ONCE, LostMotionIn
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
    reversal_value_um: float
    reversal_value_standard_uncertainty_um: Annotated[float, Field(validation_alias="standard_uncertainty_um")]
    reversal_value_interval_95_um: Annotated[tuple[float, float], Field(validation_alias="interval_95_um")]
    play_interval_95_um: Annotated[
        tuple[float, float] | None, Field(description="of that part of it that is play; null: not told from wind-up")
    ]
    n_reversals: int
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


class LostMotionQuery(TableQuery):
    """Which part of the readings."""

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    cursor: Moment | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=10_000)] = 1000


@router.post("/axes/{axis}/lost-motion", dependencies=[needs(Scope.WINDOWS_WRITE)])
def post_lost_motion(axis: AxisId, body: LostMotionsIn, services: ServicesOf) -> LostMotionReceipt:
    """Take lost motion as `preload lost-motion` measures it; a reading that is sent once more changes nothing."""
    taken = services.lost_motion.take(axis, body.readings)
    standing = services.lost_motion.standing(axis)
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
        readings = services.lost_motion.page(axis, span, after=query.cursor, limit=query.limit)
        return [LostMotionPointOut.model_validate(reading) for reading in readings], readings[-1].at if len(
            readings
        ) == query.limit else None

    if query.format is not None:
        return table(f"{axis}-lost-motion", LostMotionPointOut, query, page)
    standing = services.lost_motion.standing(axis)
    points, cursor = page(query)
    return LostMotionOut(
        axis=axis,
        state=standing.state,
        since=standing.since,
        sentence=in_english(standing.sentence),
        watched_at_mm=standing.place_mm,
        baseline_um=standing.baseline_um,
        prediction_interval_95_um=standing.baseline_interval_95_um,
        false_alarms_per_year=standing.false_alarms_per_year,
        points=list(points),
        next_cursor=cursor,
    )
