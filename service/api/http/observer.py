"""Count and log every request, whatever becomes of it."""

import logging
import time
import uuid
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.http.guard import is_address, name_in
from service.api.http.problems import problem, problem_of
from service.errors import refusal_in
from service.observability import Metrics

log = logging.getLogger(__name__)
access_log = logging.getLogger("service.access")
METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
#: What browsers are told of every answer: run and load nothing but files of this service, show it in no frame, take
#: nothing for another type than it states. A route may state a policy of its own.
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'self'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "same-origin",
}
#: And of all but the files of the pages: keep no copy, who reads the disk later may not have been let in.
_NOT_KEPT = {"Cache-Control": "no-store"}
#: Behind TLS: ask this name by nothing else for a year, at whichever port. Others answer at those of ``localhost``.
_BY_TLS_ONLY = {"Strict-Transport-Security": "max-age=31536000"}
_FILES = "/static/"
INTERNAL_ERROR = ("internal-error", "the service failed on this request; its log says why, under the id of the request")
#: What the log calls it when nobody was left to be answered, as nginx does.
CLIENT_GONE = 499


class BrokenOffError(Exception):
    """An answer could not be completed; the log has said why."""


def is_news(record: logging.LogRecord) -> bool:
    """Tell whether a line of the server's log says more than that an answer was broken off: a filter."""
    return not (record.exc_info and isinstance(record.exc_info[1], BrokenOffError))


class RequestObserver:
    """ASGI middleware: times each request, names it with an id, and logs it without its query (it could hold anything).

    It also tells browsers what they may do with the answer.
    """

    def __init__(self, app: ASGIApp, *, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = Headers(scope=scope).get("x-request-id", "")[:64] or uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = request_id
        status: int | None = None  # until an answer begins
        stated = _headers(scope)

        async def send_named(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                for name, value in stated.items():
                    headers.setdefault(name, value)
            await send(message)

        started = time.perf_counter()
        try:
            await self._app(scope, receive, send_named)
        except Exception as error:  # the edge of a request: the log gets the traceback, the caller no internals
            refusal = refusal_in(error)
            if refusal is None:
                log.exception("request failed", extra={"members": {"request_id": request_id}})
            else:
                scope["state"]["reason"] = str(refusal)
            if status is not None:
                raise BrokenOffError from error  # the answer has begun: all that is left is to break it off
            answer = problem_of(refusal) if refusal else problem(500, *INTERNAL_ERROR, request_id=request_id)
            await answer(scope, receive, send_named)
        finally:
            self._note(scope, status or CLIENT_GONE, time.perf_counter() - started, request_id)

    def _note(self, scope: Scope, status: int, elapsed: float, request_id: str) -> None:
        # Label values must be few, whatever is sent: the template of the route, and methods that exist.
        route = getattr(scope.get("route"), "path", "none")
        method = scope["method"] if scope["method"] in METHODS else "other"
        self._metrics.requests.labels(method, route, status).observe(elapsed)
        members = {"request_id": request_id, "seconds": round(elapsed, 6)}
        reason = scope["state"].get("reason")  # why it was refused, or its answer broken off
        level = logging.INFO if status < HTTPStatus.BAD_REQUEST and reason is None else logging.WARNING
        if reason is not None:
            members["reason"] = reason
        access_log.log(level, "%s %s %d", method, route, status, extra={"members": members})


def _headers(scope: Scope) -> dict[str, str]:
    """Return what browsers are told of the answer to a request."""
    kept = scope["path"].startswith(_FILES)
    name = name_in(Headers(scope=scope).get("host", ""))
    by_tls = scope["scheme"] == "https" and name != "localhost" and not is_address(name)  # a trusted proxy says so
    return _HEADERS | ({} if kept else _NOT_KEPT) | (_BY_TLS_ONLY if by_tls else {})
