"""Answer ``GET …?format=csv`` and ``format=parquet`` of every list, by asking its route for one page after another.

A route that answers a list in JSON has its table without knowing of it: what is a list, and what its columns are, is
read from the description of the API. So a table says what the JSON says, and one page of it is in memory at a time.
"""

import json
from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from re import Pattern
from urllib.parse import parse_qsl, urlencode

from anyio.to_thread import run_sync
from starlette.responses import Response, StreamingResponse
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.http.problems import problem
from service.api.http.tables.columns import records_of
from service.api.http.tables.lists import ListRoute, list_routes
from service.api.http.tables.writers import WRITERS, TableWriter
from service.errors import InvalidRequestError, ServiceError, StorageError, status_of

#: So many records are asked for at a time, where the route lets that be said.
ROWS_OF_PAGE = 1000
#: Where a reader says which part of a list it wants, it gets that page, as in JSON.
_OF_PAGE = frozenset({"limit", "cursor"})

Query = list[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class _Table:
    route: ListRoute
    name: str
    writer: TableWriter
    query: Query  # without what is said of the table

    def pages(self) -> Query:
        """Return what to ask for: the page that was stated, or as much as is read at a time."""
        stated = _OF_PAGE & {name for name, _ in self.query}
        if self.route.most is None or stated:
            return self.query
        return [*self.query, ("limit", str(min(self.route.most, ROWS_OF_PAGE)))]

    def goes_on(self) -> bool:
        """Return whether the pages after the first belong to it."""
        return not _OF_PAGE & {name for name, _ in self.query}


class Tables:
    """ASGI middleware: answers lists as tables where that is asked for."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._routes: list[tuple[Pattern[str], ListRoute]] | None = None  # until it is asked for the first time

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        try:
            table = self._asked_for(scope) if scope["type"] == "http" and scope["method"] == "GET" else None
        except ServiceError as error:
            status, name = status_of(error)
            await problem(status, name, str(error))(scope, receive, send)
            return
        if table is None:
            await self._app(scope, receive, send)
            return
        query = table.pages()
        first = await self._page(scope, query)
        if first.status_code != HTTPStatus.OK:
            await first(scope, receive, send)
            return
        kind = next(kind for kind, writer in WRITERS.items() if isinstance(table.writer, writer))
        words = [word for word in scope["path"].split("/")[2:] if word != "axes"] or ["axes"]
        name = "-".join(words if table.name == next(iter(table.route.lists)) else [*words, table.name])
        headers = {"Content-Disposition": f'attachment; filename="{name}.{kind}"'}
        parts = self._parts(scope, table, first, query)
        await StreamingResponse(parts, media_type=table.writer.media_type, headers=headers)(scope, receive, send)

    def _asked_for(self, scope: Scope) -> _Table | None:
        """Return the table that a request is for, if it is for any."""
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        asked = dict(query)
        if "format" not in asked:
            return None
        if self._routes is None:
            routes = list_routes(scope["app"].openapi())
            self._routes = [(compile_path(path)[0], route) for path, route in routes.items()]
        route = next((route for pattern, route in self._routes if pattern.match(scope["path"])), None)
        if route is None:
            return None
        writer = WRITERS.get(asked["format"])
        if writer is None:
            raise InvalidRequestError(f"format must be {' or '.join(WRITERS)}; got {asked['format'][:50]!r}")
        name = asked.get("list", next(iter(route.lists)))
        if name not in route.lists:
            raise InvalidRequestError(f"list must be {' or '.join(route.lists)}; got {name[:50]!r}")
        rest = [(each, value) for each, value in query if each not in ("format", "list")]
        return _Table(route, name, writer(route.lists[name]), rest)

    async def _parts(self, scope: Scope, table: _Table, page: Response, query: Query) -> AsyncIterator[bytes]:
        yield table.writer.begin()
        while True:
            part, cursor = await run_sync(partial(_written, table, bytes(page.body)))
            yield part
            if cursor is None or not table.goes_on():
                break
            page = await self._page(scope, [*query, ("cursor", cursor)])
            if page.status_code != HTTPStatus.OK:  # the answer has begun: all that is left is to break it off
                raise StorageError(f"a page of {scope['path']} was answered with {page.status_code}")
        yield await run_sync(table.writer.end)

    async def _page(self, scope: Scope, query: Query) -> Response:
        """Ask the route for a page."""
        headers = [(name, value) for name, value in scope["headers"] if name != b"if-none-match"]  # of the JSON
        inner = {**scope, "query_string": urlencode(query).encode(), "headers": headers}
        answer = Response()
        body = bytearray()

        async def nothing() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def keep(message: Message) -> None:
            if message["type"] == "http.response.start":
                answer.status_code, answer.raw_headers = message["status"], list(message.get("headers", ()))
            else:
                body.extend(message.get("body", b""))

        await self._app(inner, nothing, keep)
        if "route" in inner:
            scope["route"] = inner["route"]  # what is counted and logged
        answer.body = bytes(body)
        return answer


def _written(table: _Table, body: bytes) -> tuple[bytes, str | None]:
    """Write a page; returned is where the next one begins, None if it is the last."""
    answer = json.loads(body)
    cursor = answer.get("next_cursor")
    return table.writer.add(records_of(answer, table.name)), None if cursor is None else str(cursor)
