"""``preload mqtt --url URL``: take windows from an MQTT broker to a running service."""

import signal
import threading

import click

from service.cli.options import url_option, who_asks
from service.observability import configure_logging


@click.command()
@url_option
def mqtt(url: str) -> None:
    """Take windows from an MQTT broker to a service, until it is stopped.

    Settings come from the environment (PRELOAD_MQTT_*), the key of the service from PRELOAD_KEY.
    """
    from service.gateways.mqtt_windows import MqttSettings, WindowsGateway  # noqa: PLC0415  # an extra

    configure_logging("INFO")
    gateway = WindowsGateway(MqttSettings(), url, *who_asks())
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    gateway.run(stopping)
