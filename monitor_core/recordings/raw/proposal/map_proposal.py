"""Propose a channel map for a raw file, to fill in, in which every entry says what it is.

What names, units and shapes suggest is to be confirmed; what the file does not say is to be filled in. Nothing that a
file leaves open is given a value by itself.
"""

from collections.abc import Iterator, Sequence
from datetime import datetime

from monitor_core.recording import ExcitationQuantity, ResponseQuantity
from monitor_core.recordings.elements.files import stem_of
from monitor_core.recordings.elements.units import Quantity, canonical_unit, quantity_of_unit
from monitor_core.recordings.raw.channel_kind import DRIVES
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.mapping.map_records import RESPONSE_QUANTITIES, TRAVEL_OF
from monitor_core.recordings.raw.proposal.entries import (
    MapEntry,
    MapProposal,
    MapTable,
    Mark,
    channel_entries,
    missing,
    number,
    plain,
    printed,
)
from monitor_core.recordings.raw.proposal.parts import (
    IMAGINARY,
    MAGNITUDE,
    PHASE,
    REAL,
    Made,
    Part,
    first_like,
    made_of_parts,
    parts_of,
)
from monitor_core.recordings.raw.proposal.sampling import (
    TextTimes,
    cutting_entry,
    rate_entry,
    rate_of_texts,
    text_times,
    time_tables,
)
from monitor_core.recordings.raw.proposal.signals import Signals, caution_of, quantity_of, signals_in, what_they_show
from monitor_core.recordings.raw.stated_numbers import rate_of_numbers
from monitor_core.recordings.raw.text.layout import TextLayout

_MOST_LISTED = 40
_NO_ACCELERATION = "velocity | displacement | motor-angle | motor-speed; left out, it is an acceleration"
_REMARKS_OF_TEXT = {
    "separator": "between columns: tab | semicolon | comma | blank",
    "decimal": "point | comma",
    "header_row": "row of the names, counted from 1; 0 where there is no such row",
    "unit_row": "row of the units",
    "first_row": "first row of numbers",
    "comment": "lines that begin so are left out",
    "encoding": "utf-8 | latin-1 | utf-16",
    "sheet": "of the workbook",
    "believe": "rows: where the header states another number of samples",
}
_POSITION = missing("position_mm", "where the table stood, in mm from the fixed bearing")


def proposed_map(channels: Channels, layout: TextLayout | None = None) -> MapProposal:
    """Propose a map for channels that were read; ``layout`` is how a text is written, where not plain."""
    parts, texts = parts_of(channels), text_times(channels.texts)
    tables = {Made.FRF_SET: _frf_tables, Made.MOTION: _motion_tables, Made.SESSION: _session_tables}
    name = stem_of(channels.file_name) or "axis"
    axis = MapTable("", (MapEntry("axis_id", name, "name of the axis; this is the name of the file"),))
    text = [] if layout is None else [MapTable("text", tuple(_text_entries(layout)))]
    made = made_of_parts(channels, parts)
    return MapProposal(
        tuple(_in_file(channels, parts)), (axis, *text, *tables[made](parts, texts, channels)), channels.file_name
    )


def _in_file(channels: Channels, parts: Sequence[Part]) -> Iterator[str]:
    yield from (_described(part, channels.started_at(part.channel)) for part in parts[:_MOST_LISTED])
    if len(parts) > _MOST_LISTED:
        yield f"… and {len(parts) - _MOST_LISTED} more"
    for response in channels.responses[:_MOST_LISTED]:
        yield f"{plain(response.name)}: frequency response, {response.frequency.size} lines"


def _described(part: Part, started_at: datetime | None) -> str:
    channel = part.channel
    facts = [f"shape {'x'.join(map(str, part.shape))}"]
    facts.append(plain(channel.unit) if channel.unit else "no unit")
    if channel.time.rates:
        facts.append(" then ".join(f"{rate:g} Hz" for rate in channel.time.rates))
    if started_at is not None:
        facts.append(f"from {started_at.isoformat()}")
    if channel.time.clock is not None:
        facts.append(f"times in {plain(channel.time.clock)}")
    facts.append("first " + ", ".join(f"{value:g}" for value in part.head.reshape(-1)[:3]))
    looks = f" ({part.kind}-like)" if part.kind is not None else ""
    place = f", {part.entry} {part.number}" if part.entry else ""
    return f"{plain(channel.name)}{place}: {', '.join(facts)}{looks}"


def _text_entries(layout: TextLayout) -> Iterator[MapEntry]:
    for name, value in layout.entries().items():
        yield MapEntry(name, str(value), _REMARKS_OF_TEXT[name], is_text=isinstance(value, str))


def _session_tables(parts: Sequence[Part], texts: TextTimes | None, channels: Channels) -> Iterator[MapTable]:
    signals = signals_in(parts)
    shapes = {part.shape for part in signals.known}
    alike = [part for part in parts if part.shape in shapes or not shapes]
    travels = signals.answers is ResponseQuantity.DISPLACEMENT
    places = () if travels else (Quantity.POSITION, Quantity.ANGLE)
    position = first_like(alike, places, signals.known)
    lengths = {max(shape) for shape in shapes}
    fitting = [part for part in parts if part.size in lengths or not lengths]
    taken = (*signals.known, position)
    times: Part | TextTimes | None = first_like(fitting, (Quantity.TIME,), taken) or texts
    yield MapTable("excitation", tuple(_excitation_lines(signals, parts)))
    what = "the acceleration of nut or table" if signals.answers is ResponseQuantity.ACCELERATION else ""
    yield MapTable("response", tuple(_response_lines(signals, parts)), what, plain(what_they_show(signals)))
    if signals.motor is not None:
        remark = 'with quantity = "relative-displacement" above: what the drive itself yields'
        yield MapTable("response.motor", tuple(_motor_lines(signals.motor)), remark, optional=True)
    if position is not None:
        travel = tuple(channel_entries(position, Quantity.POSITION, parts))
        yield MapTable("position", travel, "measured travel; without it, position_mm in [window]")
    if signals.reference is not None:
        remark = "a set-point that the control follows: takes off what its loop does to the frequency"
        remark += caution_of(signals.reference)
        yield MapTable("reference", tuple(_reference_lines(signals.reference)), remark, optional=True)
    used = [*signals.known, *([] if position is None else [position])]
    yield from time_tables(times, used, channels)
    lines = _window_lines(used, times, channels, has_position=position is not None, travels=travels)
    yield MapTable("window", tuple(lines))


def _excitation_lines(signals: Signals, parts: Sequence[Part]) -> Iterator[MapEntry | str]:
    place, others = _parted(channel_entries(signals.excitation, quantity_of(signals.excited), parts))
    yield from place
    if signals.excited is None:
        yield missing("quantity", '"torque" or "force"')
    else:
        yield MapEntry("quantity", str(signals.excited), "torque | force | current | acceleration")
    yield MapEntry(
        "source", str(signals.source), "sensor: measured; drive: current, or torque from it; commanded: asked for"
    )
    yield from others
    if signals.excited is ExcitationQuantity.CURRENT:
        yield (
            'where the torque constant is known: quantity = "torque", sensitivity = 0.74, sensitivity_unit = "N.m/A"; '
            "then modal mass and friction torque, too"
        )


def _response_lines(signals: Signals, parts: Sequence[Part]) -> Iterator[MapEntry | str]:
    quantity = RESPONSE_QUANTITIES[signals.answers]
    place, others = _parted(channel_entries(signals.response, quantity, parts))
    yield from place
    if signals.answers is not ResponseQuantity.ACCELERATION:
        yield MapEntry("quantity", str(signals.answers), _NO_ACCELERATION)
    unit = None if signals.response is None else signals.response.unit
    if quantity in TRAVEL_OF and quantity_of_unit(unit) is TRAVEL_OF[quantity]:
        yield MapEntry("unit", str(unit), "as file or name say: the way that the table goes by it")
        yield missing("lead_mm", "way of the table for a turn of the motor")
    else:
        yield from others
    if signals.answers is ResponseQuantity.DISPLACEMENT and signals.excited is ExcitationQuantity.TORQUE:
        yield "for preload explain (family motion) a table [motion] with position and torque, in place of these two"


def _motor_lines(motor: Part) -> Iterator[MapEntry]:
    yield MapEntry("channel", motor.channel.name, "angle of the motor", Mark.OPTIONAL)
    yield MapEntry("unit", motor.unit or "rad", "rad, deg or rev", Mark.OPTIONAL)
    yield number("lead_mm", "10", "way of the table for a turn of the motor", Mark.OPTIONAL)


def _reference_lines(reference: Part) -> Iterator[MapEntry]:
    yield MapEntry("channel", reference.channel.name, "planned, by its name", Mark.OPTIONAL)
    yield MapEntry("unit", reference.unit or "", "of any quantity", Mark.OPTIONAL)


def _parted(entries: Iterator[MapEntry]) -> tuple[list[MapEntry], list[MapEntry]]:
    """Part the entries of a channel: where its numbers stand, and what they are in."""
    listed = list(entries)
    n_of_place = sum(entry.name in ("channel", "row", "column") for entry in listed)
    return listed[:n_of_place], listed[n_of_place:]


def _window_lines(
    signals: Sequence[Part], times: Part | TextTimes | None, channels: Channels, *, has_position: bool, travels: bool
) -> Iterator[MapEntry | str]:
    arrays = [part.shape for part in signals if len(part.shape) == 2]
    rates = [rate for part in signals for rate in part.channel.time.rates]
    timed = [*signals, *([times] if isinstance(times, Part) else [])]
    starts = [start for part in timed if (start := channels.started_at(part.channel)) is not None]
    clocks = any(part.channel.time.clock is not None for part in signals)
    stated = rate_of_numbers(channels) if times is None and not rates and not clocks else None
    if rates:
        yield f"sample_rate_hz is left out: the file says {rates[0]:g} Hz"
    elif times is None and not clocks:
        yield rate_entry(stated)
    if starts:
        yield f"started_at is left out: the file says {starts[0].isoformat()}"
    elif isinstance(times, TextTimes) and times.is_dated and not rates and not clocks:
        yield "started_at is left out: [time] says it"
    else:
        yield missing("started_at", "when the record began, with its zone, such as 2025-03-01T06:00:00Z")
    if not has_position:
        yield _POSITION
    if travels:
        yield "position_span_mm is left out: the scale says how far the table goes"
    elif not has_position:
        yield number("position_span_mm", "0.0", "travel of the table during a window; 0 where it stood still")
    if arrays:
        in_rows = arrays[0][0] <= arrays[0][1]
        shape = "x".join(map(str, arrays[0]))
        yield MapEntry("windows_in", "rows" if in_rows else "columns", f"the array is {shape}")
        yield missing("window_interval_s", "from the start of one window to the start of the next")
    else:
        rate = stated.sample_rate if stated else None
        yield cutting_entry(
            signals, times, rate_of_texts(times, channels) if isinstance(times, TextTimes) else rate, channels
        )
    measurement = "joins files within 10 minutes of each other; else each is a measurement"
    yield MapEntry("measurement", "at 250 mm", measurement, Mark.OPTIONAL)
    for name, value, remark in (
        ("file_interval_s", "60", "several files, from the start of one to that of the next"),
        ("preload_n", "300", "only where it was set on purpose, as for a calibration"),
        ("payload_kg", "0.0", "on the table; left out, an interval holds all that may lie there"),
        ("temperature_c", "21.5", "as direction (+ | - | both)"),
    ):
        yield number(name, value, remark, Mark.OPTIONAL)


def _motion_tables(parts: Sequence[Part], texts: TextTimes | None, channels: Channels) -> Iterator[MapTable]:
    drive = first_like(parts, DRIVES)
    position = first_like(parts, (Quantity.POSITION,), (drive,))
    others = [part for part in parts if part.kind is Quantity.POSITION and part is not position]
    times = first_like(parts, (Quantity.TIME,)) or texts
    signals = [part for part in (drive, position) if part is not None]
    has_rate = times is not None or any(part.channel.time.rates for part in signals)
    rate = () if has_rate else (rate_entry(rate_of_numbers(channels)),)
    what = "position and drive without an acceleration: a motion record, for preload explain (family motion)"
    yield MapTable("motion", rate, above=what)
    yield MapTable("motion.position", tuple(channel_entries(position, Quantity.POSITION, parts)))
    quantity = quantity_of_unit(None if drive is None else drive.unit)
    quantity = quantity if quantity in (Quantity.FORCE, Quantity.TORQUE) else Quantity.FORCE
    yield MapTable(f"motion.{quantity}", tuple(channel_entries(drive, quantity, parts)))
    if others:
        commanded = tuple(channel_entries(others[0], Quantity.POSITION, parts))
        yield MapTable("motion.reference", commanded, "the position that was commanded; may be left out")
    yield from time_tables(times, signals, channels)


def _frf_tables(parts: Sequence[Part], texts: TextTimes | None, channels: Channels) -> Iterator[MapTable]:
    points = '"acceleration-at-table" | "acceleration-at-nut" | "displacement-at-table" | "angle-at-motor"'
    about = (
        missing("input", '"torque-at-screw" | "torque-at-motor" | "force-at-table"'),
        missing("output", points),
        missing("standard_deviation", "of real and imaginary part, in the unit of the response; or relative = 0.01"),
    )
    what = "lines of a frequency response: a set of them, for preload identify and preload explain"
    yield MapTable("frf", about, above=what)
    yield from [_response_table(channels)] if channels.responses else _columns_of_response(parts)
    preload = number("preload_n", "300", "only where it was set on purpose", Mark.OPTIONAL)
    yield MapTable("window", (_POSITION, preload))


def _response_table(channels: Channels) -> MapTable:
    response, *others = channels.responses
    names = ", ".join(printed(other.name) for other in others[:4])
    channel = MapEntry("channel", response.name, f"a frequency response{names and f'; also {names}'}")
    ratio = f"{plain(response.response_unit or 'nothing')} per {plain(response.reference_unit or 'nothing')}"
    above, below = canonical_unit(response.response_unit), canonical_unit(response.reference_unit)
    if above is None or below is None:
        unit = missing("unit", f"unit of the response, such as m/(N.s2); the file says {ratio}")
    else:
        unit = MapEntry("unit", f"{above}/{below}", f"as the file says: {ratio}")
    return MapTable("frf.response", (channel, unit))


def _columns_of_response(parts: Sequence[Part]) -> Iterator[MapTable]:
    lines = next(part for part in parts if part.kind is Quantity.FREQUENCY)
    rest = [part for part in parts if part is not lines]
    unit = MapEntry("unit", lines.unit or "Hz", "unit of the lines: Hz | kHz | rad/s")
    frequency = MapEntry("channel", lines.channel.name, "frequency-like"), unit
    yield MapTable("frf.frequency", frequency)
    names = [part.channel.name.lower() for part in rest]
    by_phase = any(name.startswith((*MAGNITUDE, *PHASE)) for name in names)
    roles = (("magnitude", MAGNITUDE), ("phase", PHASE)) if by_phase else (("real", REAL), ("imaginary", IMAGINARY))
    for role, beginnings in roles:
        named = next((part for part in rest if part.channel.name.lower().startswith(beginnings)), None)
        part = named or (rest[0] if rest else None)
        if part is None:
            channel = missing("channel", f"the column of the {role}")
        else:
            rest.remove(part)
            channel = MapEntry("channel", part.channel.name, "by its name, or its place in the file")
        yield MapTable(f"frf.{role}", (channel, _unit_of_line(role, None if part is None else part.unit)))


def _unit_of_line(role: str, stated: str | None) -> MapEntry:
    if role == "phase" and stated in ("deg", "rad"):
        return MapEntry("unit", stated, "as the name of the channel says")
    if role == "phase":
        return missing("unit", '"deg" | "rad"')
    if stated == "dB":
        return missing("unit", 'what 0 dB is, such as "dB re 1 m/(N.s2)"')
    return missing("unit", "unit of the response, such as m/(N.s2) or m/N")
