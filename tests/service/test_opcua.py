"""OPC UA: a client reads preload, interval, unit, time and quality, and gets an alarm as a condition."""

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asyncua import Client, ua

from service.clock import now, text_of
from service.gateways.opcua_reading import AxisSeen, values_of
from service.gateways.opcua_server import OpcuaSettings, serve_opcua
from tests.conftest import PROJECT_ROOT, free_port
from tests.service.brokers import certificate
from tests.service.conftest import Api, running_service
from tests.service.test_lost_motion import reading, send
from tests.service.test_notices import losing_preload

#: On a machine that is busy a server takes half a minute to build its nodes, and seconds to answer.
PATIENCE_S = 120.0
EVERYWHERE = "0.0.0.0"  # noqa: S104 - refused unless it is encrypted


class Subscriber:
    """Keeps the events that it gets."""

    def __init__(self) -> None:
        self.events: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.events.append(event)

    def of(self, kind: int) -> list[Any]:
        return [event for event in self.events if event.EventType == ua.NodeId(kind)]


@asynccontextmanager
async def gateway(url: str, **settings: Any) -> AsyncIterator[str]:
    """Run the gateway in this loop and yield its address."""
    made, stopping = OpcuaSettings(port=free_port(), **settings), asyncio.Event()
    task = asyncio.create_task(serve_opcua(made, url, None, stopping))
    try:
        await until(lambda: listens(made.port) or task.done())
        yield f"opc.tcp://127.0.0.1:{made.port}/preload"
    finally:
        stopping.set()
        await task


def listens(port: int) -> bool:
    import socket

    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


async def until(holds: Callable[[], Any], seconds: float = PATIENCE_S) -> None:
    async with asyncio.timeout(seconds):
        while not holds():
            await asyncio.sleep(0.02)


async def read(client: Client, name: str) -> ua.DataValue:
    index = await client.get_namespace_index("urn:preload-monitor")
    node = client.get_node(ua.NodeId(f"axes/axis/{name}", index))
    return await node.read_data_value(raise_on_bad_status=False)


async def read_until(client: Client, name: str, holds: Callable[[ua.DataValue], bool]) -> ua.DataValue:
    async with asyncio.timeout(PATIENCE_S):
        while not holds(value := await read(client, name)):
            await asyncio.sleep(0.05)
    return value


def test_a_client_reads_values_and_gets_an_alarm_and_its_end(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        api.register("quiet")
        alarm = losing_preload(api)
        send(api, "axis", [reading(np.random.default_rng(1), 0.0)])
        asyncio.run(_as_client(api, alarm))


async def _as_client(api: Api, alarm: int) -> None:
    axis = api.axis("axis")
    measured = axis["last_measurement"]
    async with gateway(str(api.http.base_url)) as url, Client(url, PATIENCE_S) as client:
        preload = await read_until(client, "Preload", lambda value: value.Value.Value is not None)
        assert preload.Value.Value == measured["preload_n"]
        assert preload.SourceTimestamp == datetime.fromisoformat(measured["started_at"])
        assert (await read(client, "PreloadIntervalLow")).Value.Value == measured["interval_95_n"][0]
        assert (await read(client, "PreloadIntervalHigh")).Value.Value == measured["interval_95_n"][1]
        assert (await read(client, "State")).Value.Value == "alarm"
        index = await client.get_namespace_index("urn:preload-monitor")
        node = client.get_node(ua.NodeId("axes/axis/Preload", index))
        assert await node.read_type_definition() == ua.NodeId(ua.ObjectIds.AnalogUnitType)
        unit = await (await node.get_child("0:EngineeringUnits")).read_value()
        assert (unit.DisplayName.Text, unit.UnitId) == ("N", 5129559)
        with pytest.raises(ua.UaError):
            await node.write_value(1.0)
        lost, low, high = [await read(client, f"LostMotion{end}") for end in ("", "IntervalLow", "IntervalHigh")]
        assert lost.Value.Value == axis["lost_motion"]["reversal_value_um"]
        assert [low.Value.Value, high.Value.Value] == axis["lost_motion"]["reversal_value_interval_95_um"]
        assert lost.SourceTimestamp == datetime.fromisoformat(axis["lost_motion"]["measured_at"])
        micrometre = client.get_node(ua.NodeId("axes/axis/LostMotion/EngineeringUnits", index))
        # UNECE Recommendation 20: the code of a micrometre is 4H
        assert ((await micrometre.read_value()).DisplayName.Text, (await micrometre.read_value()).UnitId) == (
            "µm",
            0x3448,
        )
        assert (await read(client, "LostMotionState")).Value.Value == axis["lost_motion"]["state"]
        quiet = client.get_node(ua.NodeId("axes/quiet/Preload", index))
        assert (await quiet.read_data_value(raise_on_bad_status=False)).StatusCode.name == "BadNoData"
        unlooked = client.get_node(ua.NodeId("axes/quiet/LostMotion", index))
        assert (await unlooked.read_data_value(raise_on_bad_status=False)).StatusCode.name == "BadNoData"

        subscriber = Subscriber()
        subscription = await client.create_subscription(50, subscriber)
        await subscription.subscribe_alarms_and_conditions(evtypes=ua.ObjectIds.AlarmConditionType)
        condition_type = client.get_node(ua.ObjectIds.ConditionType)
        await condition_type.call_method(
            "0:ConditionRefresh", ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
        )
        await until(lambda: subscriber.of(ua.ObjectIds.AlarmConditionType))
        event = subscriber.of(ua.ObjectIds.AlarmConditionType)[0]
        assert "below the baseline" in event.Message.Text
        assert (event.SourceName, event.ConditionName) == ("axis", "preload-loss")
        assert (getattr(event, "ActiveState/Id"), getattr(event, "AckedState/Id"), event.Retain) == (True, False, True)

        api.http.post(f"/v1/alarms/{alarm}/acknowledge", json={"comment": "seen"}).raise_for_status()
        await until(lambda: getattr(subscriber.events[-1], "AckedState/Id", False))
        assert getattr(subscriber.events[-1], "ActiveState/Id") is True
        # first until it has been seen: a gateway that is slow would not see a shelf that ends soon
        for shelved in (timedelta(hours=1), timedelta(seconds=3)):
            shelf = {"until": text_of(now() + shelved), "comment": "spare part on its way"}
            api.http.post(f"/v1/alarms/{alarm}/shelve", json=shelf).raise_for_status()
            await until(lambda: subscriber.events[-1].SuppressedOrShelved is True)
        await until(lambda: subscriber.events[-1].SuppressedOrShelved is False)
        api.http.post(f"/v1/alarms/{alarm}/clear", json={"comment": "new nut"}).raise_for_status()
        await until(lambda: getattr(subscriber.events[-1], "ActiveState/Id", True) is False)
        assert subscriber.events[-1].Retain is False
        assert subscriber.events[-1].NodeId == event.NodeId
        told = [
            (getattr(event, "AckedState/Id"), event.SuppressedOrShelved)
            for event in subscriber.of(ua.ObjectIds.AlarmConditionType)
        ]
        # the second shelf is a change of its own where it was seen before it ended
        assert told in ([(False, False), (True, False), *n * [(True, True)], *2 * [(True, False)]] for n in (1, 2))


@pytest.mark.release
def test_without_the_service_no_value_counts(tmp_path: Path) -> None:
    async def check(api_url: str, stop: Callable[[], None]) -> None:
        async with gateway(api_url) as url, Client(url, PATIENCE_S) as client:
            await read_until_known(client)
            assert (await read(client, "State")).StatusCode.is_good()
            stop()
            state = await read_until(client, "State", lambda value: value.StatusCode.is_bad())
            assert state.StatusCode.name == "BadNoCommunication"

    service = running_service(tmp_path / "var")
    api = service.__enter__()
    api.register("axis")
    asyncio.run(check(str(api.http.base_url), lambda: service.__exit__(None, None, None)))


async def read_until_known(client: Client) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while (await client.get_namespace_array()).count("urn:preload-monitor") == 0 or (
            await read(client, "State")
        ).StatusCode.name == "BadNodeIdUnknown":
            await asyncio.sleep(0.05)


def seen(**measured: Any) -> AxisSeen:
    measurement = {"started_at": "2026-03-02T06:00:00Z"} | measured if measured else None
    return AxisSeen.model_validate(
        {"id": "a", "name": "a", "state": "normal", "state_since": None, "last_measurement": measurement}
    )


@pytest.mark.parametrize(
    ("axis", "quality"),
    [
        (seen(), "BadNoData"),
        (seen(refused=True, reason="low-coherence"), "BadNoData"),
        (seen(preload_n=200.0, interval_95_n=[150.0, None]), "Good"),
        (seen(preload_n=200.0, interval_95_n=[150.0, 250.0], doubts=[{"reason": "x"}]), "UncertainSubNormal"),
        (seen(preload_n=200.0).model_copy(update={"state": "unknown"}), "UncertainLastUsableValue"),
    ],
)  # fmt: skip
def test_the_quality_says_whether_there_is_a_value_and_whether_it_is_in_doubt(axis: AxisSeen, quality: str) -> None:
    values = values_of(axis)
    preload = [name for name in values if name.startswith("Preload")]
    assert {values[name].StatusCode.name for name in preload} == {quality}
    assert values["LostMotion"].StatusCode.name == "BadNoData"  # never measured
    assert (values["Preload"].Value.Value is None) == (quality == "BadNoData")
    assert values["FrequencyFall"].StatusCode.name == "BadNoData"  # newtons are told


def test_an_axis_without_a_calibration_tells_its_fall_in_percent() -> None:
    fall = {"frequency_fall_percent": 2.1, "frequency_fall_interval_95_percent": [1.8, 2.4]}
    values = values_of(seen(**fall))
    told = [values[f"FrequencyFall{end}"].Value.Value for end in ("", "IntervalLow", "IntervalHigh")]
    assert told == [2.1, 1.8, 2.4]
    assert values["FrequencyFall"].StatusCode.name == "Good"
    assert values["Preload"].StatusCode.name == "BadNoData"
    assert values_of(seen(**fall, doubts=[{"reason": "x"}]))["FrequencyFall"].StatusCode.name == "UncertainSubNormal"


def test_an_open_end_of_an_interval_is_infinite() -> None:
    values = values_of(seen(preload_n=200.0, interval_95_n=[150.0, None]))
    assert values["PreloadIntervalHigh"].Value.Value == float("inf")


def test_beyond_loopback_it_is_encrypted_and_asks_for_a_password(tmp_path: Path, api: Api) -> None:
    with pytest.raises(ValueError, match="beyond loopback it needs certificate_file"):
        OpcuaSettings(host=EVERYWHERE)
    certificate(tmp_path, "urn:preload:test")
    (tmp_path / "password").write_text("right\n")
    api.register("axis")
    secured = {
        "host": EVERYWHERE, "certificate_file": tmp_path / "cert.pem", "private_key_file": tmp_path / "key.pem",
        "username": "control", "password_file": tmp_path / "password",
    }  # fmt: skip

    async def check() -> None:
        async with gateway(str(api.http.base_url), **secured) as url:
            with pytest.raises(ua.UaError):
                async with Client(url, PATIENCE_S):
                    pass
            for password, lets_in in (("wrong", False), ("right", True)):
                client = Client(url, PATIENCE_S)
                client.application_uri = "urn:preload:test"
                await client.set_security_string(
                    f"Basic256Sha256,SignAndEncrypt,{tmp_path}/cert.pem,{tmp_path}/key.pem"
                )
                client.set_user("control")
                client.set_password(password)
                if lets_in:
                    async with client:
                        await read_until_known(client)
                else:
                    with pytest.raises(ua.UaError):
                        async with client:
                            pass

    asyncio.run(check())


def test_without_the_extra_a_sentence_says_what_installs_it(tmp_path: Path) -> None:
    hidden = tmp_path / "asyncua"
    hidden.mkdir()
    (hidden / "__init__.py").write_text("raise ImportError('hidden')\n")
    done = subprocess.run(
        [sys.executable, "-m", "service.cli.main", "opcua", "--url", "http://127.0.0.1:9"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(PROJECT_ROOT)])},
        capture_output=True, text=True, timeout=60, check=False, cwd=PROJECT_ROOT,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "preload: OPC UA needs asyncua; pip install asyncua\n"
