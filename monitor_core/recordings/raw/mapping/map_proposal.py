"""Propose a channel map for a raw file: a text to fill in, in which every entry says what it is.

What names, units and shapes suggest stands in the text with ``# confirm:``. What the file does not say stands as a
comment, ``# position_mm =  # fill in …``, so that the map is refused, with the missing entry named, until it is filled
in. Nothing that a file leaves open is given a value by itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import FACTOR_TO_SI, RAW_UNITS, Quantity, canonical_unit
from monitor_core.recordings.raw.channel_kind import (
    MOST_STEPS,
    ChannelKind,
    is_planned,
    kind_of,
    names_other_unit,
    unit_in_name,
    units_of,
)
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.inspection import read_as_proposed, step_of
from monitor_core.recordings.raw.mapping.clocks import clock_of_times, printed_digit
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.text_times import TextTimes, columns_of_texts, text_times
from monitor_core.recordings.raw.text.times import times_of
from monitor_core.recordings.recognition import KINDS, require_format

CONFIRM, FILL_IN = "# confirm:", "# fill in"
#: Arrays with so few rows or columns hold a channel in each of them, not a window.
_MOST_CHANNELS_IN_ARRAY = 16
_MOST_LISTED = 40
#: Usual sensitivities: how their unit is written, by what is measured and the raw unit.
_SENSITIVITY_UNITS = {
    Quantity.TORQUE: {"A": "N.m/A", "mA": "N.m/A", "V": "V/N.m", "mV": "mV/N.m"},
    Quantity.FORCE: {"A": "N/A", "mA": "N/A", "V": "mV/N", "mV": "mV/N"},
    Quantity.ACCELERATION: {"V": "mV/g", "mV": "mV/g"},
    Quantity.POSITION: {"V": "V/mm", "mV": "mV/mm"},
}
_PLAUSIBLE_STEPS = (("s", 0.05), ("ms", 50.0), ("us", 5e4))  # longest step of a recording that is to show a mode
_WORDS_OF_SENSOR = ("sensor", "cell", "hammer", "transduc", "screw", "shaft", "load")


#: Records of fewer seconds are left whole.
_FEWEST_WINDOWS = 8
_GAP = 4.5  # steps: a longer one is a gap


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A channel, or a row or column of an array, that may be given a meaning."""

    channel: Channel
    samples: SampleArray
    kind: ChannelKind | None
    entry: str | None = None  # "row" or "column", where it is one of an array
    number: int = 0  # counted from 1

    @property
    def unit(self) -> str | None:
        """The unit in our spelling, from the file or from the name; None if neither says a known one."""
        return canonical_unit(self.channel.unit) or unit_in_name(self.channel.name)


def map_text(path: Path) -> str:
    """Read a raw file and return a channel map for it, to fill in.

    ``RecordingFormatError`` if the file is no raw file, or cannot be read.
    """
    read = read_as_proposed(path, require_format(path, *_TAKEN))
    return proposed_map(read.channels, read.layout)


class Made(StrEnum):
    """What a raw file seems to hold, by the ending of the file that an import makes of it."""

    SESSION = ".session.h5"
    FRF_SET = ".frf.h5"
    MOTION = ".motion.csv"


def made_of(channels: Channels) -> Made:
    """Return what channels seem to be: lines of a frequency response, a motion without acceleration, or a session."""
    return _made_of(channels, _parts(channels))


def proposed_map(channels: Channels, layout: TextLayout | None = None) -> str:
    """Return a channel map for channels that were read; ``layout`` is how a text is written, where not plain."""
    parts, texts = _parts(channels), text_times(columns_of_texts(channels))
    match _made_of(channels, parts):
        case Made.FRF_SET:
            body = _frf_lines(channels, parts)
        case Made.MOTION:
            body = _motion_lines(parts, texts)
        case Made.SESSION:
            body = _session_lines(parts, texts, channels)
    lines = [*_head(channels, parts), *_text_lines(layout), *body]
    return "\n".join(lines) + "\n"


_TAKEN = tuple(name for name, kind in KINDS.items() if kind.ending is not None)


def printed(text: str) -> str:
    """Return a text as TOML writes it, with everything escaped that would move a cursor or hide letters."""
    escaped = "".join(f"\\{letter}" if letter in '"\\' else _escaped(letter) for letter in text)
    return f'"{escaped}"'


def _escaped(letter: str) -> str:
    if letter.isprintable():
        return letter
    code = ord(letter)
    return f"\\u{code:04X}" if code < 0x10000 else f"\\U{code:08X}"


def _made_of(channels: Channels, parts: Sequence[Part]) -> Made:
    kinds = {part.kind for part in parts}
    if channels.responses or ChannelKind.FREQUENCY in kinds:
        return Made.FRF_SET
    return Made.MOTION if _is_motion(kinds) else Made.SESSION


def _is_motion(kinds: set[ChannelKind | None]) -> bool:
    drive = ChannelKind.FORCE in kinds or ChannelKind.TORQUE in kinds
    return drive and ChannelKind.POSITION in kinds and ChannelKind.ACCELERATION not in kinds and None not in kinds


# ---- what is in the file ------------------------------------------------------------------------------------------


def _parts(channels: Channels) -> list[Part]:
    """Return what may be given a meaning: channels, and the rows or columns of a single array of few of them."""
    found = []
    arrays = [channel for channel in channels.channels if channel.samples.ndim == 2]
    for channel in channels.channels:
        samples = channel.samples
        if samples.ndim == 2 and len(arrays) == 1 and 1 < min(samples.shape) <= _MOST_CHANNELS_IN_ARRAY:
            in_rows = samples.shape[0] < samples.shape[1]
            for number, values in enumerate(samples if in_rows else samples.T, start=1):
                kind = kind_of(str(number), None, values)
                found.append(Part(channel, values, kind, "row" if in_rows else "column", number))
        else:
            found.append(Part(channel, samples, kind_of(channel.name, channel.unit, samples)))
    return found


def _head(channels: Channels, parts: Sequence[Part]) -> Iterator[str]:
    yield f"# What the channels of {_plain(channels.file_name)} mean, proposed by `preload check`."
    yield f'# Lines marked "{FILL_IN[2:]}": the file does not say it; take the # in front away and write the value.'
    yield f'# Lines marked "{CONFIRM[2:-1]}": read from names, units and shapes; look whether they are right.'
    yield "#"
    yield "# In the file:"
    for part in parts[:_MOST_LISTED]:
        yield f"#   {_described(part)}"
    if len(parts) > _MOST_LISTED:
        yield f"#   … and {len(parts) - _MOST_LISTED} more"
    for response in channels.responses[:_MOST_LISTED]:
        yield f"#   {_plain(response.name)}: frequency response, {response.frequency.size} lines"
    yield ""
    stem = channels.file_name.partition(".")[0] or "axis"
    yield _entry("axis_id", printed(stem), f"{CONFIRM} name of the axis; this is the name of the file")


def _described(part: Part) -> str:
    channel = part.channel
    facts = [f"shape {'x'.join(map(str, part.samples.shape))}"]
    facts.append(_plain(channel.unit) if channel.unit else "no unit")
    if channel.sample_rate is not None:
        facts.append(f"{channel.sample_rate:g} Hz")
    if channel.started_at is not None:
        facts.append(f"from {channel.started_at.isoformat()}")
    if channel.clock is not None:
        facts.append(f"times in {_plain(channel.clock)}")
    facts.append("first " + ", ".join(f"{value:g}" for value in part.samples.reshape(-1)[:3]))
    looks = f" ({part.kind}-like)" if part.kind is not None else ""
    place = f", {part.entry} {part.number}" if part.entry else ""
    return f"{_plain(channel.name)}{place}: {', '.join(facts)}{looks}"


def _plain(text: str) -> str:
    """Return a text for a comment, which ends with its line."""
    return "".join(_escaped(letter) for letter in text)


# ---- the entries --------------------------------------------------------------------------------------------------


def _entry(name: str, value: str, remark: str) -> str:
    return f"{f'{name} = {value}':<38} {remark if remark.startswith('#') else f'# {remark}'}"


def _blank(name: str, remark: str) -> str:
    """Return the place of an entry that the file does not say: a comment, so that its absence is refused by name."""
    return f"{f'# {name} =':<38} {FILL_IN}: {remark}"


def _text_lines(layout: TextLayout | None) -> Iterator[str]:
    if layout is None:
        return
    yield ""
    yield "[text]"
    remarks = {
        "separator": "between columns: tab | semicolon | comma | blank",
        "decimal": "point | comma",
        "header_row": "row of the names, counted from 1; 0 where there is no such row",
        "unit_row": "row of the units",
        "first_row": "first row of numbers",
        "comment": "lines that begin so are left out",
        "encoding": "utf-8 | latin-1 | utf-16",
        "sheet": "of the workbook",
    }
    for name, value in layout.entries().items():
        written = printed(value) if isinstance(value, str) else str(value)
        yield _entry(name, written, f"{CONFIRM} {remarks.get(name, 'how the text is written')}")


def _session_lines(parts: Sequence[Part], texts: TextTimes | None, channels: Channels) -> Iterator[str]:
    excitation, response = _signals(parts)
    shapes = {part.samples.shape for part in (excitation, response) if part is not None}
    alike = [part for part in parts if part.samples.shape in shapes or not shapes]
    position = _first(alike, (ChannelKind.POSITION,), (excitation, response))
    lengths = {max(shape) for shape in shapes}
    fitting = [part for part in parts if part.samples.size in lengths or not lengths]
    times: Part | TextTimes | None = _first(fitting, (ChannelKind.TIME,), (excitation, response, position)) or texts
    yield ""
    yield "[excitation]"
    yield from _excitation_lines(excitation, parts)
    yield ""
    yield "[response]                             # the acceleration of nut or table"
    yield from _channel_lines(response, Quantity.ACCELERATION, parts)
    if position is not None:
        yield ""
        yield "[position]                             # measured travel; without it, position_mm in [window]"
        yield from _channel_lines(position, Quantity.POSITION, parts)
    signals = [part for part in (excitation, response, position) if part is not None]
    yield from _time_lines(times, signals)
    rate = _rate_of_texts(times, channels) if isinstance(times, TextTimes) else None
    yield from _window_lines(signals, times, rate, has_position=position is not None)


def _signals(parts: Sequence[Part]) -> tuple[Part | None, Part | None]:
    """Return what may be excitation and response: by what they look like, else in the order of the file."""
    excitation = _first(parts, (ChannelKind.TORQUE, ChannelKind.FORCE))
    response = _first(parts, (ChannelKind.ACCELERATION,))
    longest = max((part.samples.size for part in parts), default=0)
    left = [part for part in parts if part.kind is None and part.samples.size == longest]
    if excitation is None and left:
        excitation = left.pop(0)
    if response is None and left:
        response = left.pop(0)
    return excitation, response


def _first(parts: Sequence[Part], kinds: Sequence[ChannelKind], taken: Sequence[Part | None] = ()) -> Part | None:
    """Return the first channel that looks so, one that was measured before one that was planned."""
    fitting = [part for kind in kinds for part in parts if part.kind is kind and part not in taken]
    return min(fitting, key=lambda part: is_planned(part.channel.name), default=None)


def _excitation_lines(part: Part | None, parts: Sequence[Part]) -> Iterator[str]:
    quantity = _quantity(part)
    channel_lines = list(_channel_lines(part, quantity, parts))
    place = next(i for i, line in enumerate(channel_lines) if "channel =" in line) + 1
    while place < len(channel_lines) and channel_lines[place].startswith(("row", "column")):
        place += 1
    yield from channel_lines[:place]
    if quantity is None:
        yield _blank("quantity", '"torque" or "force"')
    else:
        yield _entry("quantity", printed(str(quantity)), f"{CONFIRM} torque | force")
    name = "" if part is None else part.channel.name.lower()
    by_sensor = quantity is not Quantity.TORQUE or any(word in name for word in _WORDS_OF_SENSOR)
    source = "sensor" if by_sensor else "drive"
    yield _entry("source", printed(source), f"{CONFIRM} sensor: measured; drive: from the motor's current")
    yield from channel_lines[place:]


def _quantity(part: Part | None) -> Quantity | None:
    """Return torque or force as the unit says, else as the name says; None where neither does."""
    if part is None:
        return None
    for quantity in (Quantity.TORQUE, Quantity.FORCE):
        if part.unit in FACTOR_TO_SI[quantity]:
            return quantity
    return Quantity(str(part.kind)) if part.kind in (ChannelKind.TORQUE, ChannelKind.FORCE) else None


def _channel_lines(part: Part | None, quantity: Quantity | None, parts: Sequence[Part]) -> Iterator[str]:
    """Return the entries of a channel: its name, its unit, and how a raw unit becomes the quantity."""
    kind = None if quantity is None else ChannelKind(str(quantity))
    if part is None:
        yield _blank("channel", f"one of {', '.join(printed(other.channel.name) for other in parts[:6])}")
        yield _blank("unit", _choice(kind))
        return
    others = [other for other in parts if other.kind is part.kind and other is not part and part.kind is not None]
    also = f"; also {', '.join(printed(other.channel.name) for other in others[:4])}" if others else ""
    looks = f"{part.kind}-like" if part.kind is not None else "by its place in the file, no name or unit says it"
    yield _entry("channel", printed(part.channel.name), f"{CONFIRM} {looks}{also}")
    if part.entry is not None:
        yield _entry(part.entry, str(part.number), f"{CONFIRM} {part.entry} of the array, counted from 1")
    unit = part.unit if kind is None or part.unit in units_of(kind) else None
    if unit is None:
        got = f" (the file says {_plain(part.channel.unit)})" if part.channel.unit else ""
        yield _blank("unit", f"{_choice(kind)}{got}")
        return
    in_file = canonical_unit(part.channel.unit) is not None
    yield _entry("unit", printed(unit), "as the file says" if in_file else f"{CONFIRM} as the name of the channel says")
    if unit in RAW_UNITS:
        usual = None if quantity is None else _SENSITIVITY_UNITS[quantity].get(unit)
        yield _blank("sensitivity", "how much of it is one unit of the quantity, or the other way round")
        if usual is None:
            yield _blank("sensitivity_unit", f'such as "{unit}/N" or "N/{unit}"')
        else:
            yield _entry("sensitivity_unit", printed(usual), f"{CONFIRM} unit of the sensitivity")


def _choice(kind: ChannelKind | None) -> str:
    if kind is None:
        return "what its numbers are in, such as N.m, N, V or A"
    return " | ".join(printed(unit) for unit in units_of(kind))


def _time_lines(times: Part | TextTimes | None, signals: Sequence[Part]) -> Iterator[str]:
    clocks = {part.channel.clock for part in signals}
    stated = any(part.channel.sample_rate is not None for part in signals)
    if clocks - {None}:
        if len(clocks) > 1:
            yield from ("", "[resample]                             # the channels have clocks of their own")
            yield _blank("sample_rate_hz", "rate that all channels are brought to")
            yield _entry("method", printed("cubic"), f"{CONFIRM} cubic | linear; the error is estimated and said")
        return
    if stated or times is None:
        return
    yield ""
    yield "[time]                                 # channel of the sampling times"
    if isinstance(times, TextTimes):
        yield from _text_time_lines(times)
        return
    unit, remark = _unit_of_times(times)
    yield _entry("channel", printed(times.channel.name), f"{CONFIRM} rises evenly, or is named so")
    if times.entry is not None:
        yield _entry(times.entry, str(times.number), f"{CONFIRM} {times.entry} of the array, counted from 1")
    if unit is None:
        yield _blank("unit", _choice(ChannelKind.TIME))
    else:
        yield _entry("unit", printed(unit), remark)


def _text_time_lines(times: TextTimes) -> Iterator[str]:
    yield _entry(
        "channel", printed(times.channel), f"{CONFIRM} texts of {'a date and time' if times.is_dated else 'a time'}"
    )
    if times.date is not None:
        yield _entry("date", printed(times.date), f"{CONFIRM} the dates that belong to them")
    if times.form is None:
        yield _blank("format", '"iso", or a pattern such as "%d/%m/%Y %H:%M:%S": is the day or the month in front?')
    else:
        yield _entry("format", printed(times.form), f"{CONFIRM} iso, or a pattern of day, month, hour …")
    if times.is_dated and not times.has_zone:
        yield _blank("zone", 'zone of these times, such as "+01:00" or "Z"')


def _counts(times: Part) -> bool:
    """Tell whether values are 0, 1, 2, …: the number of a sample, of which the rate is not known."""
    first = times.samples[:1000]
    return first.size > 1 and bool((np.diff(first) == 1.0).all()) and float(first[0]) in (0.0, 1.0)


def _unit_of_times(times: Part) -> tuple[str | None, str]:
    """Return the unit of sampling times: as stated, else the first in which the rate is one of recordings."""
    factors, step = FACTOR_TO_SI[Quantity.TIME], step_of(times.samples)
    unit = times.unit if times.unit in factors else None
    if unit is not None and canonical_unit(times.channel.unit) is not None:
        return unit, "as the file says"
    if unit is None and (names_other_unit(times.channel.name) or _counts(times)):
        return None, ""
    if unit is None and step is not None:
        unit = next((name for name, longest in _PLAUSIBLE_STEPS if step <= longest), None)
    if unit is None or step is None:
        return unit, f"{CONFIRM} as the name of the channel says"
    return unit, f"{CONFIRM} steps of {step:g} {unit} are {1.0 / (step * factors[unit]):g} Hz"


def _rate_of_texts(times: TextTimes, channels: Channels) -> float | None:
    """Return the rate of texts of a date and time [Hz]; None where they say none."""
    if times.form is None:
        return None
    texts = channels.text(times.channel)[:MOST_STEPS]
    dates = None if times.date is None else channels.text(times.date)[:MOST_STEPS]
    try:
        seconds, _ = times_of(texts, times.form, None if times.has_zone else "Z", dates, channels.file_name)
    except RecordingFormatError:
        return None
    return _mean_rate(seconds, printed_digit(seconds))


def _mean_rate(seconds: FloatArray, printed: float) -> float | None:
    """Return the rate of sampling times, the plainest that they do not contradict [Hz]; None if they do not rise."""
    try:
        clock, _ = clock_of_times(seconds, printed, "")
    except RecordingFormatError:
        return None
    if clock.sample_rate is not None:
        return clock.sample_rate
    steps = np.diff(seconds)
    mean = float(seconds[-1] - seconds[0]) / steps.size
    if steps.min() < 0.0 or steps.max() > _GAP * mean:
        mean = step_of(seconds) or mean
    return 1.0 / mean


def _window_lines(
    signals: Sequence[Part], times: Part | TextTimes | None, rate_of_texts: float | None, *, has_position: bool
) -> Iterator[str]:
    arrays = [part.samples for part in signals if part.samples.ndim == 2]
    rates = [part.channel.sample_rate for part in signals if part.channel.sample_rate is not None]
    timed = [*signals, *([times] if isinstance(times, Part) else [])]
    starts = [part.channel.started_at for part in timed if part.channel.started_at is not None]
    clocks = any(part.channel.clock is not None for part in signals)
    yield ""
    yield "[window]"
    if rates:
        yield f"# sample_rate_hz is left out: the file says {rates[0]:g} Hz"
    elif times is None and not clocks:
        yield _blank("sample_rate_hz", "samples of a channel in a second; the file does not say it")
    if starts:
        yield f"# started_at is left out: the file says {starts[0].isoformat()}"
    elif isinstance(times, TextTimes) and times.is_dated and not rates and not clocks:
        yield "# started_at is left out: [time] says it"
    else:
        yield _blank("started_at", "when the record began, with its zone, such as 2025-03-01T06:00:00Z")
    if not has_position:
        yield _blank("position_mm", "where the table stood, in mm from the fixed bearing")
        yield _entry(
            "position_span_mm", "0.0", f"{CONFIRM} travel of the table during a window; 0 where it stood still"
        )
    if arrays:
        in_rows = arrays[0].shape[0] <= arrays[0].shape[1]
        shape = "x".join(map(str, arrays[0].shape))
        yield _entry("windows_in", printed("rows" if in_rows else "columns"), f"{CONFIRM} the array is {shape}")
        yield _blank("window_interval_s", "from the start of one window to the start of the next")
    else:
        yield _cutting_line(signals, times, rate_of_texts)
    yield '# measurement = "at 250 mm"             # optional: joins several files; else each is a measurement'
    yield "# file_interval_s = 60                 # optional: several files, from the start of one to that of the next"
    yield "# preload_n = 300                      # optional: only where it was set on purpose, as for a calibration"
    yield "# payload_kg = 0.0                     # on the table; left out, an interval holds all that may lie there"
    yield "# temperature_c = 21.5                 # optional, as direction (+ | - | both)"


def _cutting_line(signals: Sequence[Part], times: Part | TextTimes | None, rate_of_texts: float | None) -> str:
    """Propose windows of a second of a record that has several: a measurement is an average over windows."""
    rate = next((part.channel.sample_rate for part in signals if part.channel.sample_rate is not None), None)
    if rate is None and isinstance(times, Part):
        unit, _ = _unit_of_times(times)
        if unit is not None:
            first, factor = times.samples.reshape(-1)[:MOST_STEPS], FACTOR_TO_SI[Quantity.TIME][unit]
            rate = _mean_rate(first.astype(np.float64) * factor, printed_digit(first) * factor)
    rate = rate_of_texts if rate is None else rate
    size = max((part.samples.size for part in signals), default=0)
    if rate is None or not _FEWEST_WINDOWS * rate <= size:
        return "# samples_per_window = 20000           # cuts a long record: a measurement is an average of several"
    said = f"{CONFIRM} windows of a second; a measurement is an average over several"
    return _entry("samples_per_window", str(round(rate)), said)


def _motion_lines(parts: Sequence[Part], texts: TextTimes | None) -> Iterator[str]:
    drive = _first(parts, (ChannelKind.FORCE, ChannelKind.TORQUE))
    position = _first(parts, (ChannelKind.POSITION,), (drive,))
    others = [part for part in parts if part.kind is ChannelKind.POSITION and part is not position]
    times = _first(parts, (ChannelKind.TIME,)) or texts
    signals = [part for part in (drive, position) if part is not None]
    yield ""
    yield "# position and drive without an acceleration: a motion record, for preload explain (family motion)"
    yield "[motion]"
    if times is None and not any(part.channel.sample_rate for part in signals):
        yield _blank("sample_rate_hz", "samples of a channel in a second; the file does not say it")
    yield "[motion.position]"
    yield from _channel_lines(position, Quantity.POSITION, parts)
    quantity = _quantity(drive) or Quantity.FORCE
    yield f"[motion.{quantity}]"
    yield from _channel_lines(drive, quantity, parts)
    if others:
        yield "[motion.reference]                     # the position that was commanded; may be left out"
        yield from _channel_lines(others[0], Quantity.POSITION, parts)
    yield from _time_lines(times, signals)


def _frf_lines(channels: Channels, parts: Sequence[Part]) -> Iterator[str]:
    yield ""
    yield "# lines of a frequency response: a set of them, for preload identify and preload explain"
    yield "[frf]"
    yield _blank("input", '"torque-at-screw" | "torque-at-motor" | "force-at-table"')
    yield _blank(
        "output", '"acceleration-at-table" | "acceleration-at-nut" | "displacement-at-table" | "angle-at-motor"'
    )
    yield _blank("standard_deviation", "of real and imaginary part, in the unit of the response; or relative = 0.01")
    if channels.responses:
        response = channels.responses[0]
        names = ", ".join(printed(other.name) for other in channels.responses[1:5])
        yield "[frf.response]"
        yield _entry("channel", printed(response.name), f"{CONFIRM} a frequency response{names and f'; also {names}'}")
        above, below = canonical_unit(response.response_unit), canonical_unit(response.reference_unit)
        if above is None or below is None:
            yield _blank("unit", f"unit of the response, such as m/(N.s2); the file says {_ratio(channels)}")
        else:
            yield _entry("unit", printed(f"{above}/{below}"), f"{CONFIRM} as the file says: {_ratio(channels)}")
    else:
        yield from _columns_of_response(parts)
    yield ""
    yield "[window]"
    yield _blank("position_mm", "where the table stood, in mm from the fixed bearing")
    yield "# preload_n = 300                      # optional: only where it was set on purpose"


def _ratio(channels: Channels) -> str:
    response = channels.responses[0]
    return f"{_plain(response.response_unit or 'nothing')} per {_plain(response.reference_unit or 'nothing')}"


def _columns_of_response(parts: Sequence[Part]) -> Iterator[str]:
    lines = next(part for part in parts if part.kind is ChannelKind.FREQUENCY)
    rest = [part for part in parts if part is not lines]
    yield "[frf.frequency]"
    yield _entry("channel", printed(lines.channel.name), f"{CONFIRM} frequency-like")
    yield _entry("unit", printed("Hz"), f"{CONFIRM} unit of the lines")
    names = [part.channel.name.lower() for part in rest]
    by_phase = any(name.startswith(("mag", "amp", "abs", "phase", "ang")) for name in names)
    roles = (("magnitude", ("mag", "amp", "abs")), ("phase", ("phase", "ang"))) if by_phase else (
        ("real", ("re",)), ("imaginary", ("im",)),
    )  # fmt: skip
    for role, beginnings in roles:
        named = next((part for part in rest if part.channel.name.lower().startswith(beginnings)), None)
        part = named or (rest[0] if rest else None)
        yield f"[frf.{role}]"
        if part is None:
            yield _blank("channel", f"the column of the {role}")
        else:
            rest.remove(part)
            yield _entry("channel", printed(part.channel.name), f"{CONFIRM} by its name, or its place in the file")
        yield _blank("unit", '"deg" | "rad"' if role == "phase" else "unit of the response, such as m/(N.s2) or m/N")
