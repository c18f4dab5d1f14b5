"""``/axes/{axis}/stored``: judge a stored period again, by this calibration or another one, and keep periods."""

from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import ServicesOf
from service.errors import InvalidRequestError
from service.operations import retention
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, RowId, Text
from service.operations.monitoring.rejudgements import RejudgementIn
from service.operations.monitoring.replay import ReplayIn
from service.operations.retention import Reason
from service.web.forms import SpanForm, number_of
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)

_MOST_PINS = 100


class RejudgeForm(SpanForm):
    """By which calibration which part is judged again; ``let_it_stand`` replaces the history, else it is compared."""

    calibration: Annotated[int, Field(ge=1, lt=2**63)]
    in_force: Annotated[str, Field(max_length=30)]
    let_it_stand: bool = False
    reason: Text = "the history was judged anew"


class ReplayForm(BaseModel):
    """Which recorded session is replayed, and how many times as fast as it was recorded; empty: as fast as it goes."""

    session: Annotated[str, Field(max_length=100)]
    speed: Annotated[str, Field(max_length=40)] = ""


class PinForm(SpanForm):
    """Which part is kept, and why."""

    reason: Text


class UnpinForm(BaseModel):
    """Which pin is removed."""

    pin: RowId


@router.get("/axes/{axis}/stored", dependencies=[needs(Scope.TRENDS_READ)])
def stored_page(axis: AxisId, page: PageOf, on: ServicesOf) -> Response:
    """Show what can be judged again and what is kept."""
    overview = on.calibrations.overview(axis)
    ends = on.trend.ends(axis)
    return page.show(
        "axis_stored.html",
        axis=on.axes.get(axis),
        calibrations=overview.calibrations,
        in_force=overview.active,
        measured=None if ends is None else (ends[0].at, ends[1].at),
        pins=retention.list_pins(on.database, axis, None, _MOST_PINS),
        rule=on.surveys.rule,
        sessions=on.replays.sessions(),
    )


@router.post("/axes/{axis}/stored/replays", dependencies=[needs(Scope.REPLAYS_RUN)])
def replay(axis: AxisId, form: Annotated[ReplayForm, Form()], on: ServicesOf) -> Response:
    """Begin to replay a recorded session, and lead to the job."""
    asked = {"session": form.session, "speed": number_of(form.speed, "speed")}
    return done(f"/jobs/{on.replays.start(axis, ReplayIn.model_validate(asked)).id}", "begun")


@router.post("/axes/{axis}/stored/rejudgements", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def rejudge(axis: AxisId, form: Annotated[RejudgeForm, Form()], on: ServicesOf) -> Response:
    """Begin to judge again, and lead to the job; refused if another calibration came into force meanwhile."""
    asked = RejudgementIn.model_validate({
        "calibration": form.calibration,
        "from": form.span.start,
        "to": form.span.end,
        "dry_run": not form.let_it_stand,
        "reason": form.reason,
    })  # fmt: skip
    row = on.rejudgements.start(axis, asked, if_match=form.in_force)
    return done(f"/jobs/{row.id}", "begun")


@router.post("/axes/{axis}/stored/pins", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def pin(axis: AxisId, form: Annotated[PinForm, Form()], request: Request, on: ServicesOf) -> Response:
    """Keep the waveforms of a period."""
    span = form.span
    if span.start is None or span.end is None:
        raise InvalidRequestError("expected from when until when is kept; got an open end")
    retention.pin(on.database, axis, span, Reason(form.reason, request.state.caller.signature))
    return done(f"/axes/{axis}/stored", "pinned")


@router.post("/axes/{axis}/stored/unpin", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def unpin(axis: AxisId, form: Annotated[UnpinForm, Form()], on: ServicesOf) -> Response:
    """Let the rule decide about a period again; refused if somebody has done so already."""
    retention.remove_pin(on.database, axis, form.pin)
    return done(f"/axes/{axis}/stored", "unpinned")
