"""Forward windows from an MQTT broker to the service; each is acknowledged when it is on disk."""

import logging
import queue
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING
from urllib.parse import quote

import httpx
from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from preload_client.exchange import Transport, exchange
from service.api.http.body import JSON_TYPE, MSGPACK_TYPE
from service.api.http.problems import MEDIA_TYPE as PROBLEM_TYPE
from service.operations.notices.mqtt import Message, begin, new_client
from service.operations.notices.receivers import Broker, Name, whom_to_believe
from service.operations.notices.senders import NotTakenError

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode

log = logging.getLogger(__name__)

#: The broker sends so many messages before the first of them is acknowledged. Each may hold many windows, in memory.
RECEIVE_MAXIMUM = 4
#: MQTT itself has no longer packets. What is too long for the service is taken, so that the sender is told.
MOST_BYTES = 2**28 - 1
#: While so much waits for the service, messages of QoS 0, which no broker holds back, are dropped. Each is counted with
#: what it takes beside its payload.
MOST_WAITING_BYTES, BYTES_OF_MESSAGE = 2**26, 1024
#: So long a broker that keeps sessions keeps what comes while the gateway is away [s].
SESSION_EXPIRY_S = 7 * 24 * 3600
#: The service has so long to store a message, beside the time that sending it takes. A connection to the broker that is
#: silent for so long is asked whether it is still there, also while the service is at work, and lost if it is not.
TIMEOUT_S, KEEPALIVE_S = 60.0, 120
#: And may answer with so much: some hundred bytes for each window of a message.
MOST_OF_ANSWER = 2**24
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 30.0
#: What may be otherwise the next time. With any other refusal it is the message that has to change.
_LATER = frozenset({401, 408, 425, 429, 502, 503, 504})


class MqttSettings(Broker, BaseSettings):
    """What an operator may set. Each name is read from the environment with the prefix ``PRELOAD_MQTT_``."""

    model_config = SettingsConfigDict(env_prefix="PRELOAD_MQTT_", extra="forbid", frozen=True)

    name: Name = Field(default="preload")
    host: str = "127.0.0.1"


class ServiceAwayError(Exception):
    """The service does not take anything at present."""


@dataclass(slots=True)
class _Taken:
    """A message that the broker waits for the acknowledgement of."""

    number: int
    is_done: bool = False


class WindowsGateway:
    """Takes each message to ``POST /v1/axes/{axis}/windows``, one after the other, in one thread.

    Another thread, the library's, speaks with the broker meanwhile, and says here what came. Whatever fails on the way,
    the message is not acknowledged: the connection is closed, and in the next one the broker sends it again. The
    service recognises windows that it has.
    """

    def __init__(self, broker: Broker, url: str, key: str | None, ca_file: str | None = None) -> None:
        self._broker = broker
        headers = {"authorization": f"Bearer {key}"} if key else None
        self._http = httpx.Client(base_url=url, headers=headers, transport=Transport(whom_to_believe(ca_file)))
        name = f"preload-{broker.name}-windows"
        self._client = client = new_client(broker, name, keeps_session=True, most_bytes=MOST_BYTES)
        client.on_connect = self._connected
        client.on_subscribe = self._subscribed
        client.on_message = self._came
        client.on_publish = lambda _client, _, *said: self._events.put(partial(self._answer_was_taken, *said))
        client.on_disconnect = self._lost
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._problem: str | None = None  # why this connection is of no use any more
        self._has_taken = False  # anything, in this connection
        self._came_bytes = self._handled_bytes = 0  # in this connection: the one is the library's thread's to count
        self._has_dropped = False
        self._waiting: deque[_Taken] = deque()  # in their order, in which they must be acknowledged
        self._answers: dict[int, _Taken] = {}  # by the number of the answer that is on its way

    def run(self, stopping: threading.Event) -> None:
        """Take windows until it is to stop."""
        pause_s = FIRST_PAUSE_S
        while not stopping.is_set():
            self._has_taken = False
            problem = self._serve(stopping)
            if problem is not None:
                pause_s = FIRST_PAUSE_S if self._has_taken else pause_s
                log.warning("no windows are taken, next try in %.1f s: %s", pause_s, problem)
                stopping.wait(pause_s)
                pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
        self._http.close()

    def _serve(self, stopping: threading.Event) -> str | None:
        """Take windows in one connection, and return why it ended if nobody asked for it."""
        self._problem, self._events = None, queue.SimpleQueue()
        self._came_bytes = self._handled_bytes = 0
        self._has_dropped = False
        self._waiting.clear()  # the broker numbers them anew
        self._answers.clear()
        try:
            begin(
                self._client,
                self._broker,
                KEEPALIVE_S,
                session_expiry_s=SESSION_EXPIRY_S,
                receive_maximum=RECEIVE_MAXIMUM,
            )
        except NotTakenError as error:
            return f"broker: {error}"
        self._client.loop_start()
        while self._problem is None and not stopping.is_set():
            with suppress(queue.Empty):
                self._events.get(timeout=0.5)()
        problem = self._problem
        self._client.disconnect()
        self._client.loop_stop()
        return problem

    def _connected(
        self, client: "Client", _: object, flags: "ConnectFlags", reason: "ReasonCode", properties: "Properties | None"
    ) -> None:
        del flags, properties
        if reason.is_failure:
            self._problem = f"the broker refused the connection: {reason}"
        else:
            client.subscribe(self._broker.axis_topic("+", "windows"), qos=1)

    def _subscribed(
        self, client: "Client", _: object, number: int, reasons: "list[ReasonCode]", properties: "Properties | None"
    ) -> None:
        del client, number, properties
        if any(reason.is_failure for reason in reasons):
            self._problem = f"the broker refused the subscription: {reasons[0]}"
        else:
            log.info("windows are taken from %s", self._broker.axis_topic("+", "windows"))

    def _lost(
        self,
        client: "Client",
        _: object,
        flags: "DisconnectFlags",
        reason: "ReasonCode",
        properties: "Properties | None",
    ) -> None:
        del client, flags, properties
        self._problem = self._problem or f"the connection to the broker was lost ({reason})"

    def _came(self, client: "Client", _: object, message: "MQTTMessage") -> None:
        del client
        if message.qos == 0 and self._came_bytes - self._handled_bytes > MOST_WAITING_BYTES:
            if not self._has_dropped:
                log.warning("windows come faster than the service takes them: messages of QoS 0 are dropped")
            self._has_dropped = True
            return
        self._came_bytes += len(message.payload) + BYTES_OF_MESSAGE
        self._events.put(partial(self._take, message))

    def _take(self, message: "MQTTMessage") -> None:
        self._handled_bytes += len(message.payload) + BYTES_OF_MESSAGE
        axis = message.topic.removeprefix(f"{self._broker.root}/axes/").removesuffix("/windows")
        try:
            answer = self._post(axis, message)
        except ServiceAwayError as error:
            self._problem = str(error)
            return
        self._has_taken = True
        taken = _Taken(message.mid)
        if message.qos > 0:
            self._waiting.append(taken)
        reply = self._answer(axis, message, answer)
        if reply is None:
            taken.is_done = True
        else:
            number = self._client.publish(reply.topic, reply.payload, 1, properties=reply.properties(self._broker)).mid
            self._answers[number] = taken
        self._acknowledge()

    def _answer_was_taken(self, number: int, reason: "ReasonCode", properties: "Properties | None") -> None:
        del properties
        if reason.is_failure:
            log.warning("the broker refused an answer: %s", reason)
        if (taken := self._answers.pop(number, None)) is not None:
            taken.is_done = True
            self._acknowledge()

    def _acknowledge(self) -> None:
        while self._waiting and self._waiting[0].is_done:
            self._client.ack(self._waiting.popleft().number, 1)

    def _post(self, axis: str, message: "MQTTMessage") -> httpx.Response:
        """Hand a message over to the service. Raises ServiceAwayError unless it was stored, or refused for good."""
        path = f"/v1/axes/{quote(axis, safe='').replace('.', '%2E')}/windows"
        headers = {"content-type": content_type_of(message)}
        try:
            with exchange(TIMEOUT_S, MOST_OF_ANSWER):
                answer = self._http.post(path, content=bytes(message.payload), headers=headers)
        except httpx.TransportError as error:
            raise ServiceAwayError(f"no answer of the service: {error}") from error
        is_from_service = answer.is_success or answer.headers.get("content-type") == PROBLEM_TYPE
        if answer.status_code in _LATER or not is_from_service:
            raise ServiceAwayError(f"the service answered with {answer.status_code}: {answer.text[:200]}")
        return answer

    def _answer(self, axis: str, message: "MQTTMessage", answer: httpx.Response) -> Message | None:
        """Return what the sender is told: all that it asked for, else only a refusal."""
        asked = getattr(message.properties, "ResponseTopic", "")
        if asked.startswith(f"{self._broker.root}/answers/") and not {"+", "#", "\0"} & set(asked):
            topic = asked
        elif not answer.is_success:
            topic = self._broker.axis_topic(axis, "windows/refused")
            log.warning("windows of axis %s were refused: %s", axis, answer.text[:500])
        else:
            return None
        return Message(
            topic,
            answer.content,
            content_type=answer.headers["content-type"],
            correlation_data=getattr(message.properties, "CorrelationData", None),
            user_properties=(("status", str(answer.status_code)),),
        )


def content_type_of(message: "MQTTMessage") -> str:
    """Return the content type that a message says, or else that its first byte shows: no MessagePack map is ASCII."""
    stated: str | None = getattr(message.properties, "ContentType", None)
    if stated is None:
        return JSON_TYPE if message.payload[:1].isascii() else MSGPACK_TYPE
    return stated if stated.isascii() and stated.isprintable() else ascii(stated)[:100]
