"""Run a service inside this process, for ``preload demo`` and the tests: real HTTP on a free loopback port."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import click

from service.app import create_app
from service.cli.remote.server import Server
from service.settings import Settings

START_TIMEOUT_S = 60.0


@contextmanager
def embedded_service(settings: Settings) -> Iterator[str]:
    """Run a service in a thread and yield its address; it is stopped in good order afterwards."""
    app = create_app(settings)
    listening = threading.Event()
    server = Server(app, listening.set, host=settings.host, port=settings.port)
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
