"""Read a channel map (TOML): which channel is what, in which unit, and what the raw files do not say.

.. code-block:: toml

    axis_id = "mill-3-x"
    description = "impact moves"               # optional

    [text]                                     # how a text file is written, where it is not plain: see text/layout.py
    separator = "semicolon"

    [excitation]
    channel = "Drive/Current"                  # name in the file
    column = 3                                 # optional: column or row of a two-dimensional array, counted from 1
    quantity = "torque"                        # torque | force | current | acceleration (as it was commanded)
    source = "drive"                           # sensor | drive | commanded
    unit = "A"                                 # what the numbers in the file are; left out, the file states it
    sensitivity = 0.74                         # only with a raw unit (V, A, count, %, deg, …) …
    sensitivity_unit = "N.m/A"                 # … "quantity/raw" or, as on a sensor's sheet, "raw/quantity"
    offset = 0.0                               # optional, in the unit of the file, subtracted first
    wraps_at = 65536                           # optional, in the unit of the file: numbers begin anew there
    time = "Time 1"                            # optional: channel with the sampling times of this one, unit as [time]

    [excitation.sweep]                         # only where the file holds none: by names of Klipper,
    min_freq = 5                               # max_freq, accel_per_hz, hz_per_sec, sweeping_accel, sweeping_period and
    moving_mass_kg = 0.45                      # what is moved; channel is then any name, and unit "N"

    [response]
    channel = "Nut/Acceleration"
    quantity = "acceleration"                  # may be left out; or velocity | displacement | motor-angle | motor-speed
    unit = "g"                                 # | relative-displacement: the motor's way less that of this scale
    resolution = 0.001                         # optional step of the numbers, in the unit of the file
    lead_mm = 10                               # only of a motor's angle or speed that the file has in mm or mm/s

    [response.motor]                           # only of a relative displacement of two channels
    channel = "Motor/Angle"
    unit = "deg"
    lead_mm = 10                               # way of the table for one turn; negative: the two count against another

    [position]                                 # optional measured travel; replaces the two position entries below
    channel = "Drive/Position"
    unit = "mm"

    [reference]                                # optional: what the control was told from outside of its loop, such as
    channel = "Drive/Position.cmd"             # the position set-point (no torque or current that it asks for itself):
    unit = "mm"                                # takes off what the loop does to the frequency; any quantity

    [time]                                     # only if a channel holds the sampling times
    channel = "t"
    unit = "s"                                 # numbers; or of the samples: sample_rate_hz; or, for texts of a date:
    format = "iso"                             # iso | a pattern of strptime such as "%d.%m.%Y %H:%M:%S.%f"
    date = "Date"                              # optional second channel in front of it
    zone = "+01:00"                            # where the texts carry none

    [resample]                                 # only where clocks differ or sampling is uneven
    sample_rate_hz = 5000
    method = "cubic"                           # cubic | linear

    [window]
    sample_rate_hz = 10000                     # only if neither the file nor [time] says it; or "fs", the name of a
                                               # single number of the file, as in samples_per_window
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
``imaginary`` or ``magnitude`` (in decibels with ``unit = "dB re 1 m/(N.s2)"``) and ``phase`` (deg or rad), or
``response``, the name of a frequency response that the file itself holds; ``standard_deviation`` (in the unit of the
response; or a channel) or ``relative``; optionally ``resolution_hz`` and ``excitation_rms_nm`` or ``excitation_rms_n``.
Conditions stand in ``[window]`` or ``[[files]]``.

A rate or a start stated in the file *and* here is refused, and so are a unit that contradicts the file or the name of
its channel, and an entry that is not listed above.
"""

import math
import re
from collections.abc import Callable, Mapping, Set as AbstractSet
from dataclasses import replace
from functools import partial
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.recording import Direction, ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import listed, parse_toml, read_text
from monitor_core.recordings.elements.units import (
    Quantity,
    canonical_unit,
    excitation_unit,
    factor_to_si,
    metres,
    quantity_of_unit,
    response_factor,
    sensor_factor,
)
from monitor_core.recordings.raw.mapping.map_records import (
    RESPONSE_QUANTITIES,
    TRAVEL_OF,
    ChannelMap,
    Cutting,
    MapKind,
    MappedChannel,
    MotionSignals,
    NamedNumbers,
    ResampleMethod,
    Resampling,
    ResponseLines,
    SessionSignals,
    Sweep,
    TimeSource,
    Tolerances,
    WindowFacts,
    WindowsIn,
)
from monitor_core.recordings.raw.mapping.times import zone_of
from monitor_core.recordings.raw.text.layout import TextLayout

_PLACE = frozenset(("channel", "column", "row"))
_SIGNAL = _PLACE | {"unit", "sensitivity", "sensitivity_unit", "offset", "time", "wraps_at"}
_MOTOR = _SIGNAL | {"resolution", "lead_mm"}
_SWEEP = frozenset((
    "min_freq", "max_freq", "accel_per_hz", "hz_per_sec", "sweeping_accel", "sweeping_period", "moving_mass_kg",
))  # fmt: skip
#: What ``[window]`` and ``[[files]]`` may state of a frequency response, and of windows.
_CONDITIONS = frozenset(("position_mm", "payload_kg", "temperature_c", "preload_n"))
_FACTS = _CONDITIONS | {"started_at", "position_span_mm", "measurement", "direction"}
#: Entries of each table.
_ENTRIES: dict[str, AbstractSet[str]] = {
    "excitation": _SIGNAL | {"quantity", "source", "sweep"},
    "response": _SIGNAL | {"quantity", "resolution", "lead_mm", "motor"},
    "position": _SIGNAL,
    "reference": _PLACE | {"unit", "time"},
    "time": _PLACE | {"unit", "format", "date", "zone", "sample_rate_hz"},
    "resample": {"sample_rate_hz", "method"},
    "window": _FACTS | {
        "sample_rate_hz", "samples_per_window", "windows_in", "window_interval_s", "file_interval_s",
        "position_step_mm",
    },
    "files": _FACTS | {"name"},
    "tolerances": Tolerances().attributes.keys(),
    "motion": {"position", "force", "torque", "reference", "sample_rate_hz"},
    "frf": {
        "input", "output", "frequency", "real", "imaginary", "magnitude", "phase", "response", "standard_deviation",
        "relative", "resolution_hz", "excitation_rms_nm", "excitation_rms_n",
    },
}  # fmt: skip
#: Tables of a map of each kind, and entries outside of them.
_TOP = {
    MapKind.SESSION: {
        "excitation",
        "response",
        "position",
        "reference",
        "time",
        "resample",
        "window",
        "files",
        "tolerances",
    },
    MapKind.MOTION: {"motion", "time", "resample"},
    MapKind.FRF_SET: {"frf", "window", "files", "tolerances"},
}
#: Entries that no map of a kind does without.
_REQUIRED: dict[MapKind, dict[str, tuple[str, ...]]] = {
    MapKind.SESSION: {"": ("axis_id",), "excitation": ("channel", "quantity", "source"), "response": ("channel",)},
    MapKind.MOTION: {"motion": ("position",)},
    MapKind.FRF_SET: {"frf": ("input", "output")},
}
_PLACES_OF_KIND = {MapKind.SESSION: ("position_mm", "position_span_mm"), MapKind.FRF_SET: ("position_mm",)}
_ANY_MAP = {"axis_id", "description", "text"}
_PHASES = {"deg": math.pi / 180.0, "rad": 1.0}
_FREQUENCIES = {"Hz": 1.0, "kHz": 1e3, "rad/s": 0.5 / math.pi}
_NUMBER = re.compile(r"[-+\d.,eE\s]*")  # a text of these is a number in quotes, and no name of one
_LEVEL = re.compile(r"dB re (?:1 ?)?(.+)")  # of a field quantity, as ISO 1683 writes it


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
    top.only(_ANY_MAP | _TOP[kind])
    _require_entries(top, kind)
    return {MapKind.SESSION: _session_map, MapKind.MOTION: _motion_map, MapKind.FRF_SET: _frf_map}[kind](top)


def _require_entries(top: Fields, kind: MapKind) -> None:
    """Refuse a map that lacks several entries, with all of them; one alone is refused where it is read."""
    required = dict(_REQUIRED[kind])
    if kind is not MapKind.MOTION and "position" not in top and "files" not in top:
        required["window"] = _PLACES_OF_KIND[kind][: 1 if _says_travel(top) else None]
    missing = []
    for name, entries in required.items():
        table = top.values.get(name, {}) if name else top.values
        lacking = [entry for entry in entries if isinstance(table, dict) and entry not in table]
        whole = f"a table [{name}] with {', '.join(lacking)}"
        there = f"{', '.join(lacking)}{f' in [{name}]' if name else ''}"
        missing += [there if not name or name in top else whole] if lacking else []
    if len(missing) > 1 or any("," in entries for entries in missing):
        raise RecordingFormatError(f"{top.where}: expected {'; '.join(missing)}; they are missing")


def _says_travel(top: Fields) -> bool:
    response = top.values.get("response")
    return isinstance(response, dict) and _is_of_scale(response.get("quantity"), motor="motor" in response)


def _is_of_scale(quantity: object, *, motor: bool) -> bool:
    """Tell whether a response is of a scale, which says how far the table goes in a window."""
    return quantity == ResponseQuantity.DISPLACEMENT or motor


def _session_map(top: Fields) -> ChannelMap:
    if "excitation" not in top:
        raise RecordingFormatError(
            f"{top.where}: expected a table [excitation], the torque, force or current that drives the axis; it is "
            "missing, and without it there is no frequency response"
        )
    axis_id = top.text("axis_id")
    excitation = _table(top, "excitation")
    quantity = excitation.choice("quantity", ExcitationQuantity)
    measured = "position" in top
    window = _table(top, "window")
    answers, response, motor = _response(_table(top, "response"))
    signals = SessionSignals(
        _channel(excitation, Quantity(quantity)),
        quantity,
        excitation.choice("source", ExcitationSource),
        response,
        _channel(_table(top, "position"), Quantity.POSITION) if measured else None,
        answers,
        motor,
        _sweep(excitation.table("sweep", _SWEEP)) if "sweep" in excitation else None,
        _reference(_table(top, "reference")) if "reference" in top else None,
    )
    files = _files(top, _ENTRIES["files"], measured=measured)
    facts, named = _facts(window, measured=measured), _named(window)
    if not measured and not files:
        facts_required(facts, signals, window.where)
    return ChannelMap(
        signals,
        axis_id,
        facts,
        top.optional_text("description") or "",
        _text(top),
        _time_source(top),
        _resampling(top),
        None if named.sample_rate else window.optional_positive("sample_rate_hz", "Hz"),
        _cutting(window, named),
        files,
        _tolerances(top),
        named,
    )


def _reference(fields: Fields) -> MappedChannel:
    """Return the channel of a set-point, whose numbers are taken as they are."""
    return replace(_line(fields, _as_it_is), time=fields.optional_text("time"))


def _as_it_is(unit: str, where: str) -> float:
    if quantity_of_unit(unit) is None:
        raise RecordingFormatError(f"{where}: expected a unit, of any quantity; got {unit!r}")
    return 1.0


def _sweep(fields: Fields) -> Sweep:
    """Return the settings of a resonance test, by Klipper's names for them and in its millimetres."""
    return Sweep(
        fields.positive("min_freq", "Hz"),
        fields.positive("max_freq", "Hz"),
        1e-3 * fields.positive("accel_per_hz", "mm/s2/Hz"),
        fields.positive("hz_per_sec", "Hz/s"),
        1e-3 * fields.not_negative("sweeping_accel", "mm/s2"),
        fields.not_negative("sweeping_period", "s"),
        fields.positive("moving_mass_kg", "kg"),
    )


def _motion_map(top: Fields) -> ChannelMap:
    motion = _table(top, "motion")
    drives = [quantity for quantity in ExcitationQuantity if quantity in motion]
    if len(drives) != 1:
        got = " and ".join(drives) or "neither"
        raise RecordingFormatError(f"{motion.where}: expected one of force and torque; got {got}")
    (quantity,) = drives

    def signal(name: str, quantity: Quantity) -> MappedChannel:
        return _channel(motion.table(name, _SIGNAL), quantity)

    reference = signal("reference", Quantity.POSITION) if "reference" in motion else None
    position, drive = signal("position", Quantity.POSITION), signal(quantity, Quantity(quantity))
    return ChannelMap(
        MotionSignals(position, drive, quantity, reference),
        top.optional_text("axis_id") or "",
        WindowFacts(),
        top.optional_text("description") or "",
        _text(top),
        _time_source(top),
        _resampling(top),
        motion.optional_positive("sample_rate_hz", "Hz"),
    )


def _frf_map(top: Fields) -> ChannelMap:
    frf = _table(top, "frf")
    window = top.table("window", _CONDITIONS) if "window" in top else Fields({}, f"{top.where} [window]")
    files = _files(top, _CONDITIONS | {"name"}, measured=False)
    facts = _facts(window, measured=False)
    if facts.position is None and not files:
        raise RecordingFormatError(f"{window.where}, position_mm: expected a number [mm]; it is missing")
    return ChannelMap(
        _response_lines(frf),
        top.optional_text("axis_id") or "",
        facts,
        top.optional_text("description") or "",
        _text(top),
        files=files,
        tolerances=_tolerances(top),
    )


def _table(top: Fields, name: str) -> Fields:
    return top.table(name, _ENTRIES[name])


def _text(top: Fields) -> TextLayout | None:
    return TextLayout.from_fields(top.table("text")) if "text" in top else None


def facts_required(facts: WindowFacts, signals: SessionSignals, where: str) -> None:
    """Refuse windows whose place neither a channel nor the map says; the way of a scale says how far they reach."""
    travels = _is_of_scale(signals.response_quantity, motor=signals.motor is not None)
    for name, value in (("position_mm", facts.position), ("position_span_mm", facts.position_span)):
        if value is None and not (travels and name == "position_span_mm"):
            raise RecordingFormatError(f"{where}, {name}: expected a number [mm]; it is missing")


def _response(fields: Fields) -> tuple[ResponseQuantity, MappedChannel, MappedChannel | None]:
    """Return what answers, its channel, and of a relative displacement of two channels that of the motor in metres."""
    quantity = fields.optional_choice("quantity", ResponseQuantity) or ResponseQuantity.ACCELERATION
    measured = RESPONSE_QUANTITIES[quantity]
    lead = fields.optional_positive("lead_mm", "mm")
    if lead is not None and measured not in TRAVEL_OF:
        raise RecordingFormatError(
            f"{fields.where}: expected lead_mm for a motor-angle or a motor-speed; got it for a {quantity}"
        )
    response = _channel(fields, measured, metres_per_turn=None if lead is None else metres(lead))
    if "motor" not in fields:
        return quantity, response, None
    if quantity is not ResponseQuantity.RELATIVE_DISPLACEMENT:
        raise RecordingFormatError(
            f'{fields.where}: expected quantity = "relative-displacement" with a table [response.motor]; got {quantity}'
        )
    motor = fields.table("motor", _MOTOR)
    lead = motor.number("lead_mm", "mm")
    if lead == 0.0:
        raise RecordingFormatError(f"{motor.where}, lead_mm: expected the way of the table for a turn; got 0 mm")
    angle = _channel(motor, Quantity.ANGLE, metres_per_turn=metres(lead))
    metres_per_radian = metres(lead) / (2.0 * math.pi)
    travel = partial(_travel, metres_per_radian, angle.convert)  # no function of its own: maps go to other processes
    return quantity, response, replace(angle, factor=metres_per_radian * angle.factor, convert=travel)


def _travel(metres_per_radian: float, convert: Callable[..., float], unit: str, where: str) -> float:
    """Return the factor of an angle to the way that the table goes by it."""
    return metres_per_radian * convert(unit, where=where)


def _factor_of_turning(unit: str, quantity: Quantity, metres_per_turn: float, where: str) -> float:
    """Return the factor of what turns to SI, which controls write as the way that the table goes by it, too."""
    travel = TRAVEL_OF[quantity]
    if quantity_of_unit(unit) is travel:
        return factor_to_si(unit, travel, where) * 2.0 * math.pi / metres_per_turn
    return factor_to_si(unit, quantity, where)


def _channel(fields: Fields, quantity: Quantity, *, metres_per_turn: float | None = None) -> MappedChannel:
    """Return a channel with the factor that its numbers are brought to SI by."""
    if "sensitivity" in fields or "sensitivity_unit" in fields:
        sensitivity, its_unit = fields.positive("sensitivity", "-"), fields.text("sensitivity_unit")
        convert = partial(sensor_factor, sensitivity=sensitivity, sensitivity_unit=its_unit, quantity=quantity)
    elif metres_per_turn is not None:
        convert = partial(_factor_of_turning, quantity=quantity, metres_per_turn=metres_per_turn)
    else:
        convert = partial(factor_to_si, quantity=quantity)
    line = _line(fields, convert)
    return replace(
        line,
        offset=fields.optional_number("offset", line.unit) or 0.0,
        time=fields.optional_text("time"),
        wraps_at=fields.optional_positive("wraps_at", line.unit),
        resolution=fields.optional_positive("resolution", line.unit),
    )


def _place(fields: Fields) -> tuple[int | None, int | None]:
    """Return which row and which column of a two-dimensional array is meant, counted from 0."""
    if "row" in fields and "column" in fields:
        raise RecordingFormatError(f"{fields.where}: expected a row or a column; got both")
    row, column = (fields.count(name) - 1 if name in fields else None for name in ("row", "column"))
    return row, column


def _time_source(top: Fields) -> TimeSource | None:
    """Return where the sampling times stand; None where nothing is said."""
    if "time" not in top:
        return None
    fields = _table(top, "time")
    channel = fields.optional_text("channel")
    row, column = _place(fields)
    if "format" not in fields:
        for name in ("date", "zone"):
            if name in fields:
                raise RecordingFormatError(f"{fields.where}: expected {name} with format; got it with unit")
        unit = fields.optional_text("unit")
        if unit is not None:
            factor_to_si(unit, Quantity.TIME, f"{fields.where}, unit")
        counts_at = fields.optional_positive("sample_rate_hz", "Hz")
        if counts_at is not None and (unit is not None or channel is None):
            raise RecordingFormatError(
                f"{fields.where}: expected sample_rate_hz with a channel of sample numbers alone"
            )
        return TimeSource(channel, unit, row=row, column=column, counts_at=counts_at)
    if "unit" in fields:
        raise RecordingFormatError(f"{fields.where}: expected unit for numbers or format for texts; got both")
    channel = fields.text("channel")
    form = fields.text("format")
    if form != "iso" and "%" not in form:
        raise RecordingFormatError(f"{fields.where}, format: expected 'iso' or a pattern of strptime; got {form!r}")
    date, zone = fields.optional_text("date"), fields.optional_text("zone")
    return TimeSource(channel, None, form, date, None if zone is None else zone_of(zone, fields.where))


def _resampling(top: Fields) -> Resampling | None:
    """Return how channels are brought to one clock; None where nothing is said."""
    if "resample" not in top:
        return None
    fields = _table(top, "resample")
    return Resampling(fields.positive("sample_rate_hz", "Hz"), fields.choice("method", ResampleMethod))


def _named(fields: Fields) -> NamedNumbers:
    """Return which numbers the map leaves to single numbers of the file, by their names."""

    def name_in(entry: str) -> str | None:
        value = fields.values.get(entry)
        return value if isinstance(value, str) and not _NUMBER.fullmatch(value) else None

    return NamedNumbers(name_in("sample_rate_hz"), name_in("samples_per_window"))


def _cutting(window: Fields, named: NamedNumbers) -> Cutting:
    """Return how long records are cut into windows."""
    step = window.optional_positive("position_step_mm", "mm")
    return Cutting(
        window.count("samples_per_window") if "samples_per_window" in window and not named.samples_per_window else None,
        window.optional_choice("windows_in", WindowsIn),
        window.optional_positive("window_interval_s", "s"),
        window.optional_positive("file_interval_s", "s"),
        None if step is None else metres(step),
    )


def _facts(fields: Fields, *, measured: bool) -> WindowFacts:
    """Return what is stated of windows, whose position is ``measured`` by a channel or stated here."""
    if measured and ("position_mm" in fields or "position_span_mm" in fields):
        raise RecordingFormatError(
            f"{fields.where}: expected the position once; got a [position] channel and position_mm or position_span_mm"
        )
    position, span = (fields.optional_number(name, "mm") for name in ("position_mm", "position_span_mm"))
    return WindowFacts(
        fields.instant("started_at") if "started_at" in fields else None,
        None if position is None else metres(position),
        None if span is None else metres(span),
        fields.optional_number("payload_kg", "kg"),
        fields.optional_number("temperature_c", "°C"),
        fields.optional_number("preload_n", "N"),
        fields.optional_text("measurement"),
        fields.optional_choice("direction", Direction),
    )


def _files(top: Fields, known: AbstractSet[str], *, measured: bool) -> tuple[tuple[str, WindowFacts], ...]:
    """Return what is stated of each file, by its name and in the order of the map."""
    tables = top.values.get("files", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise RecordingFormatError(f"{top.where}: expected tables [[files]]; got {type(tables).__name__}")
    stated: dict[str, WindowFacts] = {}
    for number, table in enumerate(tables, start=1):
        fields = Fields(table, f"{top.where} [[files]] {number}")
        fields.only(known)
        name = fields.text("name")
        if name in stated:
            raise RecordingFormatError(f"{fields.where}, name: expected each file once; got {name!r} twice")
        stated[name] = _facts(fields, measured=measured)
    return tuple(stated.items())


def _tolerances(top: Fields) -> Tolerances:
    """Return how well settings are known, as far as it is stated."""
    if "tolerances" not in top:
        return Tolerances()
    fields = _table(top, "tolerances")
    stated = [fields.not_negative(name, "mm or 1") if name in fields else None for name in Tolerances().attributes]
    return Tolerances(*stated)


def _response_lines(frf: Fields) -> ResponseLines:
    """Return where the lines of a response stand; raises RecordingFormatError where that is not said once."""
    excitation, point = frf.choice("input", ExcitationPoint), frf.choice("output", ResponsePoint)

    def quotient(name: str, entries: AbstractSet[str] = _PLACE | {"unit"}) -> MappedChannel:
        fields = frf.table(name, entries)
        convert = partial(response_factor, excitation=excitation, response=point)
        return _line(fields, convert, may_be_level=name == "magnitude")

    pairs = [pair for pair in (("real", "imaginary"), ("magnitude", "phase")) if pair[0] in frf or pair[1] in frf]
    ways = [*(" and ".join(pair) for pair in pairs), *(["response"] if "response" in frf else [])]
    if len(ways) != 1:
        raise RecordingFormatError(
            f"{frf.where}: expected real and imaginary, magnitude and phase, or response; got "
            f"{', '.join(ways) or 'none of them'}"
        )
    parts: tuple[MappedChannel, MappedChannel] | None = None
    polar = bool(pairs) and pairs[0][1] == "phase"
    if pairs:
        parts = quotient(pairs[0][0]), _line_in(frf, "phase", _PHASES) if polar else quotient("imaginary")
    whole = None if pairs else quotient("response", {"channel", "unit"})
    if (whole is None) != ("frequency" in frf):
        missing = "it is missing" if whole is None else "it stands in the response of the file"
        raise RecordingFormatError(f"{frf.where}, frequency: expected where the lines stand, once; {missing}")
    level, other = ("excitation_rms_n", "excitation_rms_nm")[:: 1 if excitation_unit(excitation) == "N" else -1]
    if other in frf:
        raise RecordingFormatError(f"{frf.where}: expected {level} for {excitation}; got {other}")
    stated = [name for name in ("standard_deviation", "relative") if name in frf]
    if len(stated) != 1:
        raise RecordingFormatError(
            f"{frf.where}: expected standard_deviation or relative, how well the lines are known; got "
            f"{' and '.join(stated) or 'neither'}"
        )
    in_column = isinstance(frf.values.get("standard_deviation"), dict)
    number = None if in_column else frf.optional_positive("standard_deviation", "unit of the response")
    return ResponseLines(
        excitation,
        point,
        whole,
        _line_in(frf, "frequency", _FREQUENCIES) if whole is None else None,
        parts,
        polar,
        number,
        frf.optional_positive("relative", "-"),
        quotient("standard_deviation") if in_column else None,
        frf.optional_positive("resolution_hz", "Hz") or 0.0,
        frf.optional_positive(level, excitation_unit(excitation)) or 0.0,
    )


def _line_in(frf: Fields, name: str, units: Mapping[str, float]) -> MappedChannel:
    """Return a column that is in one of some units."""
    return _line(frf.table(name, _PLACE | {"unit"}), partial(_factor_among, units=units))


def _factor_among(unit: str, units: Mapping[str, float], where: str) -> float:
    name = canonical_unit(unit)
    if name is None or name not in units:
        raise RecordingFormatError(f"{where}: expected {listed([repr(known) for known in units])}; got {unit!r}")
    return units[name]


def _line(fields: Fields, convert: Callable[..., float], *, may_be_level: bool = False) -> MappedChannel:
    """Return where numbers stand and what they are in; the factor is NaN where the unit is left to the file."""
    (row, column), stated = _place(fields), fields.optional_text("unit") or ""
    level = _LEVEL.fullmatch(stated) if may_be_level else None
    unit = level[1] if level is not None else stated
    factor = convert(unit, where=f"{fields.where}, unit") if unit else math.nan
    return MappedChannel(
        fields.text("channel"), unit, factor, convert, row=row, column=column, in_decibels=level is not None
    )
