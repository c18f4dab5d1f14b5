"""MQTT: alarms, states and presence go out through real brokers, whatever is killed meanwhile."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.clock import now
from service.errors import StorageError
from service.gateways.mqtt_windows import MqttSettings
from service.observability import Metrics
from service.operations.monitoring.trend import Trend
from service.operations.notices import dispatcher as dispatching, mqtt_states
from service.operations.notices.dispatcher import Dispatcher
from service.operations.notices.mqtt import MqttSender
from service.operations.notices.senders import NotTakenError
from service.store import notices
from service.store.database import Database
from service.store.tables import NoticeRow
from tests.conftest import PROJECT_ROOT, free_port
from tests.service.brokers import BrokerProcess, Client, certificate, needs_mosquitto, receivers_file, wait_until
from tests.service.conftest import running_service, simulated_measurement
from tests.service.test_lost_motion import reading, send
from tests.service.test_notices import losing_preload

N_KILLS = 20
#: Notices on their way while a broker is killed; one takes some hundredths of a second.
MOST_WAITING = 20


def test_an_alarm_is_a_cloud_event_and_states_are_retained(
    broker: BrokerProcess, client: Client, tmp_path: Path
) -> None:
    path = receivers_file(tmp_path, broker)
    with running_service(tmp_path / "var", receivers_file=path, public_url="http://preload.plant") as api:
        wait_until(lambda: bool(client.of("preload/plant/status")))
        assert client.of("preload/plant/status")[-1].payload == b"online"
        losing_preload(api)
        topic = "preload/plant/axes/axis/alarms"
        (alarm,) = api.http.get("/v1/alarms").json()["alarms"]
        wait_until(lambda: len(client.of(topic)) >= len(alarm["events"]))
        event = json.loads(client.of(topic)[0].payload)
        assert (event["specversion"], event["type"]) == ("1.0", "org.preload-monitor.alarm.raised")
        assert (event["source"], event["subject"]) == ("http://preload.plant", "axes/axis")
        assert "below the baseline" in event["data"]["sentence"]
        if client.is_5:
            said = client.of(topic)[0].properties
            assert said.ContentType == "application/cloudevents+json; charset=utf-8"
            assert said.UserProperty == [("id", event["id"])]
        assert not client.of(topic)[0].retained
        axis = api.axis("axis")
        wait_until(lambda: _told(client)["state"] == "alarm", what="the state of the alarm")
        told = _told(client)
        assert told["preload_n"] == axis["last_measurement"]["preload_n"]
        assert told["interval_95_n"] == axis["last_measurement"]["interval_95_n"]
        assert told["measured_at"] == axis["last_measurement"]["started_at"]
        assert told["state_since"] == axis["state_since"]
        assert told["valid_until"] is None  # no silence ends an alarm
        assert told["lost_motion"] is None
        send(api, "axis", [reading(np.random.default_rng(1), 0.0)])
        wait_until(lambda: _told(client)["lost_motion"] is not None, what="the lost motion")
        told = _told(client)
        assert told["lost_motion"] == api.axis("axis")["lost_motion"]
        late = Client(broker, "preload/plant/#")  # whoever comes later sees what is retained: presence and state
        wait_until(lambda: len(late.heard) >= 2)
        assert {(message.topic, message.retained) for message in late.heard} == {
            ("preload/plant/status", True),
            ("preload/plant/axes/axis/state", True),
        }
        assert json.loads(late.of("preload/plant/axes/axis/state")[0].payload) == told
        late.close()
    wait_until(lambda: client.of("preload/plant/status")[-1].payload == b"offline")


def _told(client: Client) -> dict[str, Any]:
    states = client.of("preload/plant/axes/axis/state")
    return json.loads(states[-1].payload) if states else {"state": None}


def test_the_last_will_says_that_a_service_was_killed(
    broker: BrokerProcess, client: Client, tmp_path: Path, fork_server: Callable[..., Any]
) -> None:
    path = receivers_file(tmp_path, broker)
    server = fork_server(tmp_path / "var", free_port(), PRELOAD_RECEIVERS_FILE=str(path))
    server.wait_until_up()
    wait_until(lambda: [message.payload for message in client.of("preload/plant/status")] == [b"online"])
    server.process.kill()
    wait_until(lambda: client.of("preload/plant/status")[-1].payload == b"offline")


def test_of_two_services_one_that_goes_leaves_the_other_online(
    broker: BrokerProcess, client: Client, tmp_path: Path
) -> None:
    path = receivers_file(tmp_path, broker)
    with running_service(tmp_path / "a", receivers_file=path):
        wait_until(lambda: len(client.of("preload/plant/status")) == 1)
        with running_service(tmp_path / "b", receivers_file=path):
            wait_until(lambda: len(client.of("preload/plant/status")) == 2)
        wait_until(lambda: [m.payload for m in client.of("preload/plant/status")][2:] == [b"offline", b"online"])


@pytest.mark.release
def test_a_silent_axis_becomes_unknown_at_the_broker_without_a_measurement(
    broker: BrokerProcess, client: Client, tmp_path: Path
) -> None:
    with running_service(tmp_path / "var", receivers_file=receivers_file(tmp_path, broker)) as api:
        silent_after_s = 6.0
        api.register("axis", windows_per_measurement=4, minimum_averages=4, silent_after_hours=silent_after_s / 3600.0)
        api.calibrate("axis")
        began = now()
        windows = simulated_measurement(np.random.default_rng(3), "m", n_windows=4, started_at=began)
        api.accept("axis", windows, complete=True)
        wait_until(lambda: _told(client)["state"] == "learning")
        assert _told(client)["valid_until"] > _told(client)["measured_at"]
        wait_until(lambda: _told(client)["state"] == "unknown")
        assert now() >= began + timedelta(seconds=silent_after_s)
        assert _told(client)["valid_until"] is None


def test_online_is_said_when_all_states_are_told_anew_and_said_again_before_it_expires(
    broker: BrokerProcess, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a client that comes back takes the states from before the outage for those of a service that is there."""
    monkeypatch.setattr(mqtt_states, "ONLINE_FOR_S", 6)
    monkeypatch.setattr(mqtt_states, "FIRST_PAUSE_S", 3.0)  # so that the client is back before the service
    with running_service(tmp_path / "var", receivers_file=receivers_file(tmp_path, broker)) as api:
        api.register("axis")
        wait_until(lambda: bool(client.of("preload/plant/axes/axis/state")), what="the state")
        broker.kill()
        client.heard.clear()
        api.register("axis", silent_after_hours=1.0)
        broker.start()
        wait_until(lambda: len(client.of("preload/plant/status")) >= 2, what="saying online again")
        assert [message.topic for message in client.heard][:2] == [
            "preload/plant/axes/axis/state",
            "preload/plant/status",
        ]
        assert client.of("preload/plant/status")[0].payload == b"online"
        if client.is_5:
            assert client.of("preload/plant/status")[0].properties.MessageExpiryInterval <= 6


def test_states_that_cannot_be_read_are_told_by_nobody_who_is_online(
    broker: BrokerProcess, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running_service(tmp_path / "var", receivers_file=receivers_file(tmp_path, broker)):
        wait_until(lambda: [message.payload for message in client.of("preload/plant/status")] == [b"online"])
        with monkeypatch.context() as damaged:
            damaged.setattr(Trend, "revisions", _unreadable)
            wait_until(lambda: client.of("preload/plant/status")[-1].payload == b"offline")
        wait_until(lambda: client.of("preload/plant/status")[-1].payload == b"online")


def _unreadable(_: Trend) -> dict[str, int]:
    raise StorageError("the disk is gone")


def test_the_broker_forgets_an_axis_that_is_archived(broker: BrokerProcess, client: Client, tmp_path: Path) -> None:
    topic = "preload/plant/axes/axis/state"
    with running_service(tmp_path / "var", receivers_file=receivers_file(tmp_path, broker)) as api:
        api.register("axis")
        wait_until(lambda: bool(client.of(topic)))
        api.http.post("/v1/axes/axis/archive").raise_for_status()
        wait_until(lambda: client.of(topic)[-1].payload == b"")
        api.http.delete("/v1/axes/axis/archive").raise_for_status()
        wait_until(lambda: client.of(topic)[-1].payload != b"")
        assert _told(client)["state"] == "unknown"


@needs_mosquitto
def test_an_alarm_that_nobody_subscribes_to_is_not_told(mosquitto: BrokerProcess) -> None:
    sender = MqttSender(mosquitto.settings(), "http://preload.plant")
    notice = NoticeRow(id=1, at=now(), kind="k", subject="axes/a", content={})
    with pytest.raises(NotTakenError, match="nobody subscribes to preload/plant/axes/a/alarms"):
        sender.send(notice)
    client = Client(mosquitto, "preload/+/axes/+/alarms")
    sender.send(notice)
    wait_until(lambda: len(client.heard) == 1)
    client.close()


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_no_answer_of_a_broker_is_a_sentence(protocol: str) -> None:
    broker = BrokerProcess("amqtt", Path())
    sender = MqttSender(broker.settings().model_copy(update={"protocol": protocol}), "http://preload.plant")
    with pytest.raises(NotTakenError, match="no answer"):
        sender.send(NoticeRow(id=1, at=now(), kind="k", subject="axes/a", content={}))


@needs_mosquitto
def test_a_password_and_tls_are_used(tmp_path: Path) -> None:
    certificate(tmp_path)
    (tmp_path / "password").write_text("wrong\n")
    subprocess.run(["mosquitto_passwd", "-b", "-c", tmp_path / "users", "preload", "right"], check=True)
    broker = BrokerProcess(
        "mosquitto",
        tmp_path,
        extra=f"certfile {tmp_path}/cert.pem\nkeyfile {tmp_path}/key.pem\npassword_file {tmp_path}/users\n",
    ).start()
    login = {"username": "preload", "password_file": tmp_path / "password"}
    notice = NoticeRow(id=1, at=now(), kind="k", subject="axes/a", content={})

    def send(**settings: Any) -> None:
        MqttSender(broker.settings(**login, **settings), "s").send(notice)

    try:
        with pytest.raises(NotTakenError, match="certificate verify failed"):
            send(tls=True)
        with pytest.raises(NotTakenError, match="Not authorized"):
            send(tls=True, ca_file=tmp_path / "cert.pem")
        (tmp_path / "password").write_text("right\n")
        with pytest.raises(NotTakenError, match="nobody subscribes"):  # so it was let in, over TLS
            send(tls=True, ca_file=tmp_path / "cert.pem")
    finally:
        broker.kill()


@pytest.mark.release
def test_kills_of_the_broker_lose_and_double_no_notice(
    broker: BrokerProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A subscriber that keeps ids sees each once and in order.

    amqtt acknowledges before it hands over: its part of the test says only that the service leaves nothing untold.
    """
    monkeypatch.setattr(dispatching, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(dispatching, "LONGEST_PAUSE_S", 0.2)
    monkeypatch.setattr(dispatching, "POLL_S", 0.01)
    database = Database(f"sqlite:///{tmp_path / 'preload.db'}")
    database.migrate()
    listener = Client(broker, "preload/plant/+/+/alarms", client_id="desk", keeps_session=True)
    dispatcher = Dispatcher(database, [MqttSender(broker.settings(), "s")], Metrics())
    dispatcher.start()
    going, told = threading.Event(), list[int]()

    def happen() -> None:
        while not going.is_set():
            if dispatcher.standings()[0].n_waiting < MOST_WAITING:  # else the last waits for all made in many starts
                with database.write() as session:
                    notices.add_notice(session, now(), "test", "axes/a", {"number": len(told)})
                told.append(len(told))
            time.sleep(0.01)

    thread = threading.Thread(target=happen)
    thread.start()
    rng = np.random.default_rng()
    for kills_left in reversed(range(N_KILLS + 1)):
        n = len(listener.heard)
        wait_until(lambda n=n: len(listener.heard) > n + 3, what="telling")
        if kills_left:
            time.sleep(rng.uniform(0.0, 0.05))
            broker.kill()
            broker.start()
    going.set()
    thread.join()
    wait_until(lambda: dispatcher.standings()[0].n_waiting == 0, what="the last notice")
    wait_until(lambda: json.loads(listener.heard[-1].payload)["data"]["number"] == told[-1], what="its arrival")
    dispatcher.close(5.0)
    listener.close()
    heard = [json.loads(message.payload) for message in listener.heard]
    by_id = {event["id"]: event["data"]["number"] for event in heard}
    assert all(by_id[event["id"]] == event["data"]["number"] for event in heard)
    numbers = [*by_id.values()]  # in the order in which each came first
    assert len(told) > 5 * N_KILLS
    assert numbers == sorted(set(numbers))
    if broker.kind == "mosquitto":
        assert numbers == told
    assert dispatcher.standings()[0].dead_letters == []
    database.close()


# --- without the extra -----------------------------------------------------------------------------------------------


@pytest.mark.release
@pytest.mark.parametrize("command", [["mqtt", "--url", "http://127.0.0.1:9"], ["serve", "--port", "0"]])
def test_without_the_extra_a_sentence_says_what_installs_it(command: list[str], tmp_path: Path) -> None:
    path = receivers_file(tmp_path, BrokerProcess("amqtt", tmp_path))
    hidden = tmp_path / "paho"
    hidden.mkdir()
    (hidden / "__init__.py").write_text("raise ImportError('hidden')\n")
    environment = os.environ | {
        "PRELOAD_RECEIVERS_FILE": str(path),
        "PRELOAD_DATA_DIR": str(tmp_path / "var"),
        "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", str(PROJECT_ROOT))]),
    }
    done = subprocess.run(
        [sys.executable, "-m", "service.cli.main", *command],
        env=environment, capture_output=True, text=True, timeout=60, check=False, cwd=PROJECT_ROOT,
    )  # fmt: skip
    assert done.returncode in (1, 2)
    assert done.stderr.splitlines()[-1] == "preload: MQTT needs paho-mqtt; pip install paho-mqtt"


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PRELOAD_MQTT_NAME", "plant")
    monkeypatch.setenv("PRELOAD_MQTT_TLS", "true")
    settings = MqttSettings()
    assert (settings.name, settings.host, settings.resolved_port) == ("plant", "127.0.0.1", 8883)
    monkeypatch.setenv("PRELOAD_MQTT_NAME", "plant/#")
    with pytest.raises(ValueError, match="pattern"):
        MqttSettings()
