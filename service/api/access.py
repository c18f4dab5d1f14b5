"""Ask of every request who it is from and whether they may, before anything of its body is read.

``GET /v1/audit``: who changed what.
"""

from datetime import datetime
from functools import partial
from types import MappingProxyType
from typing import Annotated, cast
from urllib.parse import quote

from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, Field
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Send
from starlette.types import Scope as Connection

from service.api.http.problems import problem
from service.api.services import Services, services
from service.errors import ServiceError, TooManyTriesError, UnauthenticatedError, status_of
from service.operations.access.access import Access, require
from service.operations.access.scopes import ANYONE, Caller, Scope
from service.operations.fields import AxisName, RequestModel

#: Of the cookie of a browser that is logged in.
COOKIE = "preload_session"
_SAFE = ("GET", "HEAD", "OPTIONS")
#: Anyone may know whether the service is well, and has to log in somewhere.
OPEN = frozenset({"/healthz", "/readyz", "/login", "/logout"})
_OPEN_FOLDER = "/static/"
_AXIS = "/v1/axes/{axis}"

#: What is needed for each route. One that stands nowhere is for administrators.
NEEDED: MappingProxyType[tuple[str, str], Scope] = MappingProxyType(
    {
        ("POST", f"{_AXIS}/windows"): Scope.WINDOWS_WRITE,
        ("POST", f"{_AXIS}/recordings"): Scope.WINDOWS_WRITE,
        ("POST", f"{_AXIS}/recordings/{{recording}}/import"): Scope.WINDOWS_WRITE,
        ("POST", "/axes/{axis}/import"): Scope.WINDOWS_WRITE,
        ("POST", "/axes/{axis}/import/{recording}"): Scope.WINDOWS_WRITE,
        ("POST", "/axes/new"): Scope.CALIBRATIONS_WRITE,
        ("POST", f"{_AXIS}/calibration-jobs"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/axes/{axis}/calibrate"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/axes/{axis}/calibrate/{job}/cancel"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/axes/{axis}/calibrations/{calibration}/activate"): Scope.CALIBRATIONS_WRITE,
        ("PUT", _AXIS): Scope.CALIBRATIONS_WRITE,
        ("POST", "/v1/trials"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/trials"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/trials/end"): Scope.CALIBRATIONS_WRITE,
        ("POST", f"{_AXIS}/consequences"): Scope.TRENDS_READ,
        ("POST", f"{_AXIS}/calibrations"): Scope.CALIBRATIONS_WRITE,
        ("POST", f"{_AXIS}/calibrations/{{calibration}}/activate"): Scope.CALIBRATIONS_WRITE,
        ("POST", f"{_AXIS}/measurements/{{measurement}}/pin"): Scope.CALIBRATIONS_WRITE,
        ("DELETE", f"{_AXIS}/measurements/{{measurement}}/pin"): Scope.CALIBRATIONS_WRITE,
        ("POST", f"{_AXIS}/pins"): Scope.CALIBRATIONS_WRITE,
        ("DELETE", f"{_AXIS}/pins/{{pin}}"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/v1/retention/purges"): Scope.ADMIN,
        ("POST", f"{_AXIS}/archive"): Scope.CALIBRATIONS_WRITE,
        ("DELETE", f"{_AXIS}/archive"): Scope.CALIBRATIONS_WRITE,
        ("POST", f"{_AXIS}/rejudgements"): Scope.CALIBRATIONS_WRITE,
        ("POST", "/v1/alarms/{alarm}/acknowledge"): Scope.ALARMS_ACK,
        ("POST", "/v1/alarms/{alarm}/clear"): Scope.ALARMS_ACK,
        ("POST", "/v1/alarms/{alarm}/shelve"): Scope.ALARMS_ACK,
        ("POST", "/v1/alarms/{alarm}/comment"): Scope.ALARMS_ACK,
        **{
            ("POST", f"/alarms/{{alarm}}/{verb}"): Scope.ALARMS_ACK
            for verb in ("acknowledge", "comment", "shelve", "clear")
        },
        ("POST", f"{_AXIS}/maintenance"): Scope.ALARMS_ACK,
        ("POST", "/v1/alarms/{alarm}/explanations"): Scope.REPLAYS_RUN,
        ("POST", f"{_AXIS}/replays"): Scope.REPLAYS_RUN,
        ("POST", f"{_AXIS}/identifications"): Scope.REPLAYS_RUN,
        ("POST", f"{_AXIS}/discrepancies"): Scope.REPLAYS_RUN,
        ("POST", "/v1/jobs/{job}/cancel"): Scope.REPLAYS_RUN,
        ("GET", "/axes/{axis}/work"): Scope.ALARMS_ACK,
        ("POST", "/axes/{axis}/work"): Scope.ALARMS_ACK,
        ("GET", "/axes/{axis}/identifications"): Scope.REPLAYS_RUN,
        ("POST", "/axes/{axis}/identifications"): Scope.REPLAYS_RUN,
        ("GET", "/axes/{axis}/discrepancies"): Scope.REPLAYS_RUN,
        ("POST", "/axes/{axis}/discrepancies"): Scope.REPLAYS_RUN,
        ("POST", "/jobs/{job}/cancel"): Scope.REPLAYS_RUN,
        **{
            ("POST", f"/axes/{{axis}}/{path}"): Scope.CALIBRATIONS_WRITE
            for path in (
                "archive", "unarchive", "settings", "settings/review", "stored/rejudgements", "stored/pins",
                "stored/unpin",
            )
        },
        **{
            ("GET", path): Scope.TRENDS_READ
            for path in (
                "/axes/{axis}/long-run", f"{_AXIS}/projection",
                "/", "/wall", "/axes/new", "/axes/{axis}", "/axes/{axis}/import", "/axes/{axis}/import/{recording}",
                "/axes/{axis}/calibrate", "/axes/{axis}/calibrations/{calibration}", "/v1/drive-model",
                f"{_AXIS}/calibration-plan", "/axes/{axis}/stored", "/axes/{axis}/settings", "/jobs/{job}", "/system",
                "/docs", "/openapi.json", "/metrics",
                "/v1/axes", _AXIS, f"{_AXIS}/trend", f"{_AXIS}/history", f"{_AXIS}/maintenance",
                "/alarms", "/alarms/{alarm}", "/axes/{axis}/measurements/{measurement}",
                f"{_AXIS}/measurements/{{measurement}}/evidence",
                f"{_AXIS}/measurements/{{measurement}}", f"{_AXIS}/measurements/{{measurement}}/windows",
                f"{_AXIS}/calibrations", f"{_AXIS}/calibrations/{{calibration}}",
                f"{_AXIS}/recordings", f"{_AXIS}/recordings/{{recording}}",
                f"{_AXIS}/recordings/{{recording}}/file", f"{_AXIS}/recordings/{{recording}}/session",
                f"{_AXIS}/discrepancies/{{job}}/report",
                "/v1/alarms", "/v1/alarms/{alarm}", "/v1/jobs", "/v1/jobs/{job}", "/v1/sessions", "/v1/receivers",
                "/v1/changes", "/v1/advice", "/v1/system", "/v1/retention", f"{_AXIS}/pins", "/v1/machines",
            )
        },
    }
)  # fmt: skip
#: Windows come by the thousand, and each is stored with its own hash and time: they are their own log.
_NOT_LOGGED = frozenset({f"{_AXIS}/windows"})

router = APIRouter(prefix="/v1", tags=["operations"])


class AuditEntryOut(BaseModel):
    """One attempt to change something; `status` is that of the answer, null if the service ended before it gave any."""

    id: int
    at: datetime
    who: str
    action: str
    target: str
    axis: str | None
    status: int | None
    request_id: str | None


class AuditOut(BaseModel):
    """Entries of the log, newest first; `next_cursor` fetches older ones."""

    entries: list[AuditEntryOut]
    next_cursor: int | None


class AuditQuery(RequestModel):
    """Which entries."""

    axis: AxisName | None = None
    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=1000)] = 100


@router.get("/audit", response_model=AuditOut)
def list_audit(query: Annotated[AuditQuery, Query()], on: Annotated[Services, Depends(services)]) -> AuditOut:
    """List who changed what, newest first."""
    rows = on.access.log(query.axis, query.cursor, query.limit)
    entries = [
        AuditEntryOut(
            id=row.id, at=row.at, who=row.who, action=row.action, target=row.target, axis=row.axis_id,
            status=row.status, request_id=row.request_id,
        )
        for row in rows
    ]  # fmt: skip
    return AuditOut(entries=entries, next_cursor=rows[-1].id if len(rows) == query.limit else None)


class Gate:
    """ASGI middleware: lets through who may do what is asked for, and writes what they change into the log."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Connection, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        state = scope.setdefault("state", {})
        state["caller"] = ANYONE
        path = scope["path"]
        if path in OPEN or path.startswith(_OPEN_FOLDER):
            await self._app(scope, receive, send)
            return
        access = cast(Services, scope["app"].state.services).access
        template, axis = _route_of(path)
        try:
            caller = await self._caller(scope, access)
            state["caller"] = caller
            if not caller.is_anyone:
                require(caller, NEEDED.get((_method(scope), template), Scope.ADMIN), axis)
            if scope["method"] in _SAFE or template in _NOT_LOGGED:
                entry = None
            else:
                begin = partial(
                    access.begin_entry, caller, f"{scope['method']} {template}"[:200], path, axis, state["request_id"]
                )
                entry = await run_sync(begin)
        except ServiceError as error:
            await _refusal(error, scope)(scope, receive, send)
            return
        if entry is None:
            await self._app(scope, receive, send)
        else:
            await self._logged(access, entry, scope, receive, send)

    @staticmethod
    async def _caller(scope: Connection, access: Access) -> Caller:
        headers = Headers(scope=scope)
        scheme, _, key = headers.get("authorization", "").partition(" ")
        cookie = cookie_parser(headers.get("cookie", "")).get(COOKIE)
        address = scope["client"][0] if scope.get("client") else "unknown"
        find = partial(
            access.caller, key=key.strip() if scheme.lower() == "bearer" else None, cookie=cookie, address=address
        )
        return find() if access.is_known(cookie) else await run_sync(find)

    async def _logged(self, access: Access, entry: int, scope: Connection, receive: Receive, send: Send) -> None:
        """Serve a request that changes something. Its entry is complete before the answer is on its way."""

        async def send_noted(message: Message) -> None:
            if message["type"] == "http.response.start":
                await run_sync(access.end_entry, entry, message["status"])
            await send(message)

        await self._app(scope, receive, send_noted)


def _method(scope: Connection) -> str:
    return "GET" if scope["method"] == "HEAD" else str(scope["method"])


#: With the patterns of their paths, as the framework makes them.
_PATTERNS = {template: compile_path(template)[0] for template in dict.fromkeys(path for _, path in NEEDED)}


def _route_of(path: str) -> tuple[str, str | None]:
    """Return the template of the route that a path is of, and its axis; the path itself if it is of none."""
    for template, pattern in _PATTERNS.items():
        if (found := pattern.match(path)) is not None:
            return template, found.groupdict().get("axis")
    return path, None


def _refusal(error: ServiceError, scope: Connection) -> Response:
    """Return a problem document, or for a browser that is not logged in the way to the page where it can."""
    status, name = status_of(error)
    if isinstance(error, UnauthenticatedError):
        if scope["method"] == "GET" and "text/html" in Headers(scope=scope).get("accept", ""):
            return RedirectResponse(f"/login?next={quote(scope['path'], safe='/')}", status_code=303)
        return problem(status, name, str(error), {"WWW-Authenticate": "Bearer"})
    if isinstance(error, TooManyTriesError):
        return problem(status, name, str(error), {"Retry-After": str(max(1, round(error.wait_s)))})
    return problem(status, name, str(error))
