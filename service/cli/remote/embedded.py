"""Run a service inside this process, for ``preload demo`` and the tests: real HTTP on a free loopback port."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import click
import uvicorn

from service.app import create_app
from service.settings import Settings

START_TIMEOUT_S = 60.0


@contextmanager
def embedded_service(settings: Settings) -> Iterator[str]:
    """Run a service in a thread and yield its address; it is stopped in good order afterwards."""
    config = uvicorn.Config(
        create_app(settings), host=settings.host, port=settings.port, log_config=None, access_log=False
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, name="embedded-service", daemon=True)
    thread.start()
    try:
        yield _address(server, thread, settings.host)
    finally:
        server.should_exit = True
        thread.join(timeout=START_TIMEOUT_S)


def _address(server: uvicorn.Server, thread: threading.Thread, host: str) -> str:
    deadline = time.monotonic() + START_TIMEOUT_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > deadline:
            raise click.ClickException("the embedded service did not start; its log above says why")
        time.sleep(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    return f"http://{host}:{port}"
