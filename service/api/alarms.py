"""``/v1/alarms``: what was raised, on what evidence, and what was done about it."""

from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field

from service.api.fields import AxisName, RowId, Text
from service.api.services import Services, services
from service.operations.alarms import AlarmView

router = APIRouter(prefix="/v1", tags=["alarms"])

AlarmStatus = Literal["active", "acknowledged", "cleared"]


class AlarmEventOut(BaseModel):
    """One change of an alarm."""

    at: datetime
    old_status: str | None
    new_status: str
    reason: str


class AlarmOut(BaseModel):
    """An alarm with its evidence and history."""

    id: int
    axis: str
    measurement_id: int
    kind: str
    raised_at: datetime
    status: AlarmStatus
    evidence: dict[str, Any]
    events: list[AlarmEventOut]


class AlarmsOut(BaseModel):
    """Alarms, newest first; `next_cursor` fetches older ones."""

    alarms: list[AlarmOut]
    next_cursor: int | None


class AlarmsQuery(BaseModel):
    """Which alarms."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    axis: AxisName | None = None
    status: AlarmStatus | None = None
    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=200)] = 50


class CommentIn(BaseModel):
    """Why the alarm's status is changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, json_schema_extra={"examples": [{"comment": "nut ordered"}]})

    comment: Text


def alarm_out(view: AlarmView) -> AlarmOut:
    """Return an alarm on the wire."""
    row = view.row
    return AlarmOut(
        id=row.id, axis=row.axis_id, measurement_id=row.measurement_id, kind=row.kind, raised_at=row.raised_at,
        status=row.status, evidence=row.evidence,
        events=[
            AlarmEventOut(at=e.at, old_status=e.old_status, new_status=e.new_status, reason=e.reason)
            for e in view.events
        ],
    )  # fmt: skip


@router.get("/alarms", response_model=AlarmsOut)
def list_alarms(query: Annotated[AlarmsQuery, Query()], on: Annotated[Services, Depends(services)]) -> AlarmsOut:
    """List alarms, newest first."""
    views = on.alarms.list(query.axis, query.status, query.cursor, query.limit)
    cursor = views[-1].row.id if len(views) == query.limit else None
    return AlarmsOut(alarms=[alarm_out(view) for view in views], next_cursor=cursor)


@router.get("/alarms/{alarm}", response_model=AlarmOut)
def get_alarm(alarm: RowId, on: Annotated[Services, Depends(services)]) -> AlarmOut:
    """Return one alarm."""
    return alarm_out(on.alarms.get(alarm))


@router.post("/alarms/{alarm}/acknowledge", response_model=AlarmOut)
def acknowledge_alarm(alarm: RowId, body: CommentIn, on: Annotated[Services, Depends(services)]) -> AlarmOut:
    """Say that somebody has seen the alarm. The state of the axis does not change by that."""
    return alarm_out(on.alarms.acknowledge(alarm, body.comment))


@router.post("/alarms/{alarm}/clear", response_model=AlarmOut)
def clear_alarm(alarm: RowId, body: CommentIn, on: Annotated[Services, Depends(services)]) -> AlarmOut:
    """Close the alarm after inspection: a new baseline is learnt from here on."""
    return alarm_out(on.alarms.clear(alarm, body.comment))
