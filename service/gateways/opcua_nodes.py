"""The nodes that an OPC UA client sees of the axes, and the events of their alarms."""

from asyncua import Node, Server, ua
from asyncua.common.event_objects import AlarmCondition
from asyncua.server.event_generator import EventGenerator

from service.gateways.opcua_reading import AlarmSeen, AxisSeen, Reading, values_of

NAMESPACE = "urn:preload-monitor"


def _unit(code: str, symbol: str, name: str) -> ua.EUInformation:
    """Return a unit by its UNECE Recommendation 20 code, whose characters are its number (OPC UA Part 8, 5.6.3)."""
    return ua.EUInformation(
        NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
        UnitId=int.from_bytes(code.encode()),
        DisplayName=ua.LocalizedText(symbol),
        Description=ua.LocalizedText(name),
    )


NEWTON, MICROMETRE = _unit("NEW", "N", "newton"), _unit("4H", "µm", "micrometre (micron)")
PERCENT = _unit("P1", "%", "percent")
#: What each variable is, in words, and in which unit.
NUMBERS = {
    "Preload": ("preload of the newest measurement", NEWTON),
    "PreloadIntervalLow": ("lower end of its 95 % coverage interval", NEWTON),
    "PreloadIntervalHigh": ("upper end of its 95 % coverage interval", NEWTON),
    "FrequencyFall": ("fall of the natural frequency below its baseline, without a calibration", PERCENT),
    "FrequencyFallIntervalLow": ("lower end of its 95 % interval", PERCENT),
    "FrequencyFallIntervalHigh": ("upper end of its 95 % interval", PERCENT),
    "LostMotion": ("reversal value of the newest reading (ISO 230-2)", MICROMETRE),
    "LostMotionIntervalLow": ("lower end of its 95 % interval", MICROMETRE),
    "LostMotionIntervalHigh": ("upper end of its 95 % interval", MICROMETRE),
}
STATES = ("State", "LostMotionState")
#: What is watched where an alarm of this kind is raised; else it is the preload.
_WATCHED = {"lost-motion": "LostMotion"}
#: Of 1 to 1000: a loss of preload is to be seen to soon, and no emergency.
SEVERITY = 700


class Nodes:
    """Mirrors readings of the service in the address space of a server."""

    def __init__(self, server: Server, index: int, folder: Node) -> None:
        self._server = server
        self._index = index
        self._folder = folder
        self._axes: dict[str, dict[str, Node]] = {}  # of every axis that there was
        self._listed: set[str] = set()  # those in the folder
        self._shown: dict[str, AxisSeen] = {}
        self._alarms: dict[int, AlarmSeen] = {}
        self._conditions: dict[int, EventGenerator] = {}
        self._is_away = False

    @classmethod
    async def make(cls, server: Server) -> "Nodes":
        """Add the folder of the axes."""
        index = await server.register_namespace(NAMESPACE)
        folder = await server.nodes.objects.add_folder(ua.NodeId("axes", index), ua.QualifiedName("Axes", index))
        return cls(server, index, folder)

    async def show(self, reading: Reading) -> None:
        """Show what was read: values that differ, and an event for each alarm that does."""
        present = {axis.id: axis for axis in reading.axes}
        for gone in self._listed - present.keys():
            await self._hide(gone)
        for name, axis in present.items():
            if self._shown.get(name) != axis:
                await self._show_axis(axis)
        self._shown = present
        open_now = {alarm.id: alarm for alarm in reading.alarms}
        for number in sorted(self._alarms.keys() | open_now.keys()):
            before, alarm = self._alarms.get(number), open_now.get(number)
            if alarm is None:
                await self._show_alarm(self._alarms[number], is_open=False)
                del self._conditions[number]
            elif (
                before is None
                or self._is_away
                or (before.status, before.shelved_until) != (alarm.status, alarm.shelved_until)
            ):
                await self._show_alarm(alarm, is_open=True)
        self._alarms, self._is_away = open_now, False

    async def show_away(self) -> None:
        """Say of every value and every open alarm that the service is away; none of them counts meanwhile."""
        if self._is_away:
            return
        self._is_away = True
        self._shown.clear()
        for axis in self._listed:
            await self._say(axis, ua.StatusCodes.BadNoCommunication)
        for alarm in self._alarms.values():
            await self._show_alarm(alarm, is_open=True, quality=ua.StatusCodes.BadNoCommunication)

    def _id(self, path: str) -> ua.NodeId:
        return ua.NodeId(path, self._index)

    async def _say(self, axis: str, status: int) -> None:
        """Write a status without a value to every variable of an axis."""
        for variable in self._axes[axis].values():
            await variable.write_value(ua.DataValue(StatusCode=ua.StatusCode(status)))

    async def _hide(self, axis: str) -> None:
        """Take an axis out of the folder. Its nodes stay: the library tells nobody that a node was deleted."""
        await self._folder.delete_reference(self._id(f"axes/{axis}"), ua.ObjectIds.Organizes)
        await self._say(axis, ua.StatusCodes.BadNodeIdUnknown)
        self._listed.remove(axis)

    async def _show_axis(self, axis: AxisSeen) -> None:
        if axis.id not in self._axes:
            self._axes[axis.id] = await self._new_axis(axis)
        elif axis.id not in self._listed:
            await self._folder.add_reference(self._id(f"axes/{axis.id}"), ua.ObjectIds.Organizes)
        self._listed.add(axis.id)
        for name, value in values_of(axis).items():
            await self._axes[axis.id][name].write_value(value)

    async def _new_axis(self, axis: AxisSeen) -> dict[str, Node]:
        path = f"axes/{axis.id}"
        node = await self._folder.add_object(self._id(path), ua.QualifiedName(axis.id, self._index))
        variables = {name: await self._number(node, path, name, *meant) for name, meant in NUMBERS.items()}
        strings = {name: await self._variable(node, path, name, ua.ObjectIds.String) for name in STATES}
        return variables | strings

    async def _variable(self, axis: Node, path: str, name: str, datatype: int) -> Node:
        """Add a variable; until a value is known it has none."""
        variable = await axis.add_variable(
            self._id(f"{path}/{name}"), ua.QualifiedName(name, self._index), None, datatype=datatype
        )
        waiting = ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData)
        await variable.write_value(ua.DataValue(StatusCode=waiting))
        return variable

    async def _number(self, axis: Node, path: str, name: str, meaning: str, unit: ua.EUInformation) -> Node:
        variable = await self._variable(axis, path, name, ua.ObjectIds.Double)
        await variable.delete_reference(ua.ObjectIds.BaseDataVariableType, ua.ObjectIds.HasTypeDefinition)
        await variable.add_reference(ua.ObjectIds.AnalogUnitType, ua.ObjectIds.HasTypeDefinition)
        unit_id = self._id(f"{path}/{name}/EngineeringUnits")
        await variable.add_property(unit_id, ua.QualifiedName("EngineeringUnits", 0), unit)
        text = ua.Variant(ua.LocalizedText(meaning), ua.VariantType.LocalizedText)
        await variable.write_attribute(ua.AttributeIds.Description, ua.DataValue(text))
        return variable

    async def _show_alarm(self, alarm: AlarmSeen, *, is_open: bool, quality: int = ua.StatusCodes.Good) -> None:
        """Send the event of a condition; while it is open, who subscribes later gets it by ConditionRefresh."""
        generator = self._conditions.get(alarm.id)
        is_new = generator is None
        if generator is None:
            generator = self._conditions[alarm.id] = EventGenerator(self._server.iserver.isession)
            condition = AlarmCondition(severity=SEVERITY)
            condition.add_property("NodeId", self._id(f"alarms/{alarm.id}"), ua.VariantType.NodeId)
            condition.SourceNode = self._id(f"axes/{alarm.axis}")
            condition.SourceName = alarm.axis
            condition.InputNode = self._id(f"axes/{alarm.axis}/{_WATCHED.get(alarm.kind, 'Preload')}")
            await generator.init(condition, ua.ObjectIds.Server, add_generates_event=False)
        event = generator.event
        is_seen = alarm.status == "acknowledged" or not is_open
        event.ConditionName = alarm.kind
        event.ConditionClassId = ua.NodeId(ua.ObjectIds.ProcessConditionClassType)
        event.ConditionClassName = ua.LocalizedText("ProcessConditionClass")
        event.BranchId = ua.NodeId()
        event.Retain = is_open
        event.Quality = ua.StatusCode(quality)
        event.LastSeverity = SEVERITY
        event.SuppressedOrShelved = is_open and alarm.shelved_until is not None
        for state, text, holds in (
            ("EnabledState", "Enabled", True),
            ("ActiveState", "Active" if is_open else "Inactive", is_open),
            ("AckedState", "Acknowledged" if is_seen else "Unacknowledged", is_seen),
        ):
            setattr(event, state, ua.LocalizedText(text))
            setattr(event, f"{state}/Id", holds)
        sentence = alarm.evidence.sentence or alarm.kind
        await generator.trigger(
            alarm.raised_at if is_new and not is_seen else None,
            f"{alarm.axis}: {sentence}" if is_open else f"{alarm.axis}: alarm {alarm.id} is closed",
        )
