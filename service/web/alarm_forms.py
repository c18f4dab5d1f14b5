"""Forms about alarms: plain POST, then 303 back to the page; the same-origin check is that of the whole service."""

from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request, Response
from pydantic import BaseModel

from service.api.services import Services, services
from service.operations.fields import RowId, Text
from service.web.site import done

router = APIRouter(include_in_schema=False)


class SeenForm(BaseModel):
    """What the page sends."""

    comment: Text = "seen"


@router.post("/alarms/{alarm}/acknowledge")
def acknowledge(
    alarm: RowId, form: Annotated[SeenForm, Form()], request: Request, on: Annotated[Services, Depends(services)]
) -> Response:
    """Note that somebody has seen an alarm, and go back to its axis."""
    view = on.alarms.acknowledge(alarm, form.comment, request.state.caller.signature)
    return done(f"/axes/{view.row.axis_id}", "acknowledged")
