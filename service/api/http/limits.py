"""Take requests in time and within bounds, and let no sender take every place.

A body is read here, whole, before its request gets one of the places at work: who sends slowly keeps nobody waiting.
Whatever is no windows is answered in places of readers. Windows, documents and logins hold no place and no memory of
each other.
A recording is larger than memory may be: its route takes it part by part, within the same time, in places of its own.

Speak HTTP/1.1 with one client, and close connections whose request headers do not come to an end.

uvicorn's own connection waits for headers as long, and takes as many bytes of them, as a client likes.
"""

import asyncio
import re
from collections import Counter
from http import HTTPStatus
from io import BytesIO

from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.api.http.problems import problem
from service.api.http.readers import ReaderPlaces
from service.errors import BodyTooLargeError, BodyTooSlowError

MOST_HEADER_BYTES = 64 * 2**10
#: A body may take so long, and a second more for each so many bytes that have arrived.
BODY_TIME_S = 20.0
SLOWEST_BYTES_PER_S = 2**16
#: A body that holds no windows becomes objects of many times its size. Ten thousand readings take half of this.
LARGEST_DOCUMENT = 4 * 2**20
#: The form of a login, which anybody may send: name, password and page, each character in twelve bytes.
LARGEST_LOGIN = 2**14
#: All bodies of a kind together, arriving or at work, take no more memory than so many of its largest.
LARGEST_AT_ONCE = 4
#: A sender may hold so many times the places that are free: at most three quarters, while nobody else holds any.
SHARE = 3

#: The only bodies that are not read here: their route writes them to the disk as they arrive.
STREAMED = re.compile(r"/v1/axes/[^/]+/recordings|/axes/[^/]+/import")
#: More of them at one time are asked to come back.
MOST_STREAMED = 4
#: What surrounds the files of a recording: a map, and the headers of its parts.
ROOM_AROUND_FILES = 2**20

_WITHOUT_BODY = ("GET", "HEAD", "OPTIONS")
#: What anybody may ask for without a login has places apart, as has whoever watches over the service.
LOGIN = "/login"
_APART = (LOGIN, "/metrics")


class RequestLimits:
    """ASGI middleware: bounds the size of a body, the time it takes, and the number and memory of all bodies."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        largest_body: int,
        most_waiting: int,
        body_time_s: float = BODY_TIME_S,
        largest_recording: int = 0,
    ) -> None:
        self._app = app
        self._readers = ReaderPlaces(app)
        self._apart = {path: ReaderPlaces(app) for path in _APART}
        self._largest_streamed = largest_recording + ROOM_AROUND_FILES
        self._streamed: Counter[str] = Counter()  # under way, by sender
        self._windows = _Bodies(largest_body)
        self._documents = _Bodies(min(LARGEST_DOCUMENT, largest_body))
        self._logins = _Bodies(LARGEST_LOGIN)
        self._most_waiting = most_waiting
        self._body_time_s = body_time_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if sum(len(name) + len(value) for name, value in scope["headers"]) > MOST_HEADER_BYTES:
            detail = f"headers may take {MOST_HEADER_BYTES} bytes; got more"
            await problem(431, "headers-too-large", detail)(scope, receive, send)
            return
        readers = self._apart.get(scope["path"], self._readers)
        if scope["method"] in _WITHOUT_BODY:
            await readers.serve(scope, receive, send, receive)
        elif scope["method"] == "POST" and STREAMED.fullmatch(scope["path"]):
            await self._stream(scope, receive, send)
        elif scope["path"].endswith("/windows"):
            await self._take(self._windows, None, scope, receive, send)
        else:
            bodies = self._logins if scope["path"] == LOGIN else self._documents
            await self._take(bodies, readers, scope, receive, send)

    async def _take(
        self, bodies: "_Bodies", readers: ReaderPlaces | None, scope: Scope, receive: Receive, send: Send
    ) -> None:
        """Wait for the body of a request, and serve it, in a place of readers where they are given."""
        body, sender = _Body(receive, bodies.largest), (scope.get("client") or ("",))[0]
        try:
            refusal = await self._arrive(bodies, body, Headers(scope=scope)) or self._without_place(bodies, sender)
            if refusal is not None:
                await refusal(scope, receive, send)
                return
            bodies.at_work[sender] += 1
            try:
                if readers is None:
                    await self._app(scope, body.handed_over, send)
                else:
                    await readers.serve(scope, body.handed_over, send, receive)
            finally:
                bodies.at_work[sender] -= 1
        except ClientDisconnect:
            pass  # nobody is left to be told
        finally:
            bodies.n_bytes -= body.size
            bodies.at_work += Counter()  # forget who holds no place

    async def _arrive(self, bodies: "_Bodies", body: "_Body", headers: Headers) -> Response | None:
        """Wait for a body, and return the refusal where it is too large or too slow."""
        if _declared(headers) > body.largest:
            return _too_large(body.largest)
        loop = asyncio.get_running_loop()
        began = loop.time()
        try:
            async with asyncio.timeout(self._body_time_s) as deadline:
                bodies.arriving[body] = deadline
                while n_bytes := await body.more():
                    bodies.n_bytes += n_bytes
                    if body.size > body.largest:
                        return _too_large(body.largest)
                    if not body.complete:  # most come whole: a timer costs more than to look
                        deadline.reschedule(began + self._body_time_s + body.size / SLOWEST_BYTES_PER_S)
                    if bodies.n_bytes > LARGEST_AT_ONCE * bodies.largest:
                        next(iter(bodies.arriving.values())).reschedule(loop.time())
        except TimeoutError:
            return problem(
                408,
                "body-too-slow",
                f"a body must arrive within {self._body_time_s:g} s and a second for each {SLOWEST_BYTES_PER_S} bytes, "
                f"or sooner while many arrive; got {body.size} bytes in {loop.time() - began:.0f} s",
                {"Connection": "close"},
            )
        finally:
            bodies.arriving.pop(body, None)
        return None

    async def _stream(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request whose body its route reads: what is too large or too slow is refused while it does."""
        sender, taken = (scope.get("client") or ("",))[0], self._streamed.total()
        refusal = None
        if _declared(Headers(scope=scope)) > self._largest_streamed:
            refusal = _too_large(self._largest_streamed)
        elif self._streamed[sender] >= SHARE * (MOST_STREAMED - taken):
            refusal = problem(503, "busy", f"{taken} recordings are being taken; come back later")
        if refusal is not None:
            await refusal(scope, receive, send)
            return
        self._streamed[sender] += 1
        try:
            await self._app(scope, _Stream(receive, self._largest_streamed, self._body_time_s).more, send)
        except ClientDisconnect:
            pass  # nobody is left to be told
        finally:
            self._streamed[sender] -= 1
            self._streamed += Counter()

    def _without_place(self, bodies: "_Bodies", sender: str) -> Response | None:
        taken = bodies.at_work.total()
        if bodies.at_work[sender] < SHARE * (self._most_waiting - taken):
            return None
        return problem(503, "busy", f"{taken} requests are waiting; come back later")


def _declared(headers: Headers) -> int:
    """Return how many bytes a body is said to have; 0 where nothing is said."""
    declared = headers.get("content-length", "")
    return int(declared) if declared.isdecimal() else 0


def _too_large(largest: int) -> Response:
    return problem(413, "body-too-large", f"a body may hold {largest} bytes here; got more. Send less at once")


class _Bodies:
    """The bodies of one kind."""

    def __init__(self, largest: int) -> None:
        self.largest = largest
        self.at_work: Counter[str] = Counter()  # by sender
        self.arriving: dict[_Body, asyncio.Timeout] = {}  # the one that began first comes first
        self.n_bytes = 0


class _Body:
    """The body of one request, while it arrives and until it is handed over."""

    def __init__(self, receive: Receive, largest: int) -> None:
        self.largest = largest
        self.size = 0
        self._receive = receive
        self._content: BytesIO | bytes | None = BytesIO()
        self.complete = False

    async def more(self) -> int:
        """Wait for more of it and return how many bytes came: 0 at the end."""
        while not self.complete:
            message = await self._receive()
            if message["type"] == "http.disconnect":
                raise ClientDisconnect
            self.complete = not message.get("more_body", False)
            chunk = message.get("body", b"")
            if chunk and isinstance(self._content, BytesIO):
                self.size += len(chunk)
                if self.complete and self.size == len(chunk):
                    self._content = chunk  # it came in one part, as most do: a copy would take as long as reading it
                else:
                    self._content.write(chunk)
                return len(chunk)
        return 0

    async def handed_over(self) -> Message:
        """Give the application the whole body, once, and keep nothing of it."""
        if self._content is None:
            return await self._receive()
        content, self._content = self._content, None
        body = content.getvalue() if isinstance(content, BytesIO) else content
        return {"type": "http.request", "body": body, "more_body": False}


class _Stream:
    """The body of one request, handed on as it arrives."""

    def __init__(self, receive: Receive, largest: int, body_time_s: float) -> None:
        self._receive = receive
        self._largest = largest
        self._body_time_s = body_time_s
        self._began = asyncio.get_running_loop().time()
        self._size = 0
        self._complete = False

    async def more(self) -> Message:
        """Return the next part.

        Raises BodyTooLargeError or BodyTooSlowError.
        """
        if self._complete:
            return await self._receive()
        loop = asyncio.get_running_loop()
        due = self._began + self._body_time_s + self._size / SLOWEST_BYTES_PER_S
        try:
            async with asyncio.timeout_at(min(due, loop.time() + self._body_time_s)):
                message = await self._receive()
        except TimeoutError:
            raise BodyTooSlowError(
                f"a recording must arrive within {self._body_time_s:g} s and a second for each {SLOWEST_BYTES_PER_S} "
                f"bytes, without a pause of {self._body_time_s:g} s; got {self._size} bytes in "
                f"{loop.time() - self._began:.0f} s"
            ) from None
        self._complete = not message.get("more_body", False)
        self._size += len(message.get("body", b""))
        if self._size > self._largest:
            raise BodyTooLargeError(f"a body may hold {self._largest} bytes here; got more. Send less at once")
        return message


#: A connection without a request ends after so long.
HEADER_TIME_S = 20.0


class Connection(HttpToolsProtocol):
    """uvicorn's connection, with bounds for the size of headers and the time until they are complete."""

    _header_bytes: int | None = 0  # None where no headers are being read
    _patience: asyncio.TimerHandle | None = None  # while no request is under way

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._wait_for_headers()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read on, unless the headers have grown too large."""
        super().data_received(data)
        if self._header_bytes is not None:
            self._header_bytes += len(data)
            if self._header_bytes > MOST_HEADER_BYTES:
                self._refuse(431, "headers-too-large", f"headers may take {MOST_HEADER_BYTES} bytes; got more")

    def on_message_begin(self) -> None:
        """Begin to read headers."""
        self._header_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Serve the request: it has limits of its own."""
        self._header_bytes = None
        self._stop_waiting()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Keep a part of a body as it came, unless another one waits: uvicorn would copy it twice."""
        if not self.cycle.body:
            self.cycle.body = b""  # type: ignore[assignment]  # to add to no bytes copies nothing
        elif isinstance(self.cycle.body, bytes):
            self.cycle.body = bytearray(self.cycle.body)  # many small parts would be copied again and again
        super().on_body(body)

    def on_response_complete(self) -> None:
        """Wait for the next request, unless that is there already."""
        super().on_response_complete()
        if self.cycle.response_complete and not self.transport.is_closing():
            self._wait_for_headers()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP."""
        self._refuse(400, "unreadable-request", f"expected a request of HTTP/1.1; got something else ({msg})")

    def _wait_for_headers(self) -> None:
        self._stop_waiting()
        self._patience = self.loop.call_later(HEADER_TIME_S, self._give_up)

    def _stop_waiting(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _give_up(self) -> None:
        self._refuse(408, "headers-too-slow", f"headers must arrive within {HEADER_TIME_S:g} s; got a part of them")

    def _refuse(self, status: int, name: str, detail: str) -> None:
        if self.transport.is_closing():
            return
        answer = problem(status, name, detail, {"Connection": "close"})
        lines = [b"HTTP/1.1 %d %b" % (status, HTTPStatus(status).phrase.encode())]
        lines += [name + b": " + value for name, value in answer.raw_headers]
        self.transport.write(b"\r\n".join(lines) + b"\r\n\r\n" + bytes(answer.body))
        self.transport.close()
