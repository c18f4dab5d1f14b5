"""Servers outside as they should not be: of a foreign certificate, dripping, or without an end."""

import shutil
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult

from tests.conftest import free_port
from tests.service.brokers import certificate

#: More than any of them sends: what is not bounded ends there.
WITHOUT_END = 16 * 2**20


def foreign_certificate(folder: Path) -> ssl.SSLContext:
    """Make a certificate that signs itself, ``cert.pem``, and return what a server shows it by."""
    if shutil.which("openssl") is None:
        raise FileNotFoundError("openssl")
    certificate(folder)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return context


@contextmanager
def talking(talk: Callable[[socket.socket], None], tls: ssl.SSLContext | None = None) -> Iterator[int]:
    """Let a function talk to whoever connects, one after the other, until it ends or the other side does."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.1)
        ending = threading.Event()

        def serve() -> None:
            while not ending.is_set():
                with suppress(OSError):
                    connection, _ = listening.accept()
                    connection.settimeout(10.0)
                    with connection if tls is None else tls.wrap_socket(connection, server_side=True) as wrapped:
                        talk(wrapped)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield listening.getsockname()[1]
        finally:
            ending.set()
            thread.join()


def until_it_ends(connection: socket.socket, part: bytes, pause_s: float = 0.0) -> int:
    """Send a part again and again until the other side has gone; return how much was sent [bytes]."""
    sent, pause = 0, threading.Event()
    with suppress(OSError):
        while sent < WITHOUT_END:
            connection.sendall(part)
            sent += len(part)
            pause.wait(pause_s)
    return sent


@dataclass
class MailServer:
    """A mail server that asks for TLS and a password; it keeps what it was told."""

    tls: ssl.SSLContext
    passwords: list[bytes] = field(default_factory=list)
    mails: list[bytes] = field(default_factory=list)

    async def handle_DATA(self, _server: object, _session: object, envelope: Any) -> str:  # noqa: N802
        self.mails.append(envelope.content)
        return "250 taken"

    def _authenticate(self, _server: object, _session: object, _envelope: object, _kind: str, login: Any) -> AuthResult:
        self.passwords.append(login.password)
        return AuthResult(success=True)

    @contextmanager
    def listening(self) -> Iterator[int]:
        port = free_port()
        server = Controller(
            self, hostname="127.0.0.1", port=port, tls_context=self.tls, require_starttls=True, auth_required=True,
            authenticator=self._authenticate,
        )  # fmt: skip
        server.start()
        try:
            yield port
        finally:
            server.stop()
