"""``/system``: how the service stands, its jobs and the log of changes; ``/docs``: the API as a page to try it with."""

from typing import Annotated, Final

from fastapi import APIRouter, Form, Query, Request, Response
from pydantic import Field

from service.api.access import needs
from service.api.jobs import JobOut
from service.api.retention import retention_out
from service.api.services import ServicesOf
from service.api.system import ReceiverOut, SystemOut
from service.documents.said import N_
from service.errors import ConflictError
from service.operations.access.scopes import Scope
from service.operations.fields import RequestModel
from service.operations.system import system_status
from service.web.forms import FINAL
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)

_MOST_JOBS: Final = 30
_MOST_ENTRIES: Final = 30


class SystemQuery(RequestModel):
    """Which part of the log of changes."""

    before: Annotated[int, Field(ge=1, lt=2**63)] | None = None
    done: Annotated[str, Field(max_length=40)] = ""


@router.get("/system", dependencies=[needs(Scope.TRENDS_READ)])
def system_page(page: PageOf, query: Annotated[SystemQuery, Query()], request: Request, on: ServicesOf) -> Response:
    """Show how the service stands; the log of changes only to those who may read it."""
    may_read_log = Scope.ADMIN in request.state.caller.scopes
    return page.show(
        "system.html",
        system=SystemOut.model_validate(system_status(on.database, on.metrics, on.ingest)),
        storage=retention_out(on.surveys.newest()),
        jobs=[JobOut.model_validate(row) for row in on.jobs.list(None, _MOST_JOBS)],
        receivers=[ReceiverOut.model_validate(standing) for standing in on.dispatcher.standings()],
        log=on.access.log(None, query.before, _MOST_ENTRIES) if may_read_log else None,
        most_entries=_MOST_ENTRIES,
        query=query,
    )


@router.post("/system/purges", dependencies=[needs(Scope.ADMIN), FINAL])
def purge(windows: Annotated[int, Form(ge=0, lt=2**63)], request: Request, on: ServicesOf) -> Response:
    """Let go now what the rule does not keep, and lead to the job; refused if it is not as much as the page said."""
    found = on.surveys.newest(within_s=0.0).to_let_go.n_windows
    if found != windows:
        told = N_("expected {0} windows to let go, as the page said; there are {1} now")
        raise ConflictError(told.format(windows, found))
    return done(f"/jobs/{on.purges.begin(request.state.caller.name).id}", "begun")


#: The program that draws it writes styles as it goes.
_OF_API_PAGE = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}


@router.get("/docs", dependencies=[needs(Scope.TRENDS_READ)])
def try_api(page: PageOf) -> Response:
    """Show the API as a page to try it with (Swagger UI)."""
    return page.show("swagger.html", headers=_OF_API_PAGE)
