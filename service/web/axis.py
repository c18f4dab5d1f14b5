"""``/axes/{axis}``: how one axis stands, its trend, what can be trusted, its measurements and alarms."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Response

from service.api.access import needs
from service.api.alarms import AlarmOut
from service.api.axes import AxisOut
from service.api.jobs import JobOut
from service.api.services import Services, ServicesOf
from service.documents.axis_sentence import standing
from service.documents.lost_motion import ReadingStanding
from service.documents.measurement import falls_of, interval_of
from service.documents.said import N_
from service.operations.access.scopes import Scope
from service.operations.discrepancy_job import finished_discrepancies
from service.operations.fields import AxisId
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.history import AxisHistory
from service.operations.monitoring.standing import MOST_TOLD, facts_of, open_alarm
from service.operations.monitoring.trend import AxisStatus, Only
from service.report.trend_chart import LaneEvent
from service.store.alarms import LOST_MOTION
from service.store.tables import AxisRow, MaintenanceRow
from service.store.trend.lost_motion import SIGNS
from service.store.trend.points import Quality, Span
from service.store.trend.shown import ShownPoint, ToldColumns
from service.web.fleet import is_trial
from service.web.forms import RangeQuery, ShownRange, shown_range
from service.web.site import PageOf
from service.web.trend_view import (
    MOST_SHOWN,
    Charts,
    Drawn,
    frequency_charts,
    lane_of,
    low_charts,
    preload_charts,
    reading_charts,
)
from service.web.words import Words

router = APIRouter(include_in_schema=False)

_LISTED: Final = 20


@dataclass(frozen=True, slots=True)
class Listed:
    """A measurement as a line of the list."""

    point: ShownPoint
    interval: tuple[float | None, float | None]
    fall: tuple[float | None, ...]  # of its frequency, and the ends of its interval [%]


def listed_of(points: Sequence[ShownPoint]) -> list[Listed]:
    """Return measurements as lines of the list."""
    falls = zip(*falls_of(ToldColumns.of(points)), strict=True)
    return [Listed(point, interval_of(point), fall) for point, fall in zip(points, falls, strict=True)]


@router.get("/axes/{axis}", dependencies=[needs(Scope.TRENDS_READ)])
def axis_page(axis: AxisId, page: PageOf, query: Annotated[RangeQuery, Query()], on: ServicesOf) -> Response:
    """Show one axis."""
    with on.database.at_one_moment():
        status = on.trend.status(axis)
        overview, history = on.calibrations.overview(axis), on.history.of(axis)
        alarms = on.alarms.list(axis, None, None, MOST_TOLD)
        told = [AlarmOut.model_validate(view) for view in alarms]
        active = next((row for row in overview.calibrations if row.id == overview.active), None)
        lost_motion = on.readings.standing(axis)
        of_lost_motion = [view for view in alarms if view.row.kind == LOST_MOTION]
        others = [view for view in alarms if view.row.kind != LOST_MOTION]

        def lane(of: Sequence[AlarmView]) -> list[LaneEvent]:
            return lane_of(page.words, of, overview, history)

        pictures = _pictures(status.row, page.words, query, on, history=history, events=lane(others))
        only: Only | None = query.only or None
        listed = on.trend.page(axis, query.listed, cursor=query.before, limit=_LISTED, newest_first=True, only=only)
        return page.show(
            "axis.html",
            axis=AxisOut.model_validate(status),
            standing=standing(facts_of(status, overview, alarms, history, lost_motion)),
            last=status.last,
            history=history,
            rule=on.trend.paper_rule(status.row),
            calibration=active,
            latest_calibration=max((row.id for row in overview.calibrations), default=None),
            activations=overview.activations,
            alarms=told,
            alarm=open_alarm(alarms),
            open_alarm=next((alarm for alarm in told if alarm.status in ("active", "acknowledged")), None),
            listed=listed_of(listed.points),
            older=listed.next_cursor,
            query=query,
            is_trial=is_trial(status),
            filtered=filter_of(query),
            csv=csv_address(axis, query),
            sections=sections_of(status, on, history),
            discrepancies=finished_discrepancies(on.database, axis),
            pictures=pictures,
            lost_motion=lost_motion,
            lost_motion_charts=_reading_charts(
                axis, page.words, query, on, standing=lost_motion, pictures=pictures, events=lane(of_lost_motion)
            ),
            torque=[
                (
                    stands,
                    _reading_charts(axis, page.words, query, on, standing=stands, pictures=pictures, events=lane(())),
                )
                for quantity in SIGNS
                if quantity != LOST_MOTION and (stands := on.readings.standing(axis, quantity)).newest is not None
            ],
        )


@dataclass(frozen=True, slots=True)
class Pictures:
    """The span of the trend that is shown, and the pictures of it, with what happened to the axis."""

    shown: ShownRange
    main: Charts  # preload, or without a calibration the frequency against its baseline
    friction: Charts
    frequency: Charts


def _pictures(
    row: AxisRow, words: Words, query: RangeQuery, on: Services, *, history: AxisHistory, events: list[LaneEvent]
) -> Pictures | None:
    """Return the pictures of an axis; None if nothing was measured yet."""
    asked = (row.id, words, query.range, query.start, query.end)
    shows = (row.revision, history.baseline, history.line, history.healthy, events)
    return on.drawn.of(asked, shows, lambda: _drawn(row.id, words, query, on, history=history, events=events))


def _reading_charts(
    axis: str, words: Words, query: RangeQuery, on: Services, *, standing: ReadingStanding,
    pictures: Pictures | None, events: Sequence[LaneEvent],
) -> Charts | None:  # fmt: skip
    """Return the picture of a quantity over the span of the trend and what is later; None if none was measured."""
    readings = on.readings.readings(axis, standing.quantity)
    if not readings:
        return None
    shown = shown_range(f"/axes/{axis}", query, readings[0].at, readings[-1].at)
    if pictures is not None and shown.name is not None:
        both = shown, pictures.shown
        shown = replace(shown, start=min(each.start for each in both), end=max(each.end for each in both))
    told = [event for event in events if event.kind in ("alarm", "cleared", "work")]
    return reading_charts(words, readings, shown, standing, events=told)


def _drawn(
    axis: str, words: Words, query: RangeQuery, on: Services, *, history: AxisHistory, events: list[LaneEvent]
) -> Pictures | None:
    ends = on.trend.ends(axis)
    if ends is None:
        return None
    earliest, latest = ends
    shown = shown_range(f"/axes/{axis}", query, earliest.at, latest.at)
    points = on.trend.at_resolution(axis, Span(shown.start, shown.end), MOST_SHOWN - 1).points
    main = preload_charts if history.healthy is None else frequency_charts
    # the present is shown, whatever is thinned out
    if shown.start <= latest.at < shown.end and latest.set_preload_n is None and latest not in points:
        points = [*points, latest]
    if not points and not on.trend.at_resolution(axis, Span(), 2).points:
        return None  # all readings were set on purpose; of a stretch without any the chart leads to the others
    drawn, worked = Drawn.of(points, history.healthy), [event for event in events if event.kind == "work"]
    friction, frequency = (words(N_("Friction torque over time")), "N·m"), (words(N_("Frequency over time")), "Hz")
    return Pictures(
        shown,
        main(words, axis, drawn, shown, history=history, events=events),
        low_charts(words, friction, "friction_torque_nm", drawn, shown, events=worked),
        low_charts(words, frequency, "frequency_hz", drawn, shown, events=worked),
    )


MOST_LISTED: Final = 8


@dataclass(frozen=True, slots=True)
class Sections:
    """What is shown below the trend."""

    work: list[MaintenanceRow]  # newest first
    n_work: int
    jobs: list[JobOut]
    quality: Quality | None  # None: nothing was measured yet


def sections_of(status: AxisStatus, on: Services, history: AxisHistory) -> Sections:
    """Return what is shown below the trend of an axis."""
    axis = status.row.id
    newest_first = list(history.events)[::-1]
    return Sections(
        work=newest_first[:MOST_LISTED],
        n_work=len(newest_first),
        jobs=[JobOut.model_validate(row) for row in on.jobs.list(axis, MOST_LISTED)],
        quality=on.trend.quality(status.row),
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
