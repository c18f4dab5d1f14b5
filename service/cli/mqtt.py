"""``preload mqtt --url URL``: take windows from an MQTT broker to a running service."""

import os
import signal
import threading

import click

from service.cli.options import url_option
from service.observability import configure_logging


@click.command()
@url_option
def mqtt(url: str) -> None:
    """Take windows from an MQTT broker to a service, until it is stopped.

    Settings come from the environment (PRELOAD_MQTT_*), the key of the service from PRELOAD_KEY.
    """
    if not url.startswith(("http://", "https://")):
        raise click.ClickException(f"--url must be an address like http://127.0.0.1:8710; got {url}")
    from service.gateways.mqtt_windows import MqttSettings, WindowsGateway  # noqa: PLC0415  # an extra

    configure_logging("INFO")
    gateway = WindowsGateway(MqttSettings(), url, os.environ.get("PRELOAD_KEY"), os.environ.get("PRELOAD_CA_FILE"))
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    gateway.run(stopping)
