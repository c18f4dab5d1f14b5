"""MQTT: windows come in through real brokers, whatever is killed meanwhile."""

import base64
import json
import multiprocessing
import os
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest
from paho.mqtt.client import MQTTMessage

from monitor_core.recording import Window
from service.api.http.body import JSON_TYPE, MSGPACK_TYPE
from service.cli.main import main
from service.cli.remote.client import window_document
from service.gateways import mqtt_windows
from service.gateways.mqtt_windows import MqttSettings, WindowsGateway
from service.operations.access.scopes import Scope
from tests.conftest import free_port
from tests.service.brokers import BrokerProcess, Client, needs_mosquitto, wait_until
from tests.service.conftest import Api, ServerProcess, simulated_measurement
from tests.service.test_access import PASSWORD, Closed, served
from tests.service.test_kill import stored_windows

N_KILLS = 20


def gateway_as(url: str, environment: dict[str, str], log: Path) -> None:
    """Be ``preload mqtt`` in a process that has imported it already."""
    with log.open("wb") as output:
        os.dup2(output.fileno(), sys.stdout.fileno())
        os.dup2(output.fileno(), sys.stderr.fileno())
    os.environ.update(environment)
    sys.argv = ["preload", "mqtt", "--url", url]
    main()


@pytest.fixture
def start_gateway(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Start ``preload mqtt`` as a process, forked from one that has only imported it."""
    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload([__name__])
    started: list[Any] = []

    def start(broker: BrokerProcess, url: str, **environment: str) -> Any:
        settings = {
            "PRELOAD_MQTT_NAME": "plant",
            "PRELOAD_MQTT_PORT": str(broker.port),
            "PRELOAD_MQTT_PROTOCOL": broker.protocol,
        }
        log = tmp_path / f"gateway-{len(started)}.log"
        log.touch()
        process = forks.Process(target=gateway_as, args=(url, settings | environment, log))
        process.start()
        started.append(process)
        wait_until(lambda: b"windows are taken from" in log.read_bytes(), what="the subscription")
        return process

    yield start
    for process in started:
        process.kill()
        process.join()


def packed(windows: list[Window], *, complete: bool = False) -> bytes:
    return msgpack.packb({"windows": [window_document(window) for window in windows], "complete": complete})


def as_json(window: Window) -> bytes:
    document = window_document(window)
    samples = {name: base64.b64encode(value).decode() for name, value in document.items() if isinstance(value, bytes)}
    return json.dumps(document | samples).encode()


def measurement(n_windows: int = 4, seed: int = 3) -> list[Window]:
    return simulated_measurement(np.random.default_rng(seed), "m", n_windows=n_windows)


def test_windows_are_stored_in_either_encoding(
    broker: BrokerProcess, api: Api, start_gateway: Callable[..., Any]
) -> None:
    api.register("axis.1", windows_per_measurement=4)
    start_gateway(broker, str(api.http.base_url))
    client, windows = Client(broker), measurement()
    client.publish("preload/plant/axes/axis.1/windows", packed(windows[:1]), ContentType=MSGPACK_TYPE)
    client.publish("preload/plant/axes/axis.1/windows", as_json(windows[1]), ContentType=JSON_TYPE)
    client.publish("preload/plant/axes/axis.1/windows", packed(windows[2:3]))  # what says nothing is recognised
    client.publish("preload/plant/axes/axis.1/windows", as_json(windows[3]))
    wait_until(lambda: len(stored_windows(api.data_dir, "axis.1")) == 4, what="storing")
    next_day = [replace(window, started_at=window.started_at + timedelta(days=1)) for window in windows]
    client.publish("preload/plant/axes/axis.1/windows", packed(next_day))
    wait_until(lambda: len(stored_windows(api.data_dir, "axis.1")) == 8, what="storing")
    client.close()
    assert [point["measurement"] for point in api.trend("axis.1")] == ["m", "m"]  # a name and a time


@needs_mosquitto
def test_an_answer_goes_where_the_sender_asked_for_it(
    mosquitto: BrokerProcess, api: Api, start_gateway: Callable[..., Any]
) -> None:
    api.register("axis")
    start_gateway(mosquitto, str(api.http.base_url))
    client = Client(mosquitto, "preload/plant/answers/#", "preload/plant/axes/+/windows/refused", "valve/#")
    topic, asked = "preload/plant/axes/axis/windows", "preload/plant/answers/daq-1"
    body = packed(measurement(1))
    for number in (b"1", b"2"):
        client.publish(topic, body, ContentType=MSGPACK_TYPE, ResponseTopic=asked, CorrelationData=number)
    client.publish(topic, b"{}", ContentType=JSON_TYPE, ResponseTopic=asked, CorrelationData=b"3")
    client.publish(topic, b"{}", ContentType=JSON_TYPE, ResponseTopic="valve/open", CorrelationData=b"4")
    wait_until(lambda: len(client.heard) == 4)
    answers = [(m.topic, m.properties.CorrelationData, dict(m.properties.UserProperty)["status"]) for m in client.heard]
    assert answers == [
        (asked, b"1", "201"),
        (asked, b"2", "200"),
        (asked, b"3", "422"),
        ("preload/plant/axes/axis/windows/refused", b"4", "422"),
    ]
    first, second, third, _ = (json.loads(message.payload) for message in client.heard)
    assert (first["accepted"], second["accepted"], second["already_there"]) == (1, 0, 1)
    assert third["type"] == "urn:preload-monitor:problem:invalid-request"
    assert client.heard[2].properties.ContentType == "application/problem+json"
    client.close()


def test_what_is_refused_holds_nothing_up(broker: BrokerProcess, api: Api, start_gateway: Callable[..., Any]) -> None:
    api.register("axis")
    start_gateway(broker, str(api.http.base_url))
    client, (window, other) = Client(broker, "preload/plant/axes/+/windows/refused"), measurement(2)
    contradicting = window_document(window) | {"payload_kg": 3.0}
    client.publish("preload/plant/axes/axis/windows", as_json(window))
    client.publish("preload/plant/axes/axis/windows", msgpack.packb(contradicting))
    client.publish("preload/plant/axes/nobody/windows", as_json(window))
    client.publish("preload/plant/axes/../windows", as_json(window))
    client.publish("preload/plant/axes/axis/windows", b"\xff\xfe")
    client.publish("preload/plant/axes/axis/windows", b"")
    client.publish("preload/plant/axes/axis/windows", as_json(window), ContentType="Wörter")
    client.publish("preload/plant/axes/axis/windows", as_json(other))
    wait_until(lambda: len(stored_windows(api.data_dir, "axis")) == 2, what="storing")
    n_refused = 6 if client.is_5 else 5
    wait_until(lambda: len(client.heard) == n_refused)
    problems = [json.loads(message.payload) for message in client.heard]
    said = [(p["status"], p["type"].rpartition(":")[2]) for p in problems]
    assert said[:4] == [
        (409, "conflict"),
        (404, "unknown-resource"),
        (422, "invalid-request"),
        (400, "unreadable-body"),
    ]
    client.close()


def test_what_nobody_holds_back_is_dropped_above_a_bound(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Of QoS 0 alone: what is acknowledged is bounded by the broker, and promised."""
    monkeypatch.setattr(mqtt_windows, "MOST_WAITING_BYTES", 2**20)
    gateway, taken = WindowsGateway(MqttSettings(), "http://127.0.0.1:9", None), list[int]()
    monkeypatch.setattr(gateway, "_post", lambda _, message: taken.append(message.qos) or httpx.Response(201))
    message = MQTTMessage(topic=b"preload/preload/axes/axis/windows")
    message.payload = bytes(2**18)
    urgent = MQTTMessage(topic=message.topic.encode())
    urgent.qos, urgent.payload = 1, message.payload

    def flood() -> list[int]:
        """Return of which QoS what is taken is, if the service stands still while everything comes."""
        taken.clear()
        for _ in range(50):
            gateway._client.on_message(gateway._client, None, message)
        for _ in range(7):
            gateway._client.on_message(gateway._client, None, urgent)
        while not gateway._events.empty():
            gateway._events.get()()
        return list(taken)

    assert flood() == flood() == [0] * 4 + [1] * 7  # four are above the bound with what each takes beside
    assert sum("QoS 0" in record.message for record in caplog.records) == 1


def slow_service(begun: list[float], takes_s: float) -> type[BaseHTTPRequestHandler]:
    """Return a service that takes its time for each body, and then has stored it."""

    class Slow(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            begun.append(time.monotonic())
            self.rfile.read(int(self.headers["content-length"]))
            time.sleep(takes_s)
            self.send_response(201)
            self.send_header("content-length", "0")
            self.end_headers()

    return Slow


@pytest.mark.release
@needs_mosquitto  # amqtt lets a silent client be
def test_the_broker_is_answered_while_the_service_is_at_work(
    mosquitto: BrokerProcess, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Else it takes the gateway for gone, and sends again what is on its way to the disk."""
    monkeypatch.setattr(mqtt_windows, "KEEPALIVE_S", 1)
    caplog.set_level("INFO")
    begun, stopping = list[float](), threading.Event()
    slow = slow_service(begun, 8.0)  # mosquitto looks every five seconds who is silent
    with ThreadingHTTPServer(("127.0.0.1", 0), slow) as server, ThreadPoolExecutor(2) as threads:
        threads.submit(server.serve_forever)
        gateway = WindowsGateway(mosquitto.settings(), f"http://127.0.0.1:{server.server_address[1]}", None)
        ended = threads.submit(gateway.run, stopping)
        wait_until(lambda: "windows are taken" in caplog.text, what="the subscription")
        client = Client(mosquitto)
        client.publish("preload/plant/axes/axis/windows", packed(measurement(1)))
        client.publish("preload/plant/axes/axis/windows", packed(measurement(1)))
        wait_until(lambda: len(begun) == 2, what="the second message")
        stopping.set()
        ended.result()
        server.shutdown()
        client.close()
    assert "connection to the broker was lost" not in caplog.text


def test_a_key_is_needed_where_the_service_asks_for_one(
    broker: BrokerProcess, tmp_path: Path, start_gateway: Callable[..., Any]
) -> None:
    with served(tmp_path / "var") as (app, http):
        service, api = Closed(app, http), Api(http, tmp_path / "var")
        api.register("mine")
        api.register("other")
        service.people.add_user("anna", "administrator", PASSWORD)
        key = service.key(Scope.WINDOWS_WRITE, axes=("mine",)).removeprefix("Bearer ")
        start_gateway(broker, str(http.base_url), PRELOAD_KEY=key)
        client = Client(broker, "preload/plant/axes/+/windows/refused")
        client.publish("preload/plant/axes/other/windows", packed(measurement(1)))
        client.publish("preload/plant/axes/mine/windows", packed(measurement(1)))
        wait_until(lambda: len(stored_windows(tmp_path / "var", "mine")) == 1, what="storing")
        wait_until(lambda: len(client.heard) == 1)
        assert json.loads(client.heard[0].payload)["status"] == 403
        assert stored_windows(tmp_path / "var", "other") == []
        client.close()


@pytest.mark.release
@needs_mosquitto  # amqtt does not send again what was not acknowledged
def test_while_the_service_is_away_the_broker_keeps_the_windows(
    mosquitto: BrokerProcess,
    tmp_path: Path,
    start_gateway: Callable[..., Any],
    start_server: Callable[..., ServerProcess],
) -> None:
    port, windows = free_port(), measurement(12)
    server = start_server(tmp_path / "var", port)
    server.wait_until_up()
    with httpx.Client(base_url=server.url, trust_env=False, timeout=60.0) as http:
        Api(http, tmp_path / "var").register("axis", windows_per_measurement=50)
    start_gateway(mosquitto, server.url)
    client = Client(mosquitto)
    for window in windows[:3]:
        client.publish("preload/plant/axes/axis/windows", packed([window]))
    wait_until(lambda: len(stored_windows(tmp_path / "var", "axis")) == 3, what="storing")
    server.process.kill()
    server.process.wait()
    for window in windows[3:]:
        client.publish("preload/plant/axes/axis/windows", packed([window]))
    time.sleep(1.0)  # the gateway tries in vain
    server = start_server(tmp_path / "var", port)
    server.wait_until_up()
    wait_until(lambda: stored_windows(tmp_path / "var", "axis") == starts_of(windows), what="storing the rest")
    client.close()


def starts_of(windows: list[Window]) -> list[str]:
    return [window.started_at.isoformat() for window in windows]


def many_windows() -> list[Window]:
    """Return windows of many measurements."""
    return [replace(window, measurement=f"m{i // 15}") for i, window in enumerate(measurement(1500))]


def count_stored(api: Api) -> int:
    with sqlite3.connect(f"file:{api.data_dir / 'preload.db'}?mode=ro", uri=True) as connection:
        (count,) = connection.execute("SELECT count(*) FROM windows").fetchone()
    connection.close()
    return int(count)


@dataclass
class Sender:
    """Publishes window after window, and again and again until each is answered."""

    client: Client
    windows: list[Window]
    asked: str
    published: dict[str, Window] = field(default_factory=dict)
    n_published: int = 0
    ending: threading.Event = field(default_factory=threading.Event)

    def answered(self) -> set[str]:
        return {message.properties.CorrelationData.decode() for message in list(self.client.heard)}

    def run(self) -> None:
        for window in self.windows:
            if self.ending.is_set():
                break
            self.publish(window)
            time.sleep(0.05)
        while missing := self.published.keys() - self.answered():
            for start in sorted(missing):
                self.publish(self.published[start])
            time.sleep(1.0)

    def publish(self, window: Window) -> None:
        start = window.started_at.isoformat()
        self.published[start] = window
        self.n_published += 1
        answer = {"ResponseTopic": self.asked, "CorrelationData": start.encode()}
        self.client.publish("preload/plant/axes/axis/windows", packed([window]), ContentType=MSGPACK_TYPE, **answer)

    @contextmanager
    def running(self) -> Iterator[None]:
        thread = threading.Thread(target=self.run)
        thread.start()
        try:
            yield
        finally:
            self.ending.set()
            thread.join(timeout=120.0)
        assert not thread.is_alive()


@needs_mosquitto
@pytest.mark.release
def test_kills_of_the_gateway_lose_and_double_no_window(
    mosquitto: BrokerProcess, api: Api, start_gateway: Callable[..., Any]
) -> None:
    """Each window is published once: what was not on disk is not acknowledged, and comes again."""
    api.register("axis", windows_per_measurement=15)
    client, rng = Client(mosquitto, "preload/plant/axes/+/windows/refused"), np.random.default_rng()
    windows, gateway = many_windows()[: 20 * N_KILLS], start_gateway(mosquitto, str(api.http.base_url))
    n_kills_before_the_last = 0
    for first in range(0, len(windows), 20):
        n = count_stored(api)
        for window in windows[first : first + 20]:
            client.publish("preload/plant/axes/axis/windows", packed([window]), ContentType=MSGPACK_TYPE)
        wait_until(lambda n=n: count_stored(api) > n, what="storing")
        time.sleep(rng.uniform(0.0, 0.02))
        gateway.kill()
        gateway.join()
        n_kills_before_the_last += count_stored(api) < first + 20
        gateway = start_gateway(mosquitto, str(api.http.base_url))
    wait_until(lambda: count_stored(api) >= len(windows), what="storing the rest")
    assert stored_windows(api.data_dir, "axis") == starts_of(windows)
    assert n_kills_before_the_last >= N_KILLS // 2  # the kill fell among windows that were on their way
    assert client.heard == []
    client.close()


@needs_mosquitto
@pytest.mark.release
def test_kills_of_the_broker_lose_and_double_no_window(
    mosquitto: BrokerProcess, api: Api, start_gateway: Callable[..., Any]
) -> None:
    """A broker that is killed forgets what it acknowledged: the sender keeps a window until it is answered."""
    api.register("axis", windows_per_measurement=15)
    asked = "preload/plant/answers/daq"
    client, rng = Client(mosquitto, asked, "preload/plant/axes/+/windows/refused"), np.random.default_rng()
    sender = Sender(client, many_windows(), asked)
    start_gateway(mosquitto, str(api.http.base_url))
    with sender.running():
        for _ in range(N_KILLS):
            n = len(sender.answered())
            wait_until(lambda n=n: len(sender.answered()) > n + 2, what="answering")
            time.sleep(rng.uniform(0.0, 0.1))
            mosquitto.kill()
            mosquitto.start()
    assert stored_windows(api.data_dir, "axis") == [*sender.published]
    assert {dict(message.properties.UserProperty)["status"] for message in client.heard} <= {"200", "201"}
    assert sender.n_published > len(sender.published) > 3 * N_KILLS  # some were forgotten, and sent again
    client.close()
