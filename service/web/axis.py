"""``/axes/{axis}``: how one axis stands, its trend, what can be trusted, its measurements and alarms."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Response

from service.api.access import needs
from service.api.alarms import AlarmOut
from service.api.axes import AxisOut
from service.api.jobs import JobOut
from service.api.services import Services, ServicesOf
from service.documents.axis_sentence import standing
from service.documents.measurement import interval_of
from service.documents.said import N_
from service.operations.access.scopes import Scope
from service.operations.discrepancy_job import finished_discrepancies
from service.operations.fields import AxisId
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.calibrations import CalibrationOverview
from service.operations.monitoring.history import AxisHistory
from service.operations.monitoring.standing import facts_of, open_alarm
from service.operations.monitoring.trend import Only
from service.operations.retention import count_pins
from service.report.trend_chart import LaneEvent
from service.store.tables import MaintenanceRow
from service.store.trend.points import Span
from service.store.trend.shown import ShownPoint
from service.web.fleet import is_trial
from service.web.forms import RangeQuery, ShownRange, shown_range
from service.web.site import PageOf
from service.web.trend_view import MOST_SHOWN, Charts, lane_of, low_charts, preload_charts
from service.web.words import Words

router = APIRouter(include_in_schema=False)

_LISTED: Final = 20
_MOST_ALARMS: Final = 50


@dataclass(frozen=True, slots=True)
class Listed:
    """A measurement as a line of the list."""

    point: ShownPoint
    interval: tuple[float | None, float | None]


@router.get("/axes/{axis}", dependencies=[needs(Scope.TRENDS_READ)])
def axis_page(axis: AxisId, page: PageOf, query: Annotated[RangeQuery, Query()], on: ServicesOf) -> Response:
    """Show one axis."""
    status = on.trend.status(axis)
    overview, history = on.calibrations.overview(axis), on.history.of(axis)
    alarms = on.alarms.list(axis, None, None, _MOST_ALARMS)
    active = next((row for row in overview.calibrations if row.id == overview.active), None)
    only: Only | None = query.only or None
    listed = on.trend.page(axis, query.listed, cursor=query.before, limit=_LISTED, newest_first=True, only=only)
    return page.show(
        "axis.html",
        axis=AxisOut.model_validate(status),
        standing=standing(facts_of(status, overview, alarms, history.alert)),
        last=status.last,
        history=history,
        rule=on.trend.paper_rule(axis),
        calibration=active,
        latest_calibration=max((row.id for row in overview.calibrations), default=None),
        activations=overview.activations,
        alarms=[AlarmOut.model_validate(view) for view in alarms],
        alarm=open_alarm(alarms),
        open_alarm=_first_open(alarms),
        listed=[Listed(point, interval_of(point)) for point in listed.points],
        older=listed.next_cursor,
        query=query,
        is_trial=is_trial(status),
        filtered=filter_of(query),
        csv=csv_address(axis, query),
        sections=sections_of(axis, on, history),
        discrepancies=finished_discrepancies(on.database, axis),
        pictures=_pictures(axis, page.words, query, on, (alarms, overview)),
    )


def _first_open(alarms: Sequence[AlarmView]) -> AlarmOut | None:
    is_open = (AlarmOut.model_validate(view) for view in alarms if view.row.status in ("active", "acknowledged"))
    return next(is_open, None)


@dataclass(frozen=True, slots=True)
class Pictures:
    """The span of the trend that is shown, and the pictures of it."""

    shown: ShownRange
    preload: Charts
    drag: Charts
    frequency: Charts
    events: list[LaneEvent]


def _pictures(
    axis: str, words: Words, query: RangeQuery, on: Services, happened: tuple[list[AlarmView], CalibrationOverview]
) -> Pictures | None:
    """Return the pictures of an axis, and what happened to it; None if nothing was measured yet."""
    earliest, latest = (
        on.trend.page(axis, Span(), cursor=None, limit=1, newest_first=to).points for to in (False, True)
    )
    if not earliest:
        return None
    shown = shown_range(f"/axes/{axis}", query, earliest[0].at, latest[0].at)
    points = on.trend.at_resolution(axis, Span(shown.start, shown.end), MOST_SHOWN - 1).points
    # the present is shown, whatever is thinned out
    if shown.start <= latest[0].at < shown.end and latest[0] not in points:
        points = [*points, latest[0]]
    history = on.history.of(axis)
    events = lane_of(words, *happened, history)
    worked = [event for event in events if event.kind == "work"]
    return Pictures(
        shown,
        preload_charts(words, axis, points, shown, history=history, events=events),
        low_charts(
            words,
            (words(N_("Drag torque over time")), "N·m"),
            points,
            shown,
            lambda point: point.drag_torque_nm,
            events=worked,
        ),
        low_charts(
            words,
            (words(N_("Frequency over time")), "Hz"),
            points,
            shown,
            lambda point: point.frequency_hz,
            events=worked,
        ),
        sorted((event for event in events if shown.start <= event.at <= shown.end), key=lambda event: event.at),
    )


MOST_LISTED: Final = 8
#: So many of the newest measurements say how good the data are now.
LOOKED_AT: Final = 200


@dataclass(frozen=True, slots=True)
class Quality:
    """How good the newest measurements are."""

    n: int
    n_refused: int
    n_in_doubt: int
    n_without_temperature: int
    n_without_drag_torque: int


@dataclass(frozen=True, slots=True)
class Sections:
    """What is shown below the trend."""

    work: list[MaintenanceRow]  # newest first
    n_work: int
    jobs: list[JobOut]
    quality: Quality | None  # None: nothing was measured yet
    n_pins: int


def sections_of(axis: str, on: Services, history: AxisHistory) -> Sections:
    """Return what is shown below the trend of an axis."""
    newest_first = list(history.events)[::-1]
    return Sections(
        work=newest_first[:MOST_LISTED],
        n_work=len(newest_first),
        jobs=[JobOut.model_validate(row) for row in on.jobs.list(axis, MOST_LISTED)],
        quality=_quality_of(axis, on),
        n_pins=count_pins(on.database, axis),
    )


def _quality_of(axis: str, on: Services) -> Quality | None:
    points = on.trend.page(axis, Span(), cursor=None, limit=LOOKED_AT, newest_first=True).points
    if not points:
        return None
    return Quality(
        n=len(points),
        n_refused=sum(point.refusal_reason is not None for point in points),
        n_in_doubt=sum(bool(point.doubts) for point in points),
        n_without_temperature=sum(point.temperature_c is None for point in points),
        n_without_drag_torque=sum(point.drag_torque_nm is None for point in points),
    )


def filter_of(query: RangeQuery) -> str:
    """Return what a link needs to list the same measurements further on; "" if all are listed."""
    wanted = {"only": query.only, "since": query.since, "until": query.until}
    stated = {name: value for name, value in wanted.items() if value}
    return urlencode(stated | {"zone": query.zone}) if stated else ""


def csv_address(axis: str, query: RangeQuery) -> str:
    """Return where the measurements that are listed are a table."""
    wanted = {"format": "csv", "order": "newest-first"}
    if query.only:
        wanted["only"] = query.only
    for name, moment in (("from", query.listed.start), ("to", query.listed.end)):
        if moment is not None:
            wanted[name] = moment.isoformat()
    return f"/v1/axes/{axis}/trend?{urlencode(wanted)}"
