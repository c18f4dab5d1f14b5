"""What the page of an axis shows below its trend: work that was done, jobs, and how good its data are."""

from dataclasses import dataclass
from typing import Final
from urllib.parse import urlencode

from service.api.jobs import JobOut, job_out
from service.api.services import Services
from service.operations.monitoring.history import AxisHistory
from service.store.tables import MaintenanceRow
from service.store.trend.points import Span
from service.web.ranges import RangeQuery

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
        jobs=[job_out(row) for row in on.jobs.list(axis, MOST_LISTED)],
        quality=_quality_of(axis, on),
        n_pins=len(on.pins.list(axis, None, 1000)),
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
