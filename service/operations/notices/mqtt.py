"""Connect to an MQTT broker and publish messages; one counts as sent when the broker has acknowledged it."""

import json
import queue
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from preload_client.exchange import connect, exchange
from service.errors import DataFolderError
from service.operations.notices.receivers import Broker, read_secret, whom_to_believe
from service.operations.notices.senders import CLOUD_EVENT_TYPE, MOST_BYTES, TIMEOUT_S, NotTakenError, cloud_event
from service.store.tables import NoticeRow

try:
    from paho.mqtt import client as paho
    from paho.mqtt.enums import CallbackAPIVersion
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode
except ImportError as error:
    raise DataFolderError("MQTT needs paho-mqtt; pip install paho-mqtt") from error

JSON_TYPE = "application/json"
#: A connection in which nothing comes for one and a half times as long is lost.
KEEPALIVE_S = 30
#: The broker has taken a message, and nobody subscribes to it (MQTT 5, 3.4.2.1).
_NO_SUBSCRIBERS = 0x10
_CONNECTED = 0  # stands for the answer to CONNECT where others have the number of their message


@dataclass(frozen=True, slots=True)
class Message:
    """What is published, with QoS 1."""

    topic: str
    payload: bytes
    retain: bool = False
    content_type: str = JSON_TYPE
    correlation_data: bytes | None = None
    user_properties: tuple[tuple[str, str], ...] = ()
    expires_after_s: int | None = None  # until then a broker keeps it

    def properties(self, broker: Broker) -> Properties | None:
        """Return what MQTT 5 sends with it; None in MQTT 3.1.1."""
        if not broker.is_5:
            return None
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]  # the library's
        properties.ContentType = self.content_type
        if self.correlation_data is not None:
            properties.CorrelationData = self.correlation_data
        if self.expires_after_s is not None:
            properties.MessageExpiryInterval = self.expires_after_s
        if self.user_properties:
            properties.UserProperty = list(self.user_properties)
        return properties


class BoundedClient(paho.Client):
    """A client that begins its connection within an exchange, and takes no packet that is longer than it states."""

    refusal: str | None = None  # of what came

    def __init__(self, most_bytes: int, *arguments: Any, **more: Any) -> None:  # noqa: ANN401 - the library's
        super().__init__(*arguments, **more)
        self.most_bytes = most_bytes

    def _create_socket_connection(self) -> socket.socket:
        return connect(self._host, self._port)

    def _sock_recv(self, bufsize: int) -> bytes:
        if bufsize > self.most_bytes:  # what is missing of a packet
            self.refusal = f"the broker sends a packet that is longer than {self.most_bytes} bytes"
            raise OSError(self.refusal)
        return super()._sock_recv(bufsize)


def new_client(
    broker: Broker, client_id: str, *, keeps_session: bool = False, most_bytes: int = MOST_BYTES
) -> BoundedClient:
    """Return a client that is not connected yet; one that keeps its session acknowledges by itself what it took.

    Raises DataFolderError if the file of an authority cannot be read.
    """
    client = BoundedClient(
        most_bytes,
        CallbackAPIVersion.VERSION2,
        client_id=client_id,
        clean_session=None if broker.is_5 else not keeps_session,
        protocol=paho.MQTTv5 if broker.is_5 else paho.MQTTv311,
        reconnect_on_failure=False,
        manual_ack=keeps_session,
    )
    if broker.username is not None:
        secret = None if broker.password_file is None else read_secret(broker.password_file).get_secret_value()
        client.username_pw_set(broker.username, secret)
    if broker.tls:
        client.tls_set_context(whom_to_believe(broker.ca_file))
    return client


def begin(
    client: BoundedClient,
    broker: Broker,
    keepalive_s: int,
    *,
    session_expiry_s: int = 0,
    receive_maximum: int = 65535,
) -> None:
    """Open the connection of a client and ask the broker to take it. Raises NotTakenError if there is no answer."""
    properties = None
    if broker.is_5:
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # the library's
        properties.SessionExpiryInterval = session_expiry_s
        properties.ReceiveMaximum = receive_maximum
        properties.MaximumPacketSize = client.most_bytes
    clean: paho.CleanStartOption = session_expiry_s == 0 if broker.is_5 else paho.MQTT_CLEAN_START_FIRST_ONLY
    try:
        with exchange(TIMEOUT_S, MOST_BYTES):
            client.connect(broker.host, broker.resolved_port, keepalive_s, clean_start=clean, properties=properties)
    except (OSError, ValueError) as error:
        raise NotTakenError(f"no answer: {error}") from error


class Connection:
    """One connection, from its beginning until it is lost. What it did not hand over is not sent by itself again."""

    def __init__(self, broker: Broker, client_id: str = "", *, will: Message | None = None) -> None:
        """Connect. Raises NotTakenError if the broker does not answer, or does not let it."""
        self._broker = broker
        self._answers: queue.SimpleQueue[tuple[int, ReasonCode] | None] = queue.SimpleQueue()
        self.is_lost = False
        self._client = client = new_client(broker, client_id)
        client.on_connect = lambda *said: self._answers.put((_CONNECTED, said[3]))
        client.on_publish = lambda *said: self._answers.put((said[2], said[3]))
        client.on_disconnect = self._lose
        if will is not None:
            client.will_set(will.topic, will.payload, qos=1, retain=will.retain)
        begin(client, broker, KEEPALIVE_S)
        client.loop_start()
        try:
            self._await({_CONNECTED})
        except NotTakenError:
            self.close()
            raise

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Disconnect; the broker then does not publish the last will."""
        self._client.disconnect()
        self._client.loop_stop()

    def publish(self, *messages: Message) -> bool:
        """Publish until the broker has acknowledged all, and return whether somebody subscribes to each.

        MQTT 3.1.1 does not tell; then it is true. Raises NotTakenError unless the broker has acknowledged them.
        """
        sent = {
            self._client.publish(
                message.topic, message.payload, 1, message.retain, message.properties(self._broker)
            ).mid
            for message in messages
        }
        return all(code.value != _NO_SUBSCRIBERS for code in self._await(sent))

    def listen(self, topic: str, hear: Callable[[bytes], None]) -> None:
        """Call a function with each message of a topic; in another thread."""
        self._client.on_message = lambda *said: hear(said[2].payload)
        self._client.subscribe(topic, qos=1)

    def _await(self, sent: set[int]) -> list[ReasonCode]:
        due, codes = time.monotonic() + TIMEOUT_S, list[ReasonCode]()
        while sent:
            try:
                answer = self._answers.get(timeout=max(due - time.monotonic(), 0.0))
            except queue.Empty:
                raise NotTakenError(f"the broker did not acknowledge within {TIMEOUT_S:g} s") from None
            if answer is None:
                raise NotTakenError(self._client.refusal or "the broker closed the connection")
            number, code = answer
            if code.is_failure:
                raise NotTakenError(f"the broker refused it: {code}")
            sent.discard(number)
            codes.append(code)
        return codes

    def _lose(self, *_: object) -> None:
        self.is_lost = True
        self._answers.put(None)


class MqttSender:
    """Publishes CloudEvents, one connection for each: alarms are rare, and a connection that was lost says so at once.

    A notice is taken when the broker has acknowledged it and somebody subscribes to it.
    """

    def __init__(self, broker: Broker, source: str) -> None:
        self.name = broker.name
        self._broker = broker
        self._source = source

    def send(self, notice: NoticeRow) -> None:
        """Publish a notice; raises NotTakenError unless the broker acknowledges it for somebody."""
        message = Message(
            f"{self._broker.root}/{notice.subject}/alarms",
            json.dumps(cloud_event(notice, self._source), ensure_ascii=False).encode(),
            content_type=CLOUD_EVENT_TYPE,
            user_properties=(("id", str(notice.id)),),
        )
        with Connection(self._broker) as connection:
            if not connection.publish(message):
                raise NotTakenError(f"nobody subscribes to {message.topic}")
