"""``/alarms``: what stands on every axis, and what was closed lately; ``/alarms/{alarm}``: one alarm, and its forms."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated, Final, Literal

from fastapi import APIRouter, Form, Query, Request, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.alarms import AlarmOut, ExaminedOut
from service.api.services import Services, ServicesOf
from service.clock import now
from service.documents.axis_sentence import alarm_sentence
from service.documents.lost_motion import lost_motion_alarm_sentence
from service.documents.measurement import AlarmEvidence, interval_of, read_evidence
from service.documents.said import N_
from service.errors import InvalidRequestError
from service.operations.access.scopes import Scope
from service.operations.advice import Advice
from service.operations.fields import RequestModel, RowId, Text
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.history import AxisHistory
from service.report.trend_chart import Band, LaneEvent
from service.store.alarms import LOST_MOTION
from service.store.trend.points import Span
from service.store.trend.shown import ShownPoint
from service.web.forms import MomentText, ShownRange, moment_of
from service.web.site import PageOf, done
from service.web.trend_view import MOST_SHOWN, Charts, Drawn, frequency_charts, preload_charts, reading_charts
from service.web.words import Words

router = APIRouter(include_in_schema=False)

_ON_A_PAGE: Final = 50
_CLOSED: Final = 20


class AlarmsPageQuery(RequestModel):
    """Which of the open ones, and which of the closed ones."""

    page: Annotated[int, Field(ge=1, le=100_000)] = 1
    before: Annotated[int, Field(ge=1, lt=2**63)] | None = None
    done: Annotated[str, Field(max_length=40)] = ""


@dataclass(frozen=True, slots=True)
class ListedAlarm:
    """An alarm as a line of the list."""

    alarm: AlarmOut
    evidence: AlarmEvidence
    axis_name: str
    who: str | None  # has seen or cleared it
    changed_at: datetime


@router.get("/alarms", dependencies=[needs(Scope.TRENDS_READ)])
def alarms_page(page: PageOf, query: Annotated[AlarmsPageQuery, Query()], on: ServicesOf) -> Response:
    """List the alarms that stand, then those that were cleared lately."""
    standing, n_open, n_active = on.alarms.standing((query.page - 1) * _ON_A_PAGE, _ON_A_PAGE)
    names = on.trend.names()
    closed = on.alarms.list(None, "cleared", query.before, _CLOSED)
    return page.show(
        "alarms.html",
        n_open=n_open,
        n_active=n_active,
        open=_lines(standing, names),
        closed=_lines(closed, names),
        query=query,
        n_pages=-(-n_open // _ON_A_PAGE),
        older=closed[-1].row.id if len(closed) == _CLOSED else None,
    )


def _lines(views: Sequence[AlarmView], names: dict[str, str]) -> list[ListedAlarm]:
    lines = []
    for view in views:
        last = view.last_to(view.row.status)
        lines.append(
            ListedAlarm(
                AlarmOut.model_validate(view),
                read_evidence(view.row.evidence),
                names.get(view.row.axis_id, view.row.axis_id),
                None if last is None else last.who,
                view.row.raised_at if last is None else last.at,
            )
        )
    return lines


#: The picture begins so long before the onset as it took from there to the alarm, and so long at least.
_LEAST_BEFORE: Final = timedelta(days=3)
#: For so long an alarm rests where nobody says otherwise.
USUAL_SHELF: Final = timedelta(days=7)
#: Refused measurements that are passed over for the present preload.
_SEARCHED: Final = 200


@router.get("/alarms/{alarm}", dependencies=[needs(Scope.TRENDS_READ)])
def alarm_page(alarm: RowId, page: PageOf, on: ServicesOf) -> Response:
    """Show one alarm."""
    view = on.alarms.get(alarm)
    status = on.trend.status(view.row.axis_id)
    evidence = read_evidence(view.row.evidence)
    alarm_shown = AlarmOut.model_validate(view)
    present = _present(view.row.axis_id, on)
    return page.show(
        "alarm.html",
        alarm=alarm_shown,
        evidence=evidence,
        axis=status.row,
        state=status.state,
        last=status.last,
        present=present,
        present_interval=None if present is None else interval_of(present),
        sentence=(
            alarm_sentence(evidence, status.row.name)
            if evidence.lost_motion_um is None
            else lost_motion_alarm_sentence(evidence, status.row.name)
        ),
        lost_motion=None if evidence.lost_motion_um is None else on.readings.standing(view.row.axis_id),
        cleared=view.last_to("cleared"),
        seen=view.last_to("acknowledged"),
        stands=view.row.status in ("active", "acknowledged"),
        picture=_picture(view, evidence, page.words, on),
        advice=_advice(on, alarm_shown),
        newest_event=view.last_by_people,
        usual_shelf=now() + USUAL_SHELF,
    )


def _present(axis_id: str, on: Services) -> ShownPoint | None:
    """Return the newest measurement that has a preload, among the newest ones."""
    newest = on.trend.page(axis_id, Span(), cursor=None, limit=_SEARCHED, newest_first=True).points
    return next((point for point in newest if point.preload_n is not None), None)


def _picture(view: AlarmView, evidence: AlarmEvidence, words: Words, on: Services) -> Charts | None:
    """Draw the trend up to the measurement that raised the alarm, and a while before its onset."""
    axis_id = view.row.axis_id
    start = evidence.onset - max(evidence.at - evidence.onset, _LEAST_BEFORE)
    if evidence.baseline_started_at is not None:
        start = min(start, max(evidence.baseline_started_at, evidence.onset - 4 * (evidence.at - evidence.onset)))
    end = evidence.at + timedelta(microseconds=1)
    margin = max((end - start) * 0.02, timedelta(minutes=1))
    shown = ShownRange(start - margin, end + margin, None, [], [])
    onset, raised = words(N_("onset")), words(N_("alarm"))
    events = [LaneEvent(evidence.onset, "learnt", onset), LaneEvent(evidence.at, "alarm", raised)]
    if evidence.lost_motion_um is not None:
        readings = [reading for reading in on.readings.readings(axis_id) if start <= reading.at < end]
        return reading_charts(words, readings, shown, on.readings.standing(axis_id), events=events)
    points = on.trend.at_resolution(axis_id, Span(start, end), MOST_SHOWN).points
    if not points:
        return None
    level = evidence.baseline_preload_n
    band = None if level is None else Band(level, level, level, "")
    nothing = AxisHistory(None, None, None)
    if evidence.fall is not None or (evidence.numbers and evidence.preload_n is None):
        drawn = Drawn.of(points, on.history.of(axis_id).healthy)
        return frequency_charts(words, axis_id, drawn, shown, history=nothing, events=events)
    return preload_charts(words, axis_id, Drawn.of(points), shown, history=nothing, events=events, level=band)


def _advice(on: Services, alarm: AlarmOut) -> list[Advice]:
    """Return what to check for the cause; where none is known, what to check of any loss of preload as well."""
    cause = alarm.explanation.cause if isinstance(alarm.explanation, ExaminedOut) else "not-examined"
    codes = [cause, "preload"] if cause in ("not-examined", "unknown") else [cause]
    if alarm.kind == LOST_MOTION:
        codes = [LOST_MOTION]
    entries = (on.advice.of("cause", code) for code in codes)
    return [advice for advice in entries if advice is not None]


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
def acknowledge(alarm: RowId, form: Annotated[SeenForm, Form()], request: Request, on: ServicesOf) -> Response:
    """Note that somebody has seen an alarm, and go back to where it was said."""
    view = on.alarms.acknowledge(alarm, form.comment, request.state.caller.signature, seen=form.seen_event)
    path = {"axis": f"/axes/{view.row.axis_id}", "alarm": f"/alarms/{alarm}", "alarms": "/alarms"}[form.back]
    return done(path, "acknowledged")


@router.post("/alarms/{alarm}/comment", dependencies=[needs(Scope.ALARMS_ACK)])
def comment(alarm: RowId, form: Annotated[CommentForm, Form()], request: Request, on: ServicesOf) -> Response:
    """Keep what somebody says of an alarm."""
    on.alarms.comment(alarm, form.comment, request.state.caller.signature)
    return done(f"/alarms/{alarm}", "commented")


@router.post("/alarms/{alarm}/shelve", dependencies=[needs(Scope.ALARMS_ACK)])
def shelve(alarm: RowId, form: Annotated[ShelveForm, Form()], request: Request, on: ServicesOf) -> Response:
    """Let an alarm rest until a moment."""
    until = moment_of(form.until, form.zone)
    if until is None:
        raise InvalidRequestError("until: expected the moment until which the alarm rests; got none")
    on.alarms.shelve(alarm, until, form.comment, request.state.caller.signature, seen=form.seen_event)
    return done(f"/alarms/{alarm}", "shelved")


@router.post("/alarms/{alarm}/clear", dependencies=[needs(Scope.ALARMS_ACK)])
def clear(alarm: RowId, form: Annotated[ChangeForm, Form()], request: Request, on: ServicesOf) -> Response:
    """Close an alarm: what is now becomes normal."""
    on.alarms.clear(alarm, form.comment, request.state.caller.signature, seen=form.seen_event)
    return done(f"/alarms/{alarm}", "cleared")


@router.post("/alarms/{alarm}/explanations", dependencies=[needs(Scope.REPLAYS_RUN)])
def explain(alarm: RowId, on: ServicesOf) -> Response:
    """Begin to look for the cause of an alarm."""
    on.alarm_explanations.start(alarm)
    return done(f"/alarms/{alarm}", "begun")
