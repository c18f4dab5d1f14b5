"""``preload opcua --url URL``: show the axes of a running service to OPC UA clients."""

import asyncio
import logging
import signal

import click

from service.cli.options import url_option, who_asks
from service.errors import DataFolderError
from service.observability import configure_logging


@click.command()
@url_option
def opcua(url: str) -> None:
    """Show preload, state and alarms of a service to OPC UA clients, until it is stopped.

    Settings come from the environment (PRELOAD_OPCUA_*), the key of the service from PRELOAD_KEY.
    """
    try:
        import asyncua  # noqa: F401, PLC0415  # an extra
    except ImportError as error:
        raise DataFolderError("OPC UA needs asyncua; pip install asyncua") from error
    from service.gateways.opcua_server import OpcuaSettings, serve_opcua  # noqa: PLC0415

    configure_logging("INFO")
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    settings = OpcuaSettings()

    async def run() -> None:
        stopping = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stopping.set)
        key, ca_file = who_asks()
        await serve_opcua(settings, url, key, stopping, ca_file)

    asyncio.run(run())
