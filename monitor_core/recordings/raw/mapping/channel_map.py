"""Read a channel map (TOML): which channel is what, in which unit, and what the raw files do not say.

.. code-block:: toml

    axis_id = "mill-3-x"
    description = "impact moves"               # optional

    [text]                                     # how a text file is written, where it is not plain: see text_layout.py
    separator = "semicolon"

    [excitation]
    channel = "Drive/Current"                  # name in the file
    column = 3                                 # optional: column or row of a two-dimensional array, counted from 1
    quantity = "torque"                        # torque | force
    source = "drive"                           # sensor | drive
    unit = "A"                                 # what the numbers in the file are
    sensitivity = 0.74                         # only with a raw unit (V, mV, A, mA, count) …
    sensitivity_unit = "N.m/A"                 # … "quantity/raw" or, as on a sensor's sheet, "raw/quantity"
    offset = 0.0                               # optional, in the unit of the file, subtracted first
    time = "Time 1"                            # optional: channel with the sampling times of this one, unit as [time]

    [response]                                 # always an acceleration
    channel = "Nut/Acceleration"
    unit = "g"

    [position]                                 # optional measured travel; replaces the two position entries below
    channel = "Drive/Position"
    unit = "mm"

    [time]                                     # only if a channel holds the sampling times
    channel = "t"
    unit = "s"                                 # numbers; or, for texts of a date and time:
    format = "iso"                             # iso | a pattern of strptime such as "%d.%m.%Y %H:%M:%S.%f"
    date = "Date"                              # optional second channel in front of it
    zone = "+01:00"                            # where the texts carry none

    [resample]                                 # only where clocks differ or sampling is uneven
    sample_rate_hz = 5000
    method = "cubic"                           # cubic | linear

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
    file_interval_s = 60.0                     # several files and one start: from the start of one to that of the next
    position_step_mm = 5.0                     # optional: windows this near the first are one measurement, numbered

    [[files]]                                  # optional, facts of one of several files; they go before [window]
    name = "p100.tdms"
    position_mm = 100

    [tolerances]                               # optional, how well the settings are known
    position_tolerance_mm = 0.5
    preload_tolerance = 0.05                   # relative, as gain_tolerance

A motion record has, instead of excitation, response and position, tables inside one: ``[motion]`` with ``position``,
``force`` or ``torque``, optionally ``reference``, each with entries as above, and ``sample_rate_hz`` or ``[time]``.

An FRF set has ``[frf]``: ``input`` and ``output`` as its format names them; ``frequency``, and ``real`` and
``imaginary`` or ``magnitude`` and ``phase`` (deg or rad), or ``response``, the name of a frequency response that the
file itself holds; ``standard_deviation`` (in the unit of the response; or a channel) or ``relative``; optionally
``resolution_hz`` and ``excitation_rms_nm`` or ``excitation_rms_n``. Conditions stand in ``[window]`` or ``[[files]]``.

What is stated in the file *and* here is refused, and so is an entry that is not listed above.
"""

import math
import re
from collections.abc import Set as AbstractSet
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.recording import Direction, ExcitationQuantity, ExcitationSource
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import parse_toml, read_text
from monitor_core.recordings.elements.units import (
    Quantity,
    excitation_unit,
    factor_to_si,
    metres,
    response_factor,
    sensor_factor,
)
from monitor_core.recordings.raw.mapping.map_records import (
    ChannelMap,
    Cutting,
    MapKind,
    MappedChannel,
    MotionSignals,
    ResampleMethod,
    Resampling,
    ResponseLines,
    SessionSignals,
    TimeSource,
    Tolerances,
    WindowFacts,
    WindowsIn,
)
from monitor_core.recordings.raw.text.layout import TextLayout

__all__ = [
    "ChannelMap",
    "MapKind",
    "MappedChannel",
    "WindowFacts",
    "WindowsIn",
    "parse_channel_map",
    "read_channel_map",
]

_PLACE = frozenset(("channel", "column", "row"))
_SIGNAL = _PLACE | {"unit", "sensitivity", "sensitivity_unit", "offset", "time"}
_FACTS = frozenset((
    "started_at", "position_mm", "position_span_mm", "measurement", "direction", "payload_kg", "temperature_c",
    "preload_n",
))  # fmt: skip
_ENTRIES = {
    "excitation": _SIGNAL | {"quantity", "source"},
    "response": _SIGNAL,
    "position": _SIGNAL,
    "time": _PLACE | {"unit", "format", "date", "zone"},
    "resample": frozenset(("sample_rate_hz", "method")),
    "window": _FACTS | {
        "sample_rate_hz", "samples_per_window", "windows_in", "window_interval_s", "file_interval_s",
        "position_step_mm",
    },
    "files": _FACTS | {"name"},
    "tolerances": frozenset(Tolerances().attributes),
    "motion": frozenset(("position", "force", "torque", "reference", "sample_rate_hz")),
    "frf": frozenset((
        "input", "output", "frequency", "real", "imaginary", "magnitude", "phase", "response", "standard_deviation",
        "relative", "resolution_hz", "excitation_rms_nm", "excitation_rms_n",
    )),
}  # fmt: skip
_ANY_MAP = frozenset(("axis_id", "description", "text"))
_TABLES = {
    MapKind.SESSION: frozenset((
        "excitation", "response", "position", "time", "resample", "window", "files", "tolerances",
    )),
    MapKind.MOTION: frozenset(("motion", "time", "resample")),
    MapKind.FRF_SET: frozenset(("frf", "window", "files", "tolerances")),
}  # fmt: skip
#: What ``[window]`` and ``[[files]]`` may state of a frequency response.
_CONDITIONS = frozenset(("position_mm", "payload_kg", "temperature_c", "preload_n"))
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)")
_DEGREE = {"deg": math.pi / 180.0, "rad": 1.0}


def read_channel_map(path: Path) -> ChannelMap:
    """Read a channel map from a TOML file; the module's text shows every entry.

    Factors are to SI and positions in metres. ``RecordingFormatError`` if it is no TOML, lacks an entry, has one that
    is not known, or names a unit that does not fit the quantity.
    """
    return parse_channel_map(read_text(path), path.name)


def parse_channel_map(text: str, where: str) -> ChannelMap:
    """Read a channel map from its text; ``where`` names it in messages. Raises as :func:`read_channel_map`."""
    top = Fields(parse_toml(text, where, "a channel map"), where)
    kind = MapKind.MOTION if "motion" in top else MapKind.FRF_SET if "frf" in top else MapKind.SESSION
    top.only(_ANY_MAP | _TABLES[kind])
    readers = {MapKind.SESSION: _session_map, MapKind.MOTION: _motion_map, MapKind.FRF_SET: _frf_map}
    return readers[kind](top)


def _session_map(top: Fields) -> ChannelMap:
    if "excitation" not in top:
        raise RecordingFormatError(
            f"{top.where}: expected a table [excitation], the torque or the force that drives the axis; it is missing, "
            "and without it there is no frequency response"
        )
    axis_id = top.text("axis_id")
    excitation, response = _table(top, "excitation"), _table(top, "response")
    quantity = excitation.choice("quantity", ExcitationQuantity)
    measured = "position" in top
    window = _table(top, "window")
    signals = SessionSignals(
        _mapped(excitation, Quantity(quantity)),
        quantity,
        excitation.choice("source", ExcitationSource),
        _mapped(response, Quantity.ACCELERATION),
        _mapped(_table(top, "position"), Quantity.POSITION) if measured else None,
    )
    files = _files(top, _ENTRIES["files"], measured=measured)
    facts = _facts(window, measured=measured)
    if not measured and not files:
        facts_required(facts, window.where)
    return ChannelMap(
        signals,
        axis_id,
        facts,
        _description(top),
        _text(top),
        _time(top),
        _resampling(top),
        window.positive("sample_rate_hz", "Hz") if "sample_rate_hz" in window else None,
        _cutting(window),
        files,
        _tolerances(top),
    )


def facts_required(facts: WindowFacts, where: str) -> None:
    """Refuse windows whose place neither a channel nor the map says."""
    for name, value in (("position_mm", facts.position), ("position_span_mm", facts.position_span)):
        if value is None:
            raise RecordingFormatError(f"{where}, {name}: expected a number [mm]; it is missing")


def _motion_map(top: Fields) -> ChannelMap:
    motion = _table(top, "motion")
    drives = [quantity for quantity in ExcitationQuantity if quantity in motion]
    if len(drives) != 1:
        got = " and ".join(drives) or "neither"
        raise RecordingFormatError(f"{motion.where}: expected one of force and torque; got {got}")
    (quantity,) = drives
    reference = _signal_in(motion, "reference", Quantity.POSITION) if "reference" in motion else None
    signals = MotionSignals(
        _signal_in(motion, "position", Quantity.POSITION),
        _signal_in(motion, quantity, Quantity(quantity)),
        quantity,
        reference,
    )
    return ChannelMap(
        signals,
        _axis_id(top),
        WindowFacts(),
        _description(top),
        _text(top),
        _time(top),
        _resampling(top),
        motion.positive("sample_rate_hz", "Hz") if "sample_rate_hz" in motion else None,
    )


def _frf_map(top: Fields) -> ChannelMap:
    frf = _table(top, "frf")
    window = top.table("window") if "window" in top else Fields({}, f"{top.where} [window]")
    window.only(_CONDITIONS)
    files = _files(top, _CONDITIONS | {"name"}, measured=False)
    facts = _facts(window, measured=False)
    if facts.position is None and not files:
        raise RecordingFormatError(f"{window.where}, position_mm: expected a number [mm]; it is missing")
    return ChannelMap(
        _lines(frf), _axis_id(top), facts, _description(top), _text(top), files=files, tolerances=_tolerances(top)
    )


def _lines(frf: Fields) -> ResponseLines:
    excitation, point = frf.choice("input", ExcitationPoint), frf.choice("output", ResponsePoint)
    pairs = [pair for pair in (("real", "imaginary"), ("magnitude", "phase")) if pair[0] in frf or pair[1] in frf]
    ways = [*(" and ".join(pair) for pair in pairs), *(["response"] if "response" in frf else [])]
    if len(ways) != 1:
        raise RecordingFormatError(
            f"{frf.where}: expected real and imaginary, magnitude and phase, or response; got "
            f"{', '.join(ways) or 'none of them'}"
        )
    whole = None
    parts: tuple[MappedChannel, MappedChannel] | None = None
    if pairs:
        first, second = (_inner(frf, name, _PLACE | {"unit"}) for name in pairs[0])
        value = _quotient(first, excitation, point)
        parts = (value, _phase(second) if pairs[0][1] == "phase" else _quotient(second, excitation, point))
    else:
        whole = value = _quotient(_inner(frf, "response", frozenset(("channel", "unit"))), excitation, point)
    if (whole is None) != ("frequency" in frf):
        missing = "it is missing" if whole is None else "it stands in the response of the file"
        raise RecordingFormatError(f"{frf.where}, frequency: expected where the lines stand, once; {missing}")
    level, other = ("excitation_rms_n", "excitation_rms_nm")[:: 1 if excitation_unit(excitation) == "N" else -1]
    if other in frf:
        raise RecordingFormatError(f"{frf.where}: expected {level} for {excitation}; got {other}")
    number, relative, column = _deviation(frf, value.factor, excitation, point)
    return ResponseLines(
        excitation,
        point,
        whole,
        _frequency(frf) if whole is None else None,
        parts,
        bool(pairs) and pairs[0][1] == "phase",
        number,
        relative,
        column,
        frf.positive("resolution_hz", "Hz") if "resolution_hz" in frf else 0.0,
        frf.positive(level, excitation_unit(excitation)) if level in frf else 0.0,
    )


def _deviation(
    frf: Fields, factor: float, excitation: ExcitationPoint, point: ResponsePoint
) -> tuple[float | None, float | None, MappedChannel | None]:
    """Return the noise of the lines in one of three ways: a number, a part of the magnitude, or a column."""
    stated = [name for name in ("standard_deviation", "relative") if name in frf]
    if len(stated) != 1:
        raise RecordingFormatError(
            f"{frf.where}: expected standard_deviation or relative, how well the lines are known; got "
            f"{' and '.join(stated) or 'neither'}"
        )
    if stated == ["relative"]:
        return None, frf.positive("relative", "-"), None
    if isinstance(frf.values["standard_deviation"], dict):
        return None, None, _quotient(_inner(frf, "standard_deviation", _PLACE | {"unit"}), excitation, point)
    return frf.positive("standard_deviation", "unit of the response") * factor, None, None


def _quotient(fields: Fields, excitation: ExcitationPoint, point: ResponsePoint) -> MappedChannel:
    unit = fields.text("unit")
    row, column = _place(fields)
    factor = response_factor(unit, excitation, point, f"{fields.where}, unit")
    return MappedChannel(fields.text("channel"), unit, factor, row=row, column=column)


def _phase(fields: Fields) -> MappedChannel:
    unit = fields.text("unit")
    if unit not in _DEGREE:
        raise RecordingFormatError(f"{fields.where}, unit: expected 'deg' or 'rad'; got {unit!r}")
    row, column = _place(fields)
    return MappedChannel(fields.text("channel"), unit, _DEGREE[unit], row=row, column=column)


def _frequency(frf: Fields) -> MappedChannel:
    fields = _inner(frf, "frequency", _PLACE | {"unit"})
    unit = fields.text("unit")
    if unit not in ("Hz", "kHz"):
        raise RecordingFormatError(f"{fields.where}, unit: expected 'Hz' or 'kHz'; got {unit!r}")
    row, column = _place(fields)
    return MappedChannel(fields.text("channel"), unit, 1.0 if unit == "Hz" else 1e3, row=row, column=column)


def _table(top: Fields, name: str) -> Fields:
    table = top.table(name)
    table.only(_ENTRIES[name])
    return table


def _inner(fields: Fields, name: str, known: AbstractSet[str]) -> Fields:
    table = fields.table(name)
    table.only(known)
    return table


def _signal_in(fields: Fields, name: str, quantity: Quantity) -> MappedChannel:
    return _mapped(_inner(fields, name, _SIGNAL), quantity)


def _mapped(fields: Fields, quantity: Quantity) -> MappedChannel:
    unit = fields.text("unit")
    if "sensitivity" in fields or "sensitivity_unit" in fields:
        factor = sensor_factor(
            unit, fields.positive("sensitivity", "-"), fields.text("sensitivity_unit"), quantity, fields.where
        )
    else:
        factor = factor_to_si(unit, quantity, f"{fields.where}, unit")
    row, column = _place(fields)
    return MappedChannel(
        fields.text("channel"),
        unit,
        factor,
        fields.optional_number("offset", unit) or 0.0,
        row,
        column,
        fields.text("time") if "time" in fields else None,
    )


def _place(fields: Fields) -> tuple[int | None, int | None]:
    """Return which row and which column of a two-dimensional array is meant, counted from 0."""
    if "row" in fields and "column" in fields:
        raise RecordingFormatError(f"{fields.where}: expected a row or a column; got both")
    row, column = (fields.count(name) - 1 if name in fields else None for name in ("row", "column"))
    return row, column


def _time(top: Fields) -> TimeSource | None:
    if "time" not in top:
        return None
    fields = _table(top, "time")
    channel = fields.text("channel") if "channel" in fields else None
    row, column = _place(fields)
    if "format" not in fields:
        for name in ("date", "zone"):
            if name in fields:
                raise RecordingFormatError(f"{fields.where}: expected {name} with format; got it with unit")
        unit = fields.text("unit")
        factor = factor_to_si(unit, Quantity.TIME, f"{fields.where}, unit")
        return TimeSource(channel, factor, unit, row=row, column=column)
    if "unit" in fields:
        raise RecordingFormatError(f"{fields.where}: expected unit for numbers or format for texts; got both")
    if channel is None:
        raise RecordingFormatError(f"{fields.where}, channel: expected a text; it is missing")
    return TimeSource(
        channel,
        None,
        None,
        _format(fields),
        fields.text("date") if "date" in fields else None,
        _zone(fields) if "zone" in fields else None,
    )


def _format(fields: Fields) -> str:
    form = fields.text("format")
    if form != "iso" and "%" not in form:
        raise RecordingFormatError(f"{fields.where}, format: expected 'iso' or a pattern of strptime; got {form!r}")
    return form


def _zone(fields: Fields) -> timezone:
    text = fields.text("zone")
    if text.upper() == "Z":
        return UTC
    match = _ZONE.fullmatch(text)
    if match is None or int(match[2]) > 23 or int(match[3]) > 59:
        raise RecordingFormatError(f"{fields.where}, zone: expected an offset such as '+01:00' or 'Z'; got {text!r}")
    offset = timedelta(hours=int(match[2]), minutes=int(match[3]))
    return timezone(-offset if match[1] == "-" else offset)


def _resampling(top: Fields) -> Resampling | None:
    if "resample" not in top:
        return None
    fields = _table(top, "resample")
    return Resampling(fields.positive("sample_rate_hz", "Hz"), fields.choice("method", ResampleMethod))


def _cutting(window: Fields) -> Cutting:
    step = window.positive("position_step_mm", "mm") if "position_step_mm" in window else None
    return Cutting(
        window.count("samples_per_window") if "samples_per_window" in window else None,
        window.optional_choice("windows_in", WindowsIn),
        window.positive("window_interval_s", "s") if "window_interval_s" in window else None,
        window.positive("file_interval_s", "s") if "file_interval_s" in window else None,
        None if step is None else metres(step),
    )


def _facts(fields: Fields, *, measured: bool) -> WindowFacts:
    if measured and ("position_mm" in fields or "position_span_mm" in fields):
        raise RecordingFormatError(
            f"{fields.where}: expected the position once; got a [position] channel and position_mm or position_span_mm"
        )
    position, span = (fields.optional_number(name, "mm") for name in ("position_mm", "position_span_mm"))
    started_at: datetime | None = fields.instant("started_at") if "started_at" in fields else None
    return WindowFacts(
        started_at,
        None if position is None else metres(position),
        None if span is None else metres(span),
        fields.optional_number("payload_kg", "kg"),
        fields.optional_number("temperature_c", "°C"),
        fields.optional_number("preload_n", "N"),
        fields.text("measurement") if "measurement" in fields else None,
        fields.optional_choice("direction", Direction),
    )


def _files(top: Fields, known: AbstractSet[str], *, measured: bool) -> tuple[tuple[str, WindowFacts], ...]:
    if "files" not in top:
        return ()
    tables = top.values["files"]
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise RecordingFormatError(f"{top.where}: expected tables [[files]]; got {type(tables).__name__}")
    found: dict[str, WindowFacts] = {}
    for number, table in enumerate(tables, start=1):
        fields = Fields(table, f"{top.where} [[files]] {number}")
        fields.only(known)
        name = fields.text("name")
        if name in found:
            raise RecordingFormatError(f"{fields.where}, name: expected each file once; got {name!r} twice")
        found[name] = _facts(fields, measured=measured)
    return tuple(found.items())


def _tolerances(top: Fields) -> Tolerances:
    if "tolerances" not in top:
        return Tolerances()
    fields = _table(top, "tolerances")
    stated = [fields.not_negative(name, "mm or 1") if name in fields else None for name in Tolerances().attributes]
    return Tolerances(*stated)


def _axis_id(top: Fields) -> str:
    return top.text("axis_id") if "axis_id" in top else ""


def _description(top: Fields) -> str:
    return top.text("description") if "description" in top else ""


def _text(top: Fields) -> TextLayout | None:
    return TextLayout.from_fields(top.table("text")) if "text" in top else None
