"""Serve an application: opened before the port is listened on, announced after, closed when the last answer is out."""

from collections.abc import Callable
from contextlib import AsyncExitStack
from socket import socket

import uvicorn
from fastapi import FastAPI

from service.api.http.connection import Connection

#: Requests under way at a stop may take so long; what they did not get acknowledged they send again.
GRACE_S = 10


class Server(uvicorn.Server):
    """A server whose start raises what the application raises; uvicorn's own would log it, and say no more."""

    def __init__(self, app: FastAPI, announce: Callable[[], None], *, host: str = "127.0.0.1", port: int = 0) -> None:
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
            )
        )
        self._app = app
        self._announce = announce
        self._opened = AsyncExitStack()

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
