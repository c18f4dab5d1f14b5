"""Let each request through only if its caller may make it, before its body is read, and log what it changes."""

import logging
from collections.abc import Iterable
from functools import partial
from re import Pattern
from typing import Annotated, cast
from urllib.parse import quote

from anyio.to_thread import run_sync
from fastapi import Depends, Request, Security, params
from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, compile_path
from starlette.types import ASGIApp, Message, Receive, Scope as Connection, Send

from service.api.http.problems import problem_of
from service.api.services import Services
from service.errors import ServiceError, UnauthenticatedError
from service.operations.access.access import Access, require
from service.operations.access.refusals import Refused
from service.operations.access.scopes import ANYONE, Caller, Scope
from service.store.access import REFUSING_STATUS

log = logging.getLogger(__name__)

#: Of the cookie of a browser that is logged in.
COOKIE = "preload_session"
_SAFE = ("GET", "HEAD", "OPTIONS")
#: Anyone may know whether the service is well, and has to log in somewhere.
OPEN = frozenset({"/healthz", "/readyz", "/login", "/logout"})
_OPEN_FOLDER = "/static/"
#: Windows come by the thousand, and each is stored with its own hash and time: they are their own log.
_NOT_LOGGED = frozenset({"/v1/axes/{axis}/windows"})


async def caller(request: Request) -> Caller:
    """Return who asks; :class:`Gate` has found that out, and whether they may, before the route is reached."""
    return cast(Caller, request.state.caller)


#: What a route takes them by that writes down who did something.
CallerOf = Annotated[Caller, Depends(caller)]


def address_of(scope: Connection) -> str:
    """Return the address that a request comes from, as a trusted proxy states it where there is one."""
    client: tuple[str, int] | None = scope.get("client")
    return client[0] if client else "unknown"


def needs(scope: Scope) -> params.Security:
    """Return the dependency by which a route states the scope of its callers; without one it is administrators'."""
    return cast(params.Security, Security(caller, scopes=[scope]))


def scopes_of(routes: Iterable[BaseRoute]) -> dict[tuple[str, str], Scope]:
    """Return the scope that each route states, by method and template of its path."""
    return {
        (method, route.path): Scope(scope)
        for route in routes
        if isinstance(route, APIRoute)
        for dependency in route.dependencies
        if isinstance(dependency, params.Security)
        for scope in dependency.scopes or ()
        for method in route.methods or ()
    }


class Gate:
    """ASGI middleware: lets through who may do what is asked for, and writes what they change into the log.

    ``needed`` is what :func:`scopes_of` the routes of the application returns.
    """

    def __init__(self, app: ASGIApp, *, needed: dict[tuple[str, str], Scope]) -> None:
        self._app = app
        self._needed = needed
        self._patterns: dict[str, Pattern[str]] = {path: compile_path(path)[0] for _, path in needed}

    async def __call__(self, scope: Connection, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        state = scope.setdefault("state", {})
        state["caller"] = ANYONE
        path = scope["path"]
        template, axis = self._route_of(path)
        state["action"] = f"{scope['method']} {template}"[:200]
        if path in OPEN or path.startswith(_OPEN_FOLDER):
            await self._app(scope, receive, send)
            return
        access = cast(Services, scope["app"].state.services).access
        try:
            caller = await self._caller(scope, access)
            state["caller"], state["who"] = caller, caller.name
            if not caller.is_anyone:
                require(caller, self._needed.get((_method(scope), template), Scope.ADMIN), axis)
            if scope["method"] in _SAFE or template in _NOT_LOGGED:
                entry = None
            else:
                begin = partial(access.begin_entry, caller, state["action"], path, axis, state["request_id"])
                entry = await run_sync(begin)
                state["is_in_log"] = True
        except ServiceError as error:
            await _refusal(error, scope)(scope, receive, send)
            return
        if entry is None:
            await self._app(scope, receive, send)
        else:
            await self._logged(access, entry, scope, receive, send)

    def _route_of(self, path: str) -> tuple[str, str | None]:
        """Return the template of the route that a path is of, and its axis; the path itself if it is of none."""
        for template, pattern in self._patterns.items():
            if (match := pattern.match(path)) is not None:
                return template, match.groupdict().get("axis")
        return path, None

    @staticmethod
    async def _caller(scope: Connection, access: Access) -> Caller:
        headers = Headers(scope=scope)
        scheme, _, key = headers.get("authorization", "").partition(" ")
        cookie = cookie_parser(headers.get("cookie", "")).get(COOKIE)
        key_sent = key.strip() if scheme.lower() == "bearer" else None
        if key_sent is not None:
            scope["state"]["who"] = "an unknown key"  # until it is known
        find = partial(access.caller, key=key_sent, cookie=cookie, address=address_of(scope))
        return find() if access.is_known(cookie) else await run_sync(find)

    async def _logged(self, access: Access, entry: int, scope: Connection, receive: Receive, send: Send) -> None:
        """Serve a request that changes something. Its entry is complete before the answer is on its way."""

        async def send_noted(message: Message) -> None:
            if message["type"] == "http.response.start":
                try:
                    await run_sync(access.end_entry, entry, message["status"])
                except ServiceError as error:  # what was asked is done, and is answered so
                    log.warning("entry %d of the log of changes stays without its answer: %s", entry, error)
            await send(message)

        await self._app(scope, receive, send_noted)


class RefusedInLog:
    """ASGI middleware: has every answer that refuses who asks counted in the log of changes, whoever gave it."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Connection, receive: Receive, send: Send) -> None:
        """Serve one request."""

        async def send_noted(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in REFUSING_STATUS:
                _note_refusal(scope, message["status"])
            await send(message)

        await self._app(scope, receive, send_noted if scope["type"] == "http" else send)


def _note_refusal(scope: Connection, status: int) -> None:
    state = scope.get("state", {})
    if state.get("is_in_log"):
        return  # as an entry of its own: it was let through, and refused by its route
    access = cast(Services, scope["app"].state.services).access
    action = state.get("action", scope["method"])
    access.refusals.note(Refused(state.get("who", "nobody"), address_of(scope), action, scope["path"], status))


def _method(scope: Connection) -> str:
    return "GET" if scope["method"] == "HEAD" else str(scope["method"])


def _refusal(error: ServiceError, scope: Connection) -> Response:
    """Return a problem document, or for a browser that is not logged in the way to the page where it can."""
    is_page = scope["method"] == "GET" and "text/html" in Headers(scope=scope).get("accept", "")
    if isinstance(error, UnauthenticatedError) and is_page:
        return RedirectResponse(f"/login?next={quote(scope['path'], safe='/')}", status_code=303)
    return problem_of(error)
