"""``/alarms/{alarm}``: what happened, why, what to check, and what was done about it."""

from datetime import timedelta
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Response

from service.api.access import needs
from service.api.alarms import ExaminedOut, alarm_out
from service.api.services import Services, services
from service.clock import now
from service.documents.axis_sentence import alarm_sentence
from service.documents.measurement import AlarmEvidence, interval_of, read_evidence
from service.documents.said import N_
from service.operations.access.scopes import Scope
from service.operations.advice import Advice
from service.operations.fields import RowId
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.history import AxisHistory
from service.report.trend_chart import Band, LaneEvent
from service.store.trend.points import Span, TrendPoint
from service.web.axis import Last
from service.web.ranges import ShownRange
from service.web.site import PageOf
from service.web.trend_view import MOST_SHOWN, Charts, preload_charts
from service.web.words import Words

router = APIRouter(include_in_schema=False)

#: The picture begins so long before the onset as it took from there to the alarm, and so long at least.
_LEAST_BEFORE: Final = timedelta(days=3)
#: For so long an alarm rests where nobody says otherwise.
USUAL_SHELF: Final = timedelta(days=7)
#: Refused measurements that are passed over for the present preload.
_SEARCHED: Final = 200


@router.get("/alarms/{alarm}", dependencies=[needs(Scope.TRENDS_READ)])
def alarm_page(alarm: RowId, page: PageOf, on: Annotated[Services, Depends(services)]) -> Response:
    """Show one alarm."""
    view = on.alarms.get(alarm)
    status = on.trend.status(view.row.axis_id)
    evidence = read_evidence(view.row.evidence)
    told = alarm_out(view)
    last = Last.model_validate(status.last_measurement or {})
    present = _present(view.row.axis_id, on)
    return page.show(
        "alarm.html",
        alarm=told,
        evidence=evidence,
        axis=status.row,
        state=status.state,
        last=last,
        present=present,
        present_interval=None if present is None else interval_of(present),
        sentence=alarm_sentence(
            evidence.onset, evidence.baseline_preload_n, evidence.preload_n, evidence.at, status.row.name
        ),
        cleared=view.last_to("cleared"),
        seen=view.last_to("acknowledged"),
        stands=view.row.status in ("active", "acknowledged"),
        picture=_picture(view, evidence, page.words, on),
        cause=_cause_code(told.explanation),
        advice=_advice(on, _cause_code(told.explanation)),
        newest_event=view.last_by_people,
        usual_shelf=now() + USUAL_SHELF,
    )


def _present(axis_id: str, on: Services) -> TrendPoint | None:
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
    points = on.trend.at_resolution(axis_id, Span(start, end), MOST_SHOWN).points
    if not points:
        return None
    margin = max((end - start) * 0.02, timedelta(minutes=1))
    shown = ShownRange(start - margin, end + margin, None, [], [])
    level = evidence.baseline_preload_n
    band = None if level is None else Band(level, level, level, "")
    onset, raised = words(N_("onset")), words(N_("alarm"))
    events = [LaneEvent(evidence.onset, "learnt", onset), LaneEvent(evidence.at, "alarm", raised)]
    nothing = AxisHistory(None, None, None)
    return preload_charts(words, axis_id, points, shown, history=nothing, events=events, level=band)


def _cause_code(explanation: object) -> str:
    return explanation.cause if isinstance(explanation, ExaminedOut) else "not-examined"


def _advice(on: Services, cause: str) -> list[Advice]:
    """Return what to check for the cause; where none is known, what to check of any loss of preload as well."""
    codes = [cause, "preload"] if cause in ("not-examined", "unknown") else [cause]
    found = (on.advice.of("cause", code) for code in codes)
    return [advice for advice in found if advice is not None]
