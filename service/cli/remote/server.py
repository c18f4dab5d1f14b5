"""Serve an application: opened before the port is listened on, announced after, closed when the last answer is out.

For ``preload demo`` and the tests a service runs inside this process: real HTTP on a free loopback port.
"""

import faulthandler
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, contextmanager
from socket import socket
from types import FrameType

import click
import uvicorn
from fastapi import FastAPI

from service.api.http.limits import Connection
from service.api.http.observer import is_news
from service.app import create_app
from service.settings import Settings

START_TIMEOUT_S = 60.0


@contextmanager
def embedded_service(settings: Settings) -> Iterator[str]:
    """Run a service in a thread and yield its address; it is stopped in good order afterwards."""
    app = create_app(settings)
    listening = threading.Event()
    server = Server(
        app,
        listening.set,
        host=settings.host,
        port=settings.port,
        trusted_proxies=settings.trusted_proxies,
    )
    with ThreadPoolExecutor(1, "embedded-service") as thread:
        ended = thread.submit(server.run)
        ended.add_done_callback(lambda _: listening.set())
        try:
            if not listening.wait(START_TIMEOUT_S):
                raise click.ClickException(f"the embedded service did not start within {START_TIMEOUT_S:g} s")
            if ended.done():
                ended.result()  # raises what kept it from starting
            port = server.servers[0].sockets[0].getsockname()[1]
            yield f"http://{settings.host}:{port}"
        finally:
            server.should_exit = True


#: Requests under way at a stop may take so long, then the background its own time; what they did not get acknowledged
#: they send again.
GRACE_S = 5
#: So long after it was told to stop the process ends, whatever runs in it: it is written to be killed at any moment.
ENDS_WITHIN_S = 9


class Server(uvicorn.Server):
    """A server whose start raises what the application raises; uvicorn's own would log it, and say no more."""

    def __init__(
        self,
        app: FastAPI,
        announce: Callable[[], None],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        trusted_proxies: Sequence[str] = (),
    ) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                host=host,
                port=port,
                http=Connection,
                lifespan="off",  # this class does it
                log_config=None,
                access_log=False,
                timeout_graceful_shutdown=GRACE_S,
                proxy_headers=bool(trusted_proxies),  # uvicorn itself would trust whatever is on this machine
                forwarded_allow_ips=list(trusted_proxies),
            )
        )
        logging.getLogger("uvicorn.error").addFilter(is_news)
        self._app = app
        self._announce = announce
        self._opened = AsyncExitStack()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Begin to stop when the system says so; a thread that does not end is named in the log, and ends nothing."""
        if not self.should_exit:
            faulthandler.dump_traceback_later(ENDS_WITHIN_S, exit=True)
        super().handle_exit(sig, frame)

    async def startup(self, sockets: list[socket] | None = None) -> None:
        """Open the application, listen, say so."""
        try:
            await self._opened.enter_async_context(self._app.router.lifespan_context(self._app))
            await super().startup(sockets)
        except BaseException:
            await self._opened.aclose()
            raise
        self._announce()

    async def shutdown(self, sockets: list[socket] | None = None) -> None:
        """Answer what was asked, then close the application."""
        await super().shutdown(sockets)
        await self._opened.aclose()
