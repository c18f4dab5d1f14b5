"""``/``: the fleet, worst first; ``/wall``: the same in large type, to be read from afar; the forms of trials."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Final, Literal

from fastapi import APIRouter, Query, Response
from markupsafe import Markup
from pydantic import Field

from service.api.access import needs
from service.api.services import Services, ServicesOf
from service.documents.history import LineView
from service.documents.stored_measurement import StoredMeasurement
from service.errors import DocumentDamagedError
from service.operations.access.scopes import Scope
from service.operations.fields import RequestModel
from service.operations.monitoring.alarms import AlarmView
from service.operations.monitoring.standing import open_alarm
from service.operations.monitoring.trend import SEVERITY, AxisStatus
from service.operations.trial.story import EVERY, N_MEASUREMENTS, N_WINDOWS
from service.operations.trial.trial import TRIAL_MACHINE
from service.report.trend_chart import sparkline
from service.store.alarms import PRELOAD_LOSS
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)

#: In these states an axis needs somebody.
NEEDY: Final = ("alarm", "alert", "unknown")
#: Axes on one page: the worst of a large fleet come first, and the rest is found by name.
_ON_A_PAGE: Final = 100
_OF_A_SPARK: Final = 30


class FleetQuery(RequestModel):
    """Which axes."""

    q: Annotated[str, Field(max_length=100)] = ""
    state: Literal["", "alarm", "alert", "unknown", "learning", "normal", "archived"] = ""
    page: Annotated[int, Field(ge=1, le=100_000)] = 1
    done: Annotated[str, Field(max_length=40)] = ""


@dataclass(frozen=True, slots=True)
class FleetAxis:
    """An axis as a line of the fleet."""

    id: str
    name: str
    state: str
    last: StoredMeasurement
    share: float | None  # of the preload that is its baseline [-]
    present: LineView | None  # while an alarm stands, the line since the last change
    open_alarms: int
    alarm: int | None  # number of the newest open one
    shelved_until: datetime | None
    owner: str | None  # who has the alarm
    acknowledged: bool
    spark: Markup


@router.get("/", dependencies=[needs(Scope.TRENDS_READ)])
def fleet_page(page: PageOf, query: Annotated[FleetQuery, Query()], on: ServicesOf) -> Response:
    """Show all axes, worst first."""
    return _fleet("fleet.html", page, query, on)


@router.get("/wall", dependencies=[needs(Scope.TRENDS_READ)])
def wall_page(page: PageOf, on: ServicesOf) -> Response:
    """Show the worst axes in large type."""
    return _fleet("wall.html", page, FleetQuery(), on)


def _fleet(template: str, page: PageOf, query: FleetQuery, on: Services) -> Response:
    if query.state == "archived":
        return _archived(page, query, on)
    fleet, alarms = on.trend.fleet(), on.alarms.open_by_axis()
    needy = sum(_severity(status, alarms) in NEEDY for status in fleet.axes) + len(fleet.damaged)
    statuses = sorted(
        (status for status in fleet.axes if _is_meant(status, query)),
        key=lambda status: (
            SEVERITY.index(_severity(status, alarms)),
            _is_taken(alarms.get(status.row.id)),
            status.row.id,
        ),
    )
    begin = (query.page - 1) * _ON_A_PAGE
    shown = statuses[begin : begin + _ON_A_PAGE]
    return page.show(
        template,
        axes=_lines(on, shown, alarms),
        damaged=fleet.damaged,
        trial=trial_of(on),
        n_needy=needy,
        n_axes=len(fleet.axes) + len(fleet.damaged),
        n_found=len(statuses),
        query=query,
        n_pages=-(-len(statuses) // _ON_A_PAGE),
        states=SEVERITY,
    )


def _archived(page: PageOf, query: FleetQuery, on: Services) -> Response:
    """Show the archived axes, which no list holds otherwise."""
    wanted = query.q.strip().lower()
    rows = [
        status.row
        for status in on.trend.fleet(archived=True).axes
        if status.row.archived_at is not None and (wanted in status.row.name.lower() or wanted in status.row.id.lower())
    ]
    return page.show("fleet_archived.html", axes=rows, query=query)


def _is_meant(status: AxisStatus, query: FleetQuery) -> bool:
    wanted = query.q.strip().lower()
    return query.state in ("", status.state) and (wanted in status.row.name.lower() or wanted in status.row.id.lower())


def _severity(status: AxisStatus, alarms: Mapping[str, AlarmView]) -> str:
    """Return how bad an axis stands: its state is that of the preload, and what else is watched may have an alarm."""
    view = alarms.get(status.row.id)
    return "alarm" if view is not None and view.row.kind != PRELOAD_LOSS else status.state


def _is_taken(alarm: AlarmView | None) -> bool:
    """Tell whether somebody has the alarm of an axis; those that nobody has come first."""
    return alarm is None or alarm.row.status != "active" or alarm.shelved_until is not None


def _lines(on: Services, statuses: Sequence[AxisStatus], alarms: Mapping[str, AlarmView]) -> list[FleetAxis]:
    newest = on.trend.newest_preloads([status.row for status in statuses], _OF_A_SPARK)
    lines = []
    for status in statuses:
        row, last = status.row, status.last
        view = alarms.get(row.id)
        alarm = None if view is None else open_alarm([view])
        share = None
        if last.preload_n is not None and last.baseline_preload_n:
            share = last.preload_n / last.baseline_preload_n
        lines.append(
            FleetAxis(
                id=row.id,
                name=row.name,
                state=status.state,
                last=last,
                share=share,
                present=None if alarm is None else _line(on, row.id),
                open_alarms=status.open_alarms,
                alarm=None if view is None else view.row.id,
                shelved_until=None if view is None else view.shelved_until,
                owner=None if alarm is None else alarm.owner,
                acknowledged=alarm is not None and alarm.acknowledged_at is not None,
                spark=sparkline(newest[row.id], status.state, row.name),
            )
        )
    return lines


def _line(on: Services, axis: str) -> LineView | None:
    """Return the line since the last change; what cannot be read is said on the page of its axis alone."""
    with suppress(DocumentDamagedError):
        return on.history.of(axis).line
    return None


@dataclass(frozen=True, slots=True)
class Trial:
    """What the fleet says of trials: what one is made of, and how far the one is that is being made."""

    n_measurements: int
    n_windows: int
    every_days: int
    axis: str | None = None  # that is being made
    done: int = 0
    total: int | None = None


def trial_of(on: Services) -> Trial:
    """Return what the fleet says of trials."""
    job = on.trials.under_way()
    if job is None:
        return Trial(N_MEASUREMENTS, N_WINDOWS, EVERY.days)
    return Trial(N_MEASUREMENTS, N_WINDOWS, EVERY.days, str(job.arguments["axis"]), job.done, job.total)


def is_trial(status: AxisStatus) -> bool:
    """Tell whether an axis is simulated, to try the service with."""
    return status.configuration.machine == TRIAL_MACHINE


@router.post("/trials", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def begin_trial(on: ServicesOf) -> Response:
    """Begin to make a trial axis."""
    on.trials.start()
    return done("/", "trial-begun")


@router.post("/trials/end", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def end_trial(on: ServicesOf) -> Response:
    """Put the trial away."""
    on.trials.end()
    return done("/", "trial-ended")
