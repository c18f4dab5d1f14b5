"""``/alarms``: what stands on every axis, the first to look at on top, and what was closed lately."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Response
from pydantic import Field

from service.api.access import needs
from service.api.alarms import AlarmOut, alarm_out
from service.api.services import Services, services
from service.documents.measurement import AlarmEvidence, read_evidence
from service.operations.access.scopes import Scope
from service.operations.fields import RequestModel
from service.operations.monitoring.alarms import AlarmView
from service.web.site import PageOf

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
def alarms_page(
    page: PageOf, query: Annotated[AlarmsPageQuery, Query()], on: Annotated[Services, Depends(services)]
) -> Response:
    """List the alarms that stand, then those that were cleared lately."""
    standing = on.alarms.standing()
    names = on.trend.names()
    first = (query.page - 1) * _ON_A_PAGE
    closed = on.alarms.list(None, "cleared", query.before, _CLOSED)
    return page.show(
        "alarms.html",
        n_open=len(standing),
        n_active=sum(view.row.status == "active" and view.shelved_until is None for view in standing),
        open=_lines(standing[first : first + _ON_A_PAGE], names),
        closed=_lines(closed, names),
        query=query,
        n_pages=-(-len(standing) // _ON_A_PAGE),
        older=closed[-1].row.id if len(closed) == _CLOSED else None,
    )


def _lines(views: Sequence[AlarmView], names: dict[str, str]) -> list[ListedAlarm]:
    lines = []
    for view in views:
        last = view.last_to(view.row.status)
        lines.append(
            ListedAlarm(
                alarm_out(view),
                read_evidence(view.row.evidence),
                names.get(view.row.axis_id, view.row.axis_id),
                None if last is None else last.who,
                view.row.raised_at if last is None else last.at,
            )
        )
    return lines
