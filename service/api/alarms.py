"""``/v1/alarms``: what was raised, on what evidence, and what was done about it."""

from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api.access import needs
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.documents.change import NotExamined
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AxisName, Moment, RequestModel, RowId, Text
from service.operations.monitoring.alarms import AlarmView

router = APIRouter(prefix="/v1", tags=["alarms"])

AlarmStatus = Literal["active", "acknowledged", "cleared", "withdrawn"]


class AlarmEventOut(BaseModel):
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


class AlarmOut(BaseModel):
    """An alarm with its evidence, its cause as far as it was examined, and its history."""

    id: int
    axis: str
    measurement_id: int
    kind: str
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


class AlarmsQuery(RequestModel):
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


def alarm_out(view: AlarmView) -> AlarmOut:
    """Return an alarm on the wire."""
    row = view.row
    return AlarmOut(
        id=row.id, axis=row.axis_id, measurement_id=row.measurement_id, kind=row.kind, raised_at=row.raised_at,
        status=row.status, evidence=row.evidence, explanation=row.explanation,
        shelved_until=view.shelved_until,
        events=[
            AlarmEventOut(
                id=e.id, at=e.at, kind=e.kind, old_status=e.old_status, new_status=e.new_status, reason=e.reason,
                who=e.who,
            )
            for e in view.events
        ],
    )  # fmt: skip


@router.get("/alarms", dependencies=[needs(Scope.TRENDS_READ)])
def list_alarms(query: Annotated[AlarmsQuery, Query()], on: Annotated[Services, Depends(services)]) -> AlarmsOut:
    """List alarms, newest first."""
    views = on.alarms.list(query.axis, query.status, query.cursor, query.limit)
    cursor = views[-1].row.id if len(views) == query.limit else None
    return AlarmsOut(alarms=[alarm_out(view) for view in views], next_cursor=cursor)


@router.get("/alarms/{alarm}", dependencies=[needs(Scope.TRENDS_READ)])
def get_alarm(alarm: RowId, on: Annotated[Services, Depends(services)]) -> AlarmOut:
    """Return one alarm."""
    return alarm_out(on.alarms.get(alarm))


@router.post("/alarms/{alarm}/acknowledge", dependencies=[needs(Scope.ALARMS_ACK)])
def acknowledge_alarm(
    alarm: RowId, body: ChangeIn, request: Request, on: Annotated[Services, Depends(services)]
) -> AlarmOut:
    """Say that somebody has seen the alarm. The state of the axis does not change by that."""
    who = request.state.caller.signature
    return alarm_out(on.alarms.acknowledge(alarm, body.comment, who, seen=body.seen_event))


@router.post("/alarms/{alarm}/comment", dependencies=[needs(Scope.ALARMS_ACK)])
def comment_on_alarm(
    alarm: RowId, body: CommentIn, request: Request, on: Annotated[Services, Depends(services)]
) -> AlarmOut:
    """Write something into the history of the alarm; nothing else changes."""
    return alarm_out(on.alarms.comment(alarm, body.comment, request.state.caller.signature))


@router.post("/alarms/{alarm}/shelve", dependencies=[needs(Scope.ALARMS_ACK)])
def shelve_alarm(
    alarm: RowId, body: ShelveIn, request: Request, on: Annotated[Services, Depends(services)]
) -> AlarmOut:
    """Let an open alarm rest: receivers hear nothing of it until then, and then it is back by itself."""
    who = request.state.caller.signature
    return alarm_out(on.alarms.shelve(alarm, body.until, body.comment, who, seen=body.seen_event))


@router.post("/alarms/{alarm}/clear", dependencies=[needs(Scope.ALARMS_ACK)])
def clear_alarm(alarm: RowId, body: ChangeIn, request: Request, on: Annotated[Services, Depends(services)]) -> AlarmOut:
    """Close the alarm after inspection: a new baseline is learnt from here on."""
    return alarm_out(on.alarms.clear(alarm, body.comment, request.state.caller.signature, seen=body.seen_event))


@router.post("/alarms/{alarm}/explanations", status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)])
def explain_alarm(alarm: RowId, response: Response, on: Annotated[Services, Depends(services)]) -> JobOut:
    """Ask in the background which change of the axis explains an open alarm, by its newest measurements."""
    row = on.alarm_explanations.start(alarm)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)
