"""Forms about alarms: plain POST, then 303 back to the page; the same-origin check is that of the whole service."""

from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Form, Request, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import Services, services
from service.errors import InvalidRequestError
from service.operations.access.scopes import Scope
from service.operations.fields import RowId, Text
from service.web.forms import MomentText, moment_of
from service.web.site import done

router = APIRouter(include_in_schema=False)

_SeenEvent = Annotated[int, Field(ge=0, lt=2**63)] | None


class SeenForm(BaseModel):
    """That somebody has seen it, and from which page."""

    comment: Text = "seen"
    seen_event: _SeenEvent = None
    back: Literal["axis", "alarm", "alarms"] = "axis"


class CommentForm(BaseModel):
    """What somebody says of it."""

    comment: Text


class ChangeForm(CommentForm):
    """Why it is changed, and the newest event that the page showed."""

    seen_event: _SeenEvent = None


class ShelveForm(ChangeForm):
    """Until when it rests, in a zone."""

    until: MomentText
    zone: Annotated[str, Field(max_length=60)] = "UTC"


@router.post("/alarms/{alarm}/acknowledge", dependencies=[needs(Scope.ALARMS_ACK)])
def acknowledge(
    alarm: RowId, form: Annotated[SeenForm, Form()], request: Request, on: Annotated[Services, Depends(services)]
) -> Response:
    """Note that somebody has seen an alarm, and go back to where it was said."""
    view = on.alarms.acknowledge(alarm, form.comment, request.state.caller.signature, seen=form.seen_event)
    path = {"axis": f"/axes/{view.row.axis_id}", "alarm": f"/alarms/{alarm}", "alarms": "/alarms"}[form.back]
    return done(path, "acknowledged")


@router.post("/alarms/{alarm}/comment", dependencies=[needs(Scope.ALARMS_ACK)])
def comment(
    alarm: RowId, form: Annotated[CommentForm, Form()], request: Request, on: Annotated[Services, Depends(services)]
) -> Response:
    """Keep what somebody says of an alarm."""
    on.alarms.comment(alarm, form.comment, request.state.caller.signature)
    return done(f"/alarms/{alarm}", "commented")


@router.post("/alarms/{alarm}/shelve", dependencies=[needs(Scope.ALARMS_ACK)])
def shelve(
    alarm: RowId, form: Annotated[ShelveForm, Form()], request: Request, on: Annotated[Services, Depends(services)]
) -> Response:
    """Let an alarm rest until a moment."""
    until = moment_of(form.until, form.zone)
    if until is None:
        raise InvalidRequestError("until: expected the moment until which the alarm rests; got none")
    on.alarms.shelve(alarm, until, form.comment, request.state.caller.signature, seen=form.seen_event)
    return done(f"/alarms/{alarm}", "shelved")


@router.post("/alarms/{alarm}/clear", dependencies=[needs(Scope.ALARMS_ACK)])
def clear(
    alarm: RowId, form: Annotated[ChangeForm, Form()], request: Request, on: Annotated[Services, Depends(services)]
) -> Response:
    """Close an alarm: what is now becomes normal."""
    on.alarms.clear(alarm, form.comment, request.state.caller.signature, seen=form.seen_event)
    return done(f"/alarms/{alarm}", "cleared")
