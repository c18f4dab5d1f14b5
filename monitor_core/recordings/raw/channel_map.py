"""Read a channel map (TOML): which channel is what, in which unit, and what the raw file does not say.

.. code-block:: toml

    axis_id = "mill-3-x"
    description = "impact moves"               # optional

    [excitation]
    channel = "Drive/Current"                  # name in the file
    quantity = "torque"                        # torque | force
    source = "drive"                           # sensor | drive
    unit = "A"                                 # what the numbers in the file are
    sensitivity = 0.74                         # only with a raw unit (V, mV, A, mA, count) …
    sensitivity_unit = "N.m/A"                 # … "quantity/raw" or, as on a sensor's sheet, "raw/quantity"

    [response]                                 # always an acceleration
    channel = "Nut/Acceleration"
    unit = "g"

    [position]                                 # optional measured travel; replaces the two position entries below
    channel = "Drive/Position"
    unit = "mm"

    [time]                                     # only if a channel holds the sampling times
    channel = "t"
    unit = "s"

    [window]
    sample_rate_hz = 10000                     # only if neither the file nor [time] says it
    started_at = 2025-03-01T06:00:00Z          # only if the file does not say it
    position_mm = 250.0
    position_span_mm = 0.0
    measurement = "2025-03-01 at 250 mm"       # optional; otherwise the file's name without its ending
    direction = "both"                         # optional: + | - | both
    payload_kg = 0.0                           # optional, as temperature_c and preload_n
    samples_per_window = 20000                 # optional: cuts a long record into windows that follow each other
    windows_in = "rows"                        # only for two-dimensional arrays: rows | columns …
    window_interval_s = 2.0                    # … and the time from the start of one to the start of the next

What is stated in the file *and* here is refused, and so is an entry that is not listed above.
"""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Direction, ExcitationQuantity, ExcitationSource
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import parse_toml, read_text
from monitor_core.recordings.elements.units import Quantity, factor_to_si, metres, sensor_factor


class WindowsIn(StrEnum):
    """How a two-dimensional array holds several windows."""

    ROWS = "rows"
    COLUMNS = "columns"


@dataclass(frozen=True, slots=True)
class MappedChannel:
    """A channel of the file, what its numbers are in, and what they are multiplied with to be in SI."""

    channel: str
    unit: str
    factor: float


@dataclass(frozen=True, slots=True)
class WindowFacts:
    """What the map says about every window of the file; ``None`` leaves it to the file."""

    sample_rate: float | None  # [Hz]
    started_at: datetime | None
    position: float | None  # [m]; position and span are None where a channel measures them
    position_span: float | None  # [m]
    payload_mass: float | None  # [kg]
    temperature: float | None  # [°C]
    preload: float | None  # [N]
    measurement: str | None
    direction: Direction
    samples_per_window: int | None
    windows_in: WindowsIn | None
    window_interval: float | None  # [s]


@dataclass(frozen=True, slots=True)
class ChannelMap:
    """Meaning of the channels of a raw file."""

    axis_id: str
    description: str
    excitation: MappedChannel
    excitation_quantity: ExcitationQuantity
    excitation_source: ExcitationSource
    response: MappedChannel
    position: MappedChannel | None
    time: MappedChannel | None
    window: WindowFacts


_SIGNAL = frozenset(("channel", "unit", "sensitivity", "sensitivity_unit"))
_ENTRIES = {
    "excitation": _SIGNAL | {"quantity", "source"},
    "response": _SIGNAL,
    "position": _SIGNAL,
    "time": frozenset(("channel", "unit")),
    "window": frozenset((
        "sample_rate_hz", "started_at", "position_mm", "position_span_mm", "measurement", "direction", "payload_kg",
        "temperature_c", "preload_n", "samples_per_window", "windows_in", "window_interval_s",
    )),
}  # fmt: skip


def read_channel_map(path: Path) -> ChannelMap:
    """Read a channel map from a TOML file; the module's text shows every entry.

    Factors are to SI and positions in metres. ``RecordingFormatError`` if it is no TOML, lacks an entry, has one that
    is not known, or names a unit that does not fit the quantity.
    """
    top = Fields(parse_toml(read_text(path), path.name, "a channel map"), path.name)
    top.only({"axis_id", "description", *_ENTRIES})
    excitation = _table(top, "excitation")
    quantity = excitation.choice("quantity", ExcitationQuantity)
    has_position = "position" in top
    return ChannelMap(
        axis_id=top.text("axis_id"),
        description=top.text("description") if "description" in top else "",
        excitation=_mapped(excitation, Quantity(quantity)),
        excitation_quantity=quantity,
        excitation_source=excitation.choice("source", ExcitationSource),
        response=_mapped(_table(top, "response"), Quantity.ACCELERATION),
        position=_mapped(_table(top, "position"), Quantity.POSITION) if has_position else None,
        time=_mapped(_table(top, "time"), Quantity.TIME) if "time" in top else None,
        window=_window(_table(top, "window"), has_position=has_position),
    )


def _table(top: Fields, name: str) -> Fields:
    table = top.table(name)
    table.only(_ENTRIES[name])
    return table


def _mapped(fields: Fields, quantity: Quantity) -> MappedChannel:
    unit = fields.text("unit")
    if "sensitivity" in fields or "sensitivity_unit" in fields:
        factor = sensor_factor(
            unit, fields.positive("sensitivity", "-"), fields.text("sensitivity_unit"), quantity, fields.where
        )
    else:
        factor = factor_to_si(unit, quantity, f"{fields.where}, unit")
    return MappedChannel(fields.text("channel"), unit, factor)


def _window(fields: Fields, *, has_position: bool) -> WindowFacts:
    if has_position and ("position_mm" in fields or "position_span_mm" in fields):
        raise RecordingFormatError(
            f"{fields.where}: expected the position once; got a [position] channel and position_mm or position_span_mm"
        )
    return WindowFacts(
        sample_rate=fields.positive("sample_rate_hz", "Hz") if "sample_rate_hz" in fields else None,
        started_at=fields.instant("started_at") if "started_at" in fields else None,
        position=None if has_position else metres(fields.number("position_mm", "mm")),
        position_span=None if has_position else metres(fields.number("position_span_mm", "mm")),
        payload_mass=fields.optional_number("payload_kg", "kg"),
        temperature=fields.optional_number("temperature_c", "°C"),
        preload=fields.optional_number("preload_n", "N"),
        measurement=fields.text("measurement") if "measurement" in fields else None,
        direction=fields.optional_choice("direction", Direction) or Direction.BOTH,
        samples_per_window=fields.count("samples_per_window") if "samples_per_window" in fields else None,
        windows_in=fields.optional_choice("windows_in", WindowsIn),
        window_interval=fields.positive("window_interval_s", "s") if "window_interval_s" in fields else None,
    )
