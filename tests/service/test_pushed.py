"""What others are told stays true over the bundled slow wear and over an outage: OPC UA, MQTT, webhook and mail."""

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email import message_from_bytes, policy
from pathlib import Path
from typing import Any

import asyncua
import httpx
import pytest
from aiosmtpd.controller import Controller
from asyncua import ua

from monitor_core.recording import Window
from monitor_core.recordings import open_session
from service.cli.demo import CALIBRATION, demonstration_axis, replay_bundled
from service.cli.remote.client import Client
from service.gateways import opcua_server
from service.settings import BUNDLED_SESSIONS
from tests.conftest import free_port
from tests.service import brokers, test_notices
from tests.service.conftest import Api, ServerProcess
from tests.service.test_opcua import gateway, until
from tests.service.test_opcua_subscriptions import PERIOD_MS, Shown

pytestmark = [pytest.mark.release, brokers.needs_mosquitto]
DEADBANDS_N = (None, 10.0, 30.0)
STATE, STATUS = "preload/plant/axes/axis/state", "preload/plant/status"


def slow_wear() -> Iterator[tuple[Window, ...]]:
    """Yield the windows of each measurement: 303 → 176 N."""
    with open_session(BUNDLED_SESSIONS / "slow-wear.session.h5") as reader:
        for name in reader.measurements:
            yield reader.windows_of(name)


def prepare(url: str) -> None:
    """Register the axis of the bundled sessions with its calibration."""
    settings = {"name": "axis", "configuration": demonstration_axis(BUNDLED_SESSIONS)}
    with Client(url) as client:
        client.put(f"/v1/axes/{CALIBRATION}", settings)
        replay_bundled(client, BUNDLED_SESSIONS, CALIBRATION, "calibration")
        fitted = client.post(f"/v1/axes/{CALIBRATION}/calibrations", {"measurements": {}, "comment": "test"})
        client.put("/v1/axes/axis", settings)
        own = client.post("/v1/axes/axis/calibrations", {"document": fitted["document"], "comment": "test"})
        client.post(f"/v1/axes/axis/calibrations/{own['id']}/activate", {"reason": "test"})


@dataclass
class Post:
    """A mail server that can be away."""

    port: int = field(default_factory=free_port)
    mails: list[bytes] = field(default_factory=list)

    async def handle_DATA(self, _server: object, _session: object, envelope: Any) -> str:  # noqa: N802
        self.mails.append(envelope.content)
        return "250 taken"

    @contextmanager
    def listening(self) -> Iterator[None]:
        server = Controller(self, hostname="127.0.0.1", port=self.port)
        server.start()
        try:
            yield
        finally:
            server.stop()

    def told(self) -> list[tuple[str, str]]:
        """Return the id of each mail and what it says has happened."""
        read = [message_from_bytes(mail, policy=policy.default) for mail in self.mails]
        return [(mail["Message-ID"].partition(".")[0].lstrip("<"), mail["Subject"].split()[-1]) for mail in read]


@dataclass
class Seen:
    """What a client of each face shows of the axis."""

    opcua: dict[float | None, Shown]
    mqtt: brokers.Client

    def holds(self, preload: float) -> bool:
        """Return whether each of them is within its tolerance of the truth."""
        last = {deadband: each.told[-1] for deadband, each in self.opcua.items()}
        quality = last[None][0]
        return json.loads(self.mqtt.of(STATE)[-1].payload)["preload_n"] == preload and all(
            status == quality and status.startswith(("Good", "Uncertain"))
            and value is not None and abs(value - preload) <= (deadband or 0.0)
            for deadband, (status, value) in last.items()
        )  # fmt: skip


async def subscribed(client: asyncua.Client, deadband_n: float | None) -> Shown:
    shown = Shown()
    subscription = await client.create_subscription(PERIOD_MS, shown)
    node = client.get_node(ua.NodeId("axes/axis/Preload", 2))
    if deadband_n is None:
        await subscription.subscribe_data_change(node)
    else:
        await subscription.deadband_monitor(node, deadband_n)
    await until(lambda: shown.told)
    return shown


def test_what_is_pushed_is_true_over_slow_wear_and_an_outage(
    tmp_path: Path, start_server: Callable[..., ServerProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opcua_server, "POLL_S", 0.1)
    desk, post, port = test_notices.Recipient(), Post(), free_port()
    broker = brokers.BrokerProcess("mosquitto", tmp_path).start()
    mqtt = brokers.Client(broker, "preload/plant/#")

    def serve() -> ServerProcess:
        server = start_server(tmp_path / "var", port, PRELOAD_RECEIVERS_FILE=str(path))
        server.wait_until_up()
        return server

    async def wear(server: ServerProcess, api: Api) -> None:
        async with gateway(server.url) as url, asyncua.Client(url) as client:
            seen = Seen({deadband: await subscribed(client, deadband) for deadband in DEADBANDS_N}, mqtt)
            for windows in slow_wear():
                await asyncio.to_thread(api.accept, "axis", list(windows), complete=True)
                preload = (await asyncio.to_thread(api.axis, "axis"))["last_measurement"]["preload_n"]
                await until(lambda preload=preload: seen.holds(preload), 60.0)
            assert len(seen.opcua[None].told) > len(seen.opcua[10.0].told) > len(seen.opcua[30.0].told) >= 5
            server.process.kill()
            server.process.wait()
            away = ("BadNoCommunication", None)
            await until(lambda: all(each.told[-1] == away for each in seen.opcua.values()), 60.0)
            await until(lambda: mqtt.of(STATUS)[-1].payload == b"offline", 60.0)
            mqtt.heard.clear()
            await asyncio.to_thread(serve)
            await until(lambda: mqtt.of(STATUS) and mqtt.of(STATUS)[-1].payload == b"online", 60.0)
            await until(lambda: seen.holds(preload), 60.0)

    try:
        with desk.listening() as url:
            text = test_notices.receivers_file(tmp_path, url=url, mail_port=post.port).read_text()
            path = brokers.receivers_file(tmp_path, broker, text)
            server = serve()
            prepare(server.url)
            desk.status = 503
            with httpx.Client(base_url=server.url, timeout=60.0, trust_env=False) as http:
                asyncio.run(wear(server, Api(http, tmp_path / "var")))
                desk.status = 200
                with post.listening():
                    assert_told_once(http, desk, post)
    finally:
        mqtt.close()
        broker.kill()


def assert_told_once(http: httpx.Client, desk: "test_notices.Recipient", post: Post) -> None:
    """Each event of the alarms of the outage arrives at desk and post, once and in order."""
    alarms = http.get("/v1/alarms").json()["alarms"]
    assert alarms
    number = alarms[0]["id"]
    http.post(f"/v1/alarms/{number}/acknowledge", json={"comment": "seen"}).raise_for_status()

    def n_events() -> int:
        return sum(len(http.get(f"/v1/alarms/{alarm['id']}").json()["events"]) for alarm in alarms)

    brokers.wait_until(lambda: len(desk.taken) >= n_events() and len(post.mails) >= n_events(), seconds=300.0)
    told = [(each["id"], each["type"].rpartition(".")[2]) for each in desk.documents()]
    assert len(told) == n_events()
    assert post.told() == told == sorted(set(told), key=lambda each: int(each[0]))
    assert told[0][1] == "raised"
    assert [word for _, word in told].count("acknowledged") == 1
