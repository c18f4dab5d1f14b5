"""``preload serve``: the service on this machine."""

import ctypes
import gc
import resource
import socket
from pathlib import Path
from typing import Any

import click

from service.app import create_app
from service.cli.options import data_dir_option
from service.cli.remote.server import Server
from service.errors import ServiceError
from service.observability import configure_logging
from service.settings import Settings


@click.command()
@click.option("--host", help="Address to listen on (PRELOAD_HOST; loopback unless set).")
@click.option("--port", type=int, help="TCP port (PRELOAD_PORT); 0 takes a free one.")
@data_dir_option("Database and waveforms")
@click.option(
    "--replay-dir", type=click.Path(path_type=Path, file_okay=False), help="Recorded sessions (PRELOAD_REPLAY_DIR)."
)
def serve(**flags: Any) -> None:  # noqa: ANN401 - click hands over the flags by name
    """Run the service. Settings come from the environment (PRELOAD_*); a flag wins over it."""
    settings = Settings(**{name: value for name, value in flags.items() if value is not None})
    configure_logging(settings.log_level)
    with bound_socket(settings.host, settings.port) as listening:
        host, port = listening.getsockname()[:2]
        address = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        app = create_app(settings)
        _allow_many_connections()
        keep_freed_memory()
        gc.freeze()  # modules and routes stay: the collector need not look at them again and again
        announcement = f"dashboard: {address}/   API: {address}/docs"
        try:
            Server(app, lambda: click.echo(announcement, err=True), trusted_proxies=settings.trusted_proxies).run(
                sockets=[listening]
            )
        except ServiceError as error:
            click.echo(f"preload: {error}", err=True)
            raise SystemExit(1) from error


def _allow_many_connections() -> None:
    """Lift the number of open files to what the system allows: connections that only wait must not use it up."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


#: Numbers of glibc's malloc.h: what is freed is given back beyond the first, what is larger than the second at once.
_M_TRIM_THRESHOLD, _KEPT_BYTES = -1, 12 * 2**20
_M_MMAP_THRESHOLD, _LARGE_BYTES = -3, 4 * 2**20
#: Heaps that threads share. By default each of eight a core keeps what its readers once took.
_M_ARENA_MAX, _N_HEAPS = -8, 2


def keep_freed_memory() -> None:
    """Let the C library keep what is freed for the next window, in place of giving it back to the system.

    A measurement that is judged frees several MiB. To get them anew, page by page, takes longer than to gate the
    windows on a virtual machine. glibc comes to such limits by itself once something as large was freed. In few heaps:
    with eight readers on 160 axes a service grew to 620 MiB in ten minutes and 770 in an hour, and stays at 270 so.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # other C libraries have none
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
        mallopt(_M_ARENA_MAX, _N_HEAPS)


def bound_socket(host: str, port: int) -> socket.socket:
    """Bind the port before anything is opened: a port in use gives one sentence, a free port (0) its number."""
    try:
        first_address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        family, kind, protocol, _, address = first_address
        # asyncio switches Nagle's delay (40 ms an answer) off only for sockets that say that they are TCP
        listening = socket.socket(family, kind, protocol)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
    except OSError as error:
        click.echo(f"preload: cannot listen on {host} port {port}: {error.strerror or error}", err=True)
        raise SystemExit(1) from error
    return listening
