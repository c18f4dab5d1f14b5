"""``/``: the fleet, worst first. ``/axes/{axis}``: one axis with trend, refusals, calibration and alarms.

``/docs`` and ``/redoc``: the description of the API as pages, with nothing from outside and no script in them.
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from fastapi.templating import Jinja2Templates

from service.api.alarms import alarm_out
from service.api.axes import axes_out, axis_out
from service.api.services import Services, services
from service.documents.measurement import shares_in_words
from service.operations.discrepancy.discrepancy_job import finished_discrepancies
from service.operations.monitoring.machines import SEVERITY

FOLDER = Path(__file__).parent
STATIC = FOLDER / "static"

router = APIRouter(include_in_schema=False)
templates = Jinja2Templates(directory=FOLDER / "templates")

#: Both programs that draw these pages write styles as they go, and ReDoc searches in a worker of its own.
_OF_API_PAGES = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; worker-src blob:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}


def minutes(moment: datetime | str | None) -> str:
    """Show a moment, or its RFC 3339 text, to the minute, in UTC and saying so."""
    if isinstance(moment, str):
        moment = datetime.fromisoformat(moment)
    return "—" if moment is None else moment.astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")


def significant(value: float | None, digits: int = 4) -> str:
    """Show a number with so many significant digits."""
    return "—" if value is None else f"{value:.{digits}g}"


templates.env.filters["minutes"] = minutes
templates.env.filters["significant"] = significant
templates.env.filters["shares"] = shares_in_words


@router.get("/")
def fleet_page(request: Request, on: Annotated[Services, Depends(services)]) -> Response:
    """Show all axes, worst first."""
    found = axes_out(on)
    axes = sorted(found.axes, key=lambda axis: (SEVERITY.index(axis.state), axis.id))
    return templates.TemplateResponse(request, "fleet.html", {"axes": axes, "damaged": found.damaged})


@router.get("/axes/{axis}")
def axis_page(axis: str, request: Request, on: Annotated[Services, Depends(services)]) -> Response:
    """Show one axis."""
    status = axis_out(on.trend.status(axis))
    overview = on.calibrations.overview(axis)
    active = next((row for row in overview.calibrations if row.id == overview.active), None)
    alarms = [alarm_out(view) for view in on.alarms.list(axis, None, None, 50)]
    return templates.TemplateResponse(
        request,
        "axis.html",
        {
            "axis": status,
            "history": on.history.of(axis),
            "rule": on.trend.paper_rule(axis),
            "calibration": active,
            "latest_calibration": max((row.id for row in overview.calibrations), default=None),
            "activations": overview.activations,
            "alarms": alarms,
            "discrepancies": finished_discrepancies(on.database, axis),
        },
    )


@router.get("/docs")
def try_api(request: Request) -> Response:
    """Show the API as pages to try it with (Swagger UI)."""
    return templates.TemplateResponse(request, "swagger.html", headers=_OF_API_PAGES)


@router.get("/redoc")
def read_api(request: Request) -> Response:
    """Show the API as pages to read (ReDoc)."""
    return templates.TemplateResponse(request, "redoc.html", headers=_OF_API_PAGES)
