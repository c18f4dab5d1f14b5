"""Bound an exchange with a server elsewhere: by a total time, by the bytes it takes, and by whom TLS verifies.

A timeout of a socket bounds one wait: a server that sends a byte now and then passes it for ever. The sockets here look
at the exchange that runs, so that whatever speaks through them (HTTP, SMTP) is bounded without knowing it::

    with exchange(total_s=20.0, most_bytes=2**16):
        ...

What is sent lengthens it, as the service lets a longer body take longer: a slow line that goes on is no fault. Names
are looked up by the system, within the time that ``resolv.conf`` states.
"""

import errno
import selectors
import socket
import ssl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpcore
import httpx

if TYPE_CHECKING:
    from collections.abc import Iterable

    from _typeshed import ReadableBuffer, WriteableBuffer


#: An exchange may take a second more for each so many bytes that were sent, the slowest that the service takes a body.
SLOWEST_BYTES_PER_S = 2**16
#: What is handed over to the system at once, so that a slow line is seen to go on.
_SENT_AT_ONCE = 2**16


class AnswerTooLongError(OSError):
    """A server sends more than it was to."""


@dataclass(slots=True)
class _Exchange:
    total_s: float
    most_bytes: int
    due: float
    n_bytes: int = 0

    def left_s(self) -> float:
        """Return how much time is left [s]. Raises TimeoutError if none is."""
        left = self.due - time.monotonic()
        if left <= 0.0:
            raise TimeoutError(f"the exchange did not end within {round(self.total_s, 1):g} s")
        return left

    def lengthen(self, n_sent: int) -> None:
        """Give it the time that bytes take that were sent."""
        more_s = n_sent / SLOWEST_BYTES_PER_S
        self.total_s += more_s
        self.due += more_s

    def take(self, n_bytes: int) -> None:
        """Count what was received. Raises AnswerTooLongError."""
        self.n_bytes += n_bytes
        if self.n_bytes > self.most_bytes:
            raise AnswerTooLongError(f"the answer is longer than {self.most_bytes} bytes")


_RUNNING: ContextVar[_Exchange] = ContextVar("_RUNNING")


@contextmanager
def exchange(total_s: float, most_bytes: int) -> Iterator[None]:
    """Bound all that the sockets of this module do in this thread, together; what they send comes on top."""
    token = _RUNNING.set(_Exchange(total_s, most_bytes, time.monotonic() + total_s))
    try:
        yield
    finally:
        _RUNNING.reset(token)


@contextmanager
def _within(bounded: socket.socket) -> Iterator[_Exchange | None]:
    """Let a socket wait for what is left of the exchange that runs, if one does: connections last longer than one."""
    running = _RUNNING.get(None)
    if running is None:
        yield None
        return
    before = bounded.gettimeout()
    bounded.settimeout(running.left_s())
    try:
        yield running
    except TimeoutError:
        running.left_s()  # says so in a sentence
        raise
    finally:
        bounded.settimeout(before)


class BoundedSocket(socket.socket):
    """A socket that waits and takes no more than the exchange that runs has left."""

    def recv(self, buflen: int = 1024, flags: int = 0) -> bytes:
        """Receive, and count what came."""
        with _within(self) as running:
            received = super().recv(buflen, flags)
            if running is not None:
                running.take(len(received))
        return received

    def recv_into(self, buffer: "WriteableBuffer", nbytes: int | None = None, flags: int = 0) -> int:
        """Receive, and count what came; :meth:`makefile` reads by it."""
        with _within(self) as running:
            received = super().recv_into(buffer, nbytes or 0, flags)
            if running is not None:
                running.take(received)
        return received

    def send(self, data: "ReadableBuffer", flags: int = 0, /) -> int:
        """Send what the other side takes at once."""
        with _within(self) as running:
            n_sent = super().send(memoryview(data)[:_SENT_AT_ONCE], flags)
            if running is not None:
                running.lengthen(n_sent)
        return n_sent

    def sendall(self, data: "ReadableBuffer", flags: int = 0, /) -> None:
        """Send all of it, part by part."""
        rest = memoryview(data).cast("B")
        while rest:
            rest = rest[self.send(rest, flags) :]


class _BoundedTlsSocket(BoundedSocket, ssl.SSLSocket):
    """The same with TLS, of which what is inside counts."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            with _within(self):
                super().do_handshake(block)
        except OSError:
            self.close()  # not everybody does who began it
            raise


def tls_context(ca_file: Path | str | None = None) -> ssl.SSLContext:
    """Return whom to believe: who shows a certificate for its name, signed by an authority of a file or of the system.

    Raises OSError if the file cannot be read or holds no certificate.
    """
    try:
        context = ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        raise OSError(f"the certificates in {ca_file} cannot be read: {error}") from error
    context.sslsocket_class = _BoundedTlsSocket
    return context


def connect(host: str, port: int) -> BoundedSocket:
    """Connect within the exchange that runs to the first address of a host that answers. Raises OSError."""
    _RUNNING.get()  # there is one: nothing goes out without
    failure = OSError(errno.EHOSTUNREACH, f"{host} has no address")
    for family, kind, protocol, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        connection = BoundedSocket(family, kind, protocol)
        try:
            with _within(connection):
                connection.connect(address)
        except OSError as error:
            connection.close()
            failure = error
        else:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return connection
    raise failure


class Transport(httpx.HTTPTransport):
    """HTTP of httpx through these sockets."""

    def __init__(self, context: ssl.SSLContext) -> None:
        super().__init__(verify=context, trust_env=False)
        # httpx hands no backend on to the library below it; the numbers are its own
        self._pool = httpcore.ConnectionPool(
            ssl_context=context, network_backend=_Backend(), max_connections=100, keepalive_expiry=5.0
        )


class _Backend(httpcore.NetworkBackend):
    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: "Iterable[Any] | None" = None,
    ) -> httpcore.NetworkStream:
        del timeout, local_address, socket_options  # the exchange has its own, and nobody asks for the others
        with _raised_as(httpcore.ConnectTimeout, httpcore.ConnectError):
            return _Stream(connect(host, port))


class _Stream(httpcore.NetworkStream):
    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        with _raised_as(httpcore.ReadTimeout, httpcore.ReadError):
            return self._socket.recv(max_bytes)

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        with _raised_as(httpcore.WriteTimeout, httpcore.WriteError):
            self._socket.sendall(buffer)

    def close(self) -> None:
        self._socket.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        try:
            with _raised_as(httpcore.ConnectTimeout, httpcore.ConnectError):
                return _Stream(ssl_context.wrap_socket(self._socket, server_hostname=server_hostname))
        except httpcore.NetworkError:
            self.close()
            raise

    def get_extra_info(self, info: str) -> Any:  # noqa: ANN401 - httpcore's own
        """Tell what is asked of a connection that is to be used again: whether the other side has closed it."""
        if info != "is_readable":
            return None
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, selectors.EVENT_READ)
            return bool(selector.select(0.0))


@contextmanager
def _raised_as(too_late: type[Exception], failed: type[Exception]) -> Iterator[None]:
    try:
        yield
    except TimeoutError as error:
        raise too_late(str(error)) from error
    except OSError as error:
        raise failed(str(error)) from error
