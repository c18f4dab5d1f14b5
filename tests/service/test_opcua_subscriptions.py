"""OPC UA: what a client that subscribes shows stays within its deadband of the truth, status included."""

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import numpy as np
import pytest
from asyncua import Client, ua

from service.gateways.opcua_nodes import Nodes
from service.gateways.opcua_reading import AlarmSeen, AxisSeen, Reading
from service.gateways.opcua_server import OpcuaSettings, new_server
from tests.conftest import free_port
from tests.service.test_opcua import PATIENCE_S, Subscriber, seen, until

PERIOD_MS = 5
#: As in a slow wear: 303 → 176 N over 45 measurements, with some scatter.
WEAR = [float(value) for value in np.linspace(303.0, 176.0, 45) + np.random.default_rng(7).normal(0.0, 1.5, 45)]


class Shown:
    """What a client shows of one value: all that it was told, the last of it last."""

    def __init__(self) -> None:
        self.told: list[tuple[str, float | None]] = []

    def datachange_notification(self, _node: object, value: float | None, data: Any) -> None:
        self.told.append((data.monitored_item.Value.StatusCode.name, value))


class Face:
    """The nodes of axes, one at a time, and a client."""

    def __init__(self, nodes: Nodes, client: Client, axis: str) -> None:
        self.nodes = nodes
        self.client = client
        self._axis = axis

    async def measure(self, preload: float | None, **more: Any) -> None:
        measured = {"preload_n": preload, "interval_95_n": None if preload is None else [preload - 20.0, None]} | more
        await self.show(seen(**measured))

    async def show(self, axis: AxisSeen, *alarms: AlarmSeen) -> None:
        await self.nodes.show(Reading([axis.model_copy(update={"id": self._axis})], list(alarms)))

    def node(self, name: str) -> Any:
        return self.client.get_node(ua.NodeId(f"axes/{self._axis}/{name}", 2))

    async def subscribe(self, deadband: float | None, name: str = "Preload") -> tuple[Shown, Any, int]:
        """Subscribe as a historian does, with a deadband or without a filter."""
        shown = Shown()
        subscription = await self.client.create_subscription(PERIOD_MS, shown)
        if deadband is None:
            number = await subscription.subscribe_data_change(self.node(name))
        else:
            number = await subscription.deadband_monitor(self.node(name), deadband)
        await until(lambda: shown.told)
        return shown, subscription, number


Check = Callable[[str, Callable[[Face], Coroutine[Any, Any, None]]], None]


@pytest.fixture(scope="module")
def check() -> Iterator[Check]:
    """Run something against a server, one for the tests of this file, with an axis of its own."""
    settings = OpcuaSettings(port=free_port())
    with asyncio.Runner() as runner:
        server = runner.run(new_server(settings))
        nodes = runner.run(Nodes.make(server))
        runner.run(server.start())

        def run(axis: str, of: Callable[[Face], Coroutine[Any, Any, None]]) -> None:
            async def connected() -> None:
                async with Client(f"opc.tcp://127.0.0.1:{settings.port}/preload", PATIENCE_S) as client:
                    await of(Face(nodes, client, axis))

            runner.run(connected())

        yield run
        runner.run(server.stop())


def told_by_the_standard(values: list[float], deadband: float) -> list[float]:
    """Part 4, 7.22.2: a value is told where it is further than the deadband from the last one pushed to the queue."""
    told: list[float] = []
    for value in values:
        if not told or abs(value - told[-1]) > deadband:
            told.append(value)
    return told


def test_slow_wear_is_told_with_any_deadband_and_so_is_every_change_of_the_status(check: Check) -> None:
    async def wear(axis: Face) -> None:
        await axis.measure(WEAR[0])
        shown = {deadband: (await axis.subscribe(deadband))[0] for deadband in (None, 0.0, 1.0, 10.0, 30.0, 500.0)}
        for value in WEAR[1:]:
            await axis.measure(value)
        last = WEAR[-1]
        await axis.measure(last, doubts=[{"reason": "x"}])
        await axis.measure(None, reason="low-coherence")
        await axis.nodes.show_away()
        await axis.measure(last)
        statuses = [("UncertainSubNormal", last), ("BadNoData", None), ("BadNoCommunication", None), ("Good", last)]
        for deadband, each in shown.items():
            expected = [("Good", value) for value in told_by_the_standard(WEAR, deadband or 0.0)] + statuses
            await until(lambda told=each.told, told_last=expected[-1]: told[-1] == told_last and len(told) > 4)
            assert each.told == expected, deadband

    check("wear", wear)


def test_a_client_that_changes_its_filter_is_told_what_it_now_has_to_know(check: Check) -> None:
    async def change(axis: Face) -> None:
        await axis.measure(300.0)
        shown, subscription, number = await axis.subscribe(100.0)
        for value in (290.0, 280.0):
            await axis.measure(value)
        await subscription.modify_monitored_item(number, PERIOD_MS, mod_filter_val=15)
        await until(lambda: shown.told[-1] == ("Good", 280.0))
        await axis.measure(270.0)
        await subscription.modify_monitored_item(number, PERIOD_MS, mod_filter_val=None)
        await until(lambda: shown.told[-1] == ("Good", 270.0))
        await axis.measure(269.0)
        await until(lambda: shown.told[-1] == ("Good", 269.0))
        assert [value for _, value in shown.told] == [300.0, 280.0, 270.0, 269.0]

    check("changed", change)


def deadband_of(kind: ua.DeadbandType, value: float) -> ua.DataChangeFilter:
    return ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, kind, value)


REFUSED = [
    ("Preload", "Value", deadband_of(ua.DeadbandType.Percent, 10.0), "BadMonitoredItemFilterUnsupported"),
    ("Preload", "Value", ua.EventFilter(), "BadMonitoredItemFilterUnsupported"),
    ("Preload", "Value", deadband_of(ua.DeadbandType.Absolute, -1.0), "BadDeadbandFilterInvalid"),
    ("Preload", "Value", deadband_of(ua.DeadbandType.Absolute, float("nan")), "BadDeadbandFilterInvalid"),
    ("State", "Value", deadband_of(ua.DeadbandType.Absolute, 1.0), "BadFilterNotAllowed"),
    ("Preload", "DisplayName", deadband_of(ua.DeadbandType.Absolute, 1.0), "BadFilterNotAllowed"),
]


def test_a_filter_that_cannot_be_kept_is_refused_as_the_standard_says(check: Check, subtests: pytest.Subtests) -> None:
    async def refuse(axis: Face) -> None:
        await axis.measure(300.0)
        subscription = await axis.client.create_subscription(PERIOD_MS, Shown())
        for name, attribute, wanted, refusal in REFUSED:
            with subtests.test(f"{name}, {attribute}: {wanted}"):
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await subscription._subscribe(axis.node(name), ua.AttributeIds[attribute], wanted)
                assert type(refused.value).__name__ == refusal
        number = await subscription.subscribe_data_change(axis.node("State"))
        (modified,) = await subscription.modify_monitored_item(number, PERIOD_MS, mod_filter_val=1)
        assert modified.StatusCode.name == "BadFilterNotAllowed"

    check("refused", refuse)


def test_an_axis_that_is_taken_away_counts_no_more_and_comes_back_to_who_subscribed(check: Check) -> None:
    async def take_away(axis: Face) -> None:
        await axis.measure(300.0)
        shown, _, _ = await axis.subscribe(30.0)
        folder = axis.client.get_node(ua.NodeId("axes", 2))
        assert [(await node.read_browse_name()).Name for node in await folder.get_children()] == ["gone"]
        await axis.nodes.show(Reading([], []))
        await until(lambda: shown.told[-1] == ("BadNodeIdUnknown", None))
        assert await folder.get_children() == []
        await axis.nodes.show_away()
        await axis.measure(300.0)
        await until(lambda: shown.told[-1] == ("Good", 300.0))
        assert len(shown.told) == 3
        assert len(await folder.get_children()) == 1

    check("gone", take_away)


def test_no_value_is_good_before_it_is_known(check: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    async def begin(axis: Face) -> None:
        monkeypatch.setattr("service.gateways.opcua_nodes.values_of", lambda _: {})
        await axis.measure(300.0)
        for name in ("Preload", "PreloadIntervalLow", "PreloadIntervalHigh", "State"):
            value = await axis.node(name).read_data_value(raise_on_bad_status=False)
            assert (value.StatusCode.name, value.Value.Value) == ("BadWaitingForInitialData", None)

    check("new", begin)


def test_an_alarm_says_that_the_service_has_gone_and_come_back(check: Check) -> None:
    alarm = AlarmSeen.model_validate(
        {"id": 1, "axis": "a", "kind": "preload-loss", "raised_at": "2026-03-02T06:00:00Z", "status": "active",
         "shelved_until": None, "evidence": {"sentence": "less"}}
    )  # fmt: skip
    subscriber = Subscriber()

    def events() -> list[tuple[str, bool]]:
        kind = ua.ObjectIds.AlarmConditionType
        return [(event.Quality.name, getattr(event, "ActiveState/Id")) for event in subscriber.of(kind)]

    async def go_away(axis: Face) -> None:
        subscription = await axis.client.create_subscription(PERIOD_MS, subscriber)
        await subscription.subscribe_alarms_and_conditions(evtypes=ua.ObjectIds.AlarmConditionType)
        await axis.show(seen(), alarm)
        await axis.nodes.show_away()
        await axis.nodes.show_away()  # and is still away
        await axis.show(seen(), alarm)
        await axis.show(seen())
        await until(lambda: len(events()) == 4)
        assert events() == [("Good", True), ("BadNoCommunication", True), ("Good", True), ("Good", False)]

    check("alarmed", go_away)
