"""``/v1/alarms``: what was raised, on what evidence, and what was done about it."""

from datetime import datetime
from typing import Annotated, Literal

from fastapi import Query, Response
from fastapi.responses import StreamingResponse
from pydantic import AliasPath, BaseModel, ConfigDict, Field

from service.api.access import CallerOf, needs
from service.api.http.tables import TABLE_RESPONSE, TableQuery, table
from service.api.jobs import JobOut, started
from service.api.services import ServicesOf, api_router
from service.documents.change import NotExamined
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AnswerModel, AxisName, Moment, RequestModel, RowId, Text, ViewModel

router = api_router("alarms")

AlarmStatus = Literal["active", "acknowledged", "cleared", "withdrawn"]


class AlarmEventOut(AnswerModel):
    """One change of an alarm."""

    id: int
    at: datetime
    kind: Annotated[
        Literal["comment", "shelved", "back"] | None,
        Field(description="back: its shelf has ended; null: what the statuses say, or another evidence"),
    ]
    old_status: str | None
    new_status: str
    reason: str
    who: str | None


class MeasuredOut(BaseModel):
    """Measurements that an explanation rests on."""

    n_measurements: int
    first_at: datetime
    last_at: datetime


class ChangeOut(BaseModel):
    """One change that was tried: its size in `unit` as fitted, and how well it explains the measurements."""

    cause: str
    effect: str
    probability: float
    size: float | None
    size_standard_uncertainty: float | None
    unit: str
    delta_bic: float
    gap: float
    sentence: str


class ExaminedOut(BaseModel):
    """Which change of the axis explains the alarm, with the probability that it is the cause."""

    examined: Literal[True]
    at: datetime
    outcome: Literal["named", "equivalent", "none", "unknown"]
    cause: Literal["preload", "payload", "bearing", "position", "sensor", "temperature", "none", "unknown"]
    confidence: float
    sentence: str
    equivalent_to: list[str]
    gap_before: float
    gap_after: float
    changes: list[ChangeOut]
    reference: MeasuredOut
    recent: MeasuredOut


class NotExaminedOut(BaseModel):
    """Why no cause was looked for."""

    examined: Literal[False]
    reason: NotExamined
    sentence: str
    recent: MeasuredOut | None


class AlarmOut(ViewModel):
    """An alarm with its evidence, its cause as far as it was examined, and its history."""

    id: int
    axis: Annotated[str, Field(validation_alias=AliasPath("row", "axis_id"))]
    measurement_id: Annotated[int | None, Field(description="null: of lost motion, which no windows tell")]
    kind: Annotated[str, Field(description="preload-loss, several-numbers or lost-motion")]
    raised_at: datetime
    status: AlarmStatus
    evidence: JsonObject
    explanation: Annotated[ExaminedOut | NotExaminedOut, Field(discriminator="examined")]
    shelved_until: Annotated[datetime | None, Field(description="until then receivers hear nothing of it; null: no")]
    events: list[AlarmEventOut]


class AlarmsOut(BaseModel):
    """Alarms, newest first; `next_cursor` fetches older ones."""

    alarms: list[AlarmOut]
    next_cursor: int | None


class AlarmsQuery(TableQuery):
    """Which alarms."""

    axis: AxisName | None = None
    status: AlarmStatus | None = None
    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=200)] = 50


class CommentIn(RequestModel):
    """What somebody says of an alarm."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": "nut ordered"}]})

    comment: Text


class ChangeIn(CommentIn):
    """Why the alarm's status is changed, and what of it was seen before."""

    seen_event: Annotated[int, Field(ge=0, lt=2**63)] | None = Field(
        default=None, description="number of its newest event that is known here: 409 if somebody changed it since"
    )


class ShelveIn(ChangeIn):
    """Until when an alarm rests, and why."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"until": "2026-12-01T06:00:00Z", "comment": "spare part is ordered"}]}
    )

    until: Moment


@router.get(
    "/alarms", response_model=AlarmsOut, responses={200: TABLE_RESPONSE}, dependencies=[needs(Scope.TRENDS_READ)]
)
def list_alarms(query: Annotated[AlarmsQuery, Query()], services: ServicesOf) -> AlarmsOut | StreamingResponse:
    """List alarms, newest first."""

    def page(query: AlarmsQuery) -> tuple[list[AlarmOut], int | None]:
        views = services.alarms.list(query.axis, query.status, query.cursor, query.limit)
        return [AlarmOut.model_validate(view) for view in views], views[-1].row.id if len(
            views
        ) == query.limit else None

    if query.format is not None:
        return table("alarms", AlarmOut, query, page)
    alarms, cursor = page(query)
    return AlarmsOut(alarms=alarms, next_cursor=cursor)


@router.get("/alarms/{alarm}", dependencies=[needs(Scope.TRENDS_READ)])
def get_alarm(alarm: RowId, services: ServicesOf) -> AlarmOut:
    """Return one alarm."""
    return AlarmOut.model_validate(services.alarms.get(alarm))


@router.post("/alarms/{alarm}/acknowledge", dependencies=[needs(Scope.ALARMS_ACK)])
def acknowledge_alarm(alarm: RowId, body: ChangeIn, who: CallerOf, services: ServicesOf) -> AlarmOut:
    """Say that somebody has seen the alarm. The state of the axis does not change by that."""
    return AlarmOut.model_validate(
        services.alarms.acknowledge(alarm, body.comment, who.signature, seen=body.seen_event)
    )


@router.post("/alarms/{alarm}/comment", dependencies=[needs(Scope.ALARMS_ACK)])
def comment_on_alarm(alarm: RowId, body: CommentIn, who: CallerOf, services: ServicesOf) -> AlarmOut:
    """Write something into the history of the alarm; nothing else changes."""
    return AlarmOut.model_validate(services.alarms.comment(alarm, body.comment, who.signature))


@router.post("/alarms/{alarm}/shelve", dependencies=[needs(Scope.ALARMS_ACK)])
def shelve_alarm(alarm: RowId, body: ShelveIn, who: CallerOf, services: ServicesOf) -> AlarmOut:
    """Let an open alarm rest: receivers hear nothing of it until then, and then it is back by itself."""
    return AlarmOut.model_validate(
        services.alarms.shelve(alarm, body.until, body.comment, who.signature, seen=body.seen_event)
    )


@router.post("/alarms/{alarm}/clear", dependencies=[needs(Scope.ALARMS_ACK)])
def clear_alarm(alarm: RowId, body: ChangeIn, who: CallerOf, services: ServicesOf) -> AlarmOut:
    """Close the alarm after inspection: a new baseline is learnt from here on."""
    return AlarmOut.model_validate(services.alarms.clear(alarm, body.comment, who.signature, seen=body.seen_event))


@router.post("/alarms/{alarm}/explanations", status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)])
def explain_alarm(alarm: RowId, response: Response, services: ServicesOf) -> JobOut:
    """Ask in the background which change of the axis explains an open alarm, by its newest measurements."""
    return started(services.alarm_explanations.start(alarm), response)
