"""MQTT brokers as processes of their own, which can be killed, and a client that hears and says."""

import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from service.operations.notices.receivers import Broker
from tests.conftest import free_port

#: Debian puts it where only root looks.
MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed on this machine")
#: The second of the two only before a release, unless it is the one that is there.
KINDS = [
    pytest.param("mosquitto", marks=needs_mosquitto),
    pytest.param("amqtt", marks=() if MOSQUITTO is None else pytest.mark.release),
]

AMQTT_CONFIGURATION = """\
listeners:
  default: {{type: tcp, bind: "127.0.0.1:{port}"}}
plugins:
  amqtt.plugins.authentication.AnonymousAuthPlugin: {{allow_anonymous: true}}
"""
MOSQUITTO_CONFIGURATION = """\
user root
listener {port} 127.0.0.1
allow_anonymous {anonymous}
max_queued_messages 0
"""


def wait_until(holds: Callable[[], bool], *, seconds: float = 60.0, what: str = "it") -> None:
    due = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < due, f"{what} did not happen in time"
        time.sleep(0.01)


@dataclass
class BrokerProcess:
    """A broker of one of two kinds on the loopback: mosquitto speaks MQTT 5, amqtt 3.1.1.

    It keeps everything in memory: one that is killed forgets sessions, subscriptions and messages.
    """

    kind: str
    folder: Path
    extra: str = ""  # of mosquitto's configuration
    port: int = field(default_factory=free_port)
    process: "subprocess.Popen[bytes] | None" = None

    @property
    def protocol(self) -> str:
        return "5" if self.kind == "mosquitto" else "3.1.1"

    def settings(self, **more: Any) -> Broker:
        return Broker(name="plant", host="127.0.0.1", port=self.port, protocol=self.protocol, **more)

    def start(self) -> "BrokerProcess":
        path = self.folder / f"{self.kind}.conf"
        if self.kind == "mosquitto":
            assert MOSQUITTO is not None
            text = MOSQUITTO_CONFIGURATION.format(port=self.port, anonymous=str(not self.extra).lower())
            path.write_text(text + self.extra)
            command = [MOSQUITTO, "-c", str(path)]
        else:
            path.write_text(AMQTT_CONFIGURATION.format(port=self.port))
            command = [sys.executable, "-m", "amqtt.scripts.broker_script", "-c", str(path)]
        with (self.folder / "broker.log").open("ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        wait_until(self.listens, what=f"the start of {self.kind}")
        return self

    def listens(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, (self.folder / "broker.log").read_text()[-2000:]
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()


def receivers_file(folder: Path, broker: BrokerProcess, more: str = "") -> Path:
    path = folder / "receivers.toml"
    path.write_text(
        f'[[mqtt]]\nname = "plant"\nhost = "127.0.0.1"\nport = {broker.port}\nprotocol = "{broker.protocol}"\n{more}'
    )
    return path


@dataclass
class Heard:
    """A message as it arrived."""

    topic: str
    payload: bytes
    properties: Any
    retained: bool


class Client:
    """Another program at the broker: it subscribes, publishes, and connects again whenever it has to."""

    def __init__(self, broker: BrokerProcess, *topics: str, client_id: str = "", keeps_session: bool = False) -> None:
        self.is_5 = broker.protocol == "5"
        self.heard: list[Heard] = []
        self._topics = topics
        self.client = paho.Client(
            CallbackAPIVersion.VERSION2,
            client_id=client_id,
            protocol=paho.MQTTv5 if self.is_5 else paho.MQTTv311,
            clean_session=None if self.is_5 else not keeps_session,
        )
        self.client.on_connect = self._subscribe
        self.client.on_message = lambda _c, _u, m: self.heard.append(Heard(m.topic, m.payload, m.properties, m.retain))
        self.n_subscribed = 0
        self.client.on_subscribe = self._subscribed
        self.client.reconnect_delay_set(0.05, 0.2)
        arguments: dict[str, Any] = {}
        if self.is_5 and keeps_session:
            properties = Properties(PacketTypes.CONNECT)
            properties.SessionExpiryInterval = 3600
            arguments = {"clean_start": False, "properties": properties}
        self.client.connect_async("127.0.0.1", broker.port, 30, **arguments)
        self.client.loop_start()
        wait_until(lambda: self.n_subscribed > 0 or (not topics and self.client.is_connected()), what="a subscription")

    def _subscribe(self, *_: object) -> None:
        for topic in self._topics:
            self.client.subscribe(topic, qos=1)

    def _subscribed(self, *_: object) -> None:
        self.n_subscribed += 1

    def publish(self, topic: str, payload: bytes, *, retain: bool = False, **properties: Any) -> None:
        """Publish with QoS 1 and the properties of MQTT 5 that are named."""
        with_it = None
        if self.is_5 and properties:
            with_it = Properties(PacketTypes.PUBLISH)
            for name, value in properties.items():
                setattr(with_it, name, value)
        self.client.publish(topic, payload, 1, retain, with_it)

    def of(self, topic: str) -> list[Heard]:
        return [message for message in list(self.heard) if message.topic == topic]

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


def certificate(folder: Path, uri: str = "urn:preload") -> None:
    """Write the certificate of a server on the loopback, which signs itself, and its key."""
    names = f"subjectAltName=IP:127.0.0.1,URI:{uri}"
    files = ["-keyout", folder / "key.pem", "-out", folder / "cert.pem"]
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    subprocess.run([*command, "-addext", names, *files], check=True, capture_output=True)
