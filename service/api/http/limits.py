"""Refuse bodies that are too large, and more work than can wait, before anything is read."""

from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.http.problems import problem


class RequestLimits:
    """ASGI middleware: bounds the size of a body and the number of bodies that are held at one time."""

    def __init__(self, app: ASGIApp, *, largest_body: int, most_waiting: int) -> None:
        self._app = app
        self._largest_body = largest_body
        self._most_waiting = most_waiting
        self._waiting = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or scope["method"] not in ("POST", "PUT"):
            await self._app(scope, receive, send)
            return
        if self._waiting >= self._most_waiting:
            response = problem(503, "busy", f"{self._waiting} requests are waiting; come back later")
            await response(scope, receive, send)
            return
        self._waiting += 1
        try:
            await self._app(scope, self._bounded(scope, receive), send)
        finally:
            self._waiting -= 1

    def _bounded(self, scope: Scope, receive: Receive) -> Receive:
        declared = Headers(scope=scope).get("content-length", "")
        size = int(declared) if declared.isdecimal() and int(declared) > self._largest_body else 0

        async def bounded() -> Message:
            nonlocal size
            message = await receive() if size <= self._largest_body else {}
            size += len(message.get("body", b""))
            if size > self._largest_body:
                # an exception of the framework: it alone passes through FastAPI's own reading of bodies unchanged
                raise HTTPException(
                    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                    f"a request body may hold {self._largest_body} bytes; got more. Send fewer windows at once",
                )
            return message

        return bounded
