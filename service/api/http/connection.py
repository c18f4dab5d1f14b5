"""Speak HTTP/1.1 with one client, and close connections whose request headers do not come to an end.

uvicorn's own connection waits for headers as long, and takes as many bytes of them, as a client likes.
"""

import asyncio
from http import HTTPStatus

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.api.http.limits import MOST_HEADER_BYTES
from service.api.http.problems import problem

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
