"""Propose a channel map for a raw file: a text to fill in, in which every entry says what it is.

What names, units and shapes suggest stands in the text with ``# confirm:``. What the file does not say stands as a
comment, ``# position_mm =  # fill in …``, so that the map is refused, with the missing entry named, until it is filled
in. Nothing that a file leaves open is given a value by itself.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from monitor_core.recordings.elements.units import Quantity
from monitor_core.recordings.raw.channel_kind import ChannelKind
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.inspection import read_as_proposed
from monitor_core.recordings.raw.proposal.entries import (
    CONFIRM,
    FILL_IN,
    blank,
    channel_lines,
    entry,
    plain,
    printed,
)
from monitor_core.recordings.raw.proposal.other_records import frf_lines, motion_lines
from monitor_core.recordings.raw.proposal.parts import (
    Made,
    Part,
    first_like,
    made_of_parts,
    parts_of,
    quantity_of,
    signals_in,
)
from monitor_core.recordings.raw.proposal.sampling import (
    cutting_line,
    rate_line,
    rate_of_numbers,
    rate_of_texts,
    time_lines,
)
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.text_times import TextTimes, columns_of_texts, text_times
from monitor_core.recordings.recognition import KINDS, require_format

_MOST_LISTED = 40
_TAKEN = tuple(name for name, kind in KINDS.items() if kind.ending is not None)
_WORDS_OF_SENSOR = ("sensor", "cell", "hammer", "transduc", "screw", "shaft", "load")


def map_text(path: Path) -> str:
    """Read a raw file and return a channel map for it, to fill in.

    ``RecordingFormatError`` if the file is no raw file, or cannot be read.
    """
    read = read_as_proposed(path, require_format(path, *_TAKEN))
    return proposed_map(read.channels, read.layout)


def proposed_map(channels: Channels, layout: TextLayout | None = None) -> str:
    """Return a channel map for channels that were read; ``layout`` is how a text is written, where not plain."""
    parts, texts = parts_of(channels), text_times(columns_of_texts(channels))
    match made_of_parts(channels, parts):
        case Made.FRF_SET:
            body = frf_lines(channels, parts)
        case Made.MOTION:
            body = motion_lines(parts, texts, channels)
        case Made.SESSION:
            body = _session_lines(parts, texts, channels)
    lines = [*_head(channels, parts), *_text_lines(layout), *body]
    return "\n".join(lines) + "\n"


def _head(channels: Channels, parts: Sequence[Part]) -> Iterator[str]:
    yield f"# What the channels of {plain(channels.file_name)} mean, proposed by `preload check`."
    yield f'# Lines marked "{FILL_IN[2:]}": the file does not say it; take the # in front away and write the value.'
    yield f'# Lines marked "{CONFIRM[2:-1]}": read from names, units and shapes; look whether they are right.'
    yield "#"
    yield "# In the file:"
    for part in parts[:_MOST_LISTED]:
        yield f"#   {_described(part)}"
    if len(parts) > _MOST_LISTED:
        yield f"#   … and {len(parts) - _MOST_LISTED} more"
    for response in channels.responses[:_MOST_LISTED]:
        yield f"#   {plain(response.name)}: frequency response, {response.frequency.size} lines"
    yield ""
    stem = channels.file_name.partition(".")[0] or "axis"
    yield entry("axis_id", printed(stem), f"{CONFIRM} name of the axis; this is the name of the file")


def _described(part: Part) -> str:
    channel = part.channel
    facts = [f"shape {'x'.join(map(str, part.samples.shape))}"]
    facts.append(plain(channel.unit) if channel.unit else "no unit")
    if channel.sample_rate is not None:
        facts.append(f"{channel.sample_rate:g} Hz")
    if channel.started_at is not None:
        facts.append(f"from {channel.started_at.isoformat()}")
    if channel.clock is not None:
        facts.append(f"times in {plain(channel.clock)}")
    facts.append("first " + ", ".join(f"{value:g}" for value in part.samples.reshape(-1)[:3]))
    looks = f" ({part.kind}-like)" if part.kind is not None else ""
    place = f", {part.entry} {part.number}" if part.entry else ""
    return f"{plain(channel.name)}{place}: {', '.join(facts)}{looks}"


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
        yield entry(name, written, f"{CONFIRM} {remarks.get(name, 'how the text is written')}")


def _session_lines(parts: Sequence[Part], texts: TextTimes | None, channels: Channels) -> Iterator[str]:
    excitation, response = signals_in(parts)
    shapes = {part.samples.shape for part in (excitation, response) if part is not None}
    alike = [part for part in parts if part.samples.shape in shapes or not shapes]
    position = first_like(alike, (ChannelKind.POSITION,), (excitation, response))
    lengths = {max(shape) for shape in shapes}
    fitting = [part for part in parts if part.samples.size in lengths or not lengths]
    times: Part | TextTimes | None = first_like(fitting, (ChannelKind.TIME,), (excitation, response, position)) or texts
    yield ""
    yield "[excitation]"
    yield from _excitation_lines(excitation, parts)
    yield ""
    yield "[response]                             # the acceleration of nut or table"
    yield from channel_lines(response, Quantity.ACCELERATION, parts)
    if position is not None:
        yield ""
        yield "[position]                             # measured travel; without it, position_mm in [window]"
        yield from channel_lines(position, Quantity.POSITION, parts)
    signals = [part for part in (excitation, response, position) if part is not None]
    yield from time_lines(times, signals)
    yield from _window_lines(signals, times, channels, has_position=position is not None)


def _excitation_lines(part: Part | None, parts: Sequence[Part]) -> Iterator[str]:
    quantity = quantity_of(part)
    lines = list(channel_lines(part, quantity, parts))
    place = next(i for i, line in enumerate(lines) if "channel =" in line) + 1
    while place < len(lines) and lines[place].startswith(("row", "column")):
        place += 1
    yield from lines[:place]
    if quantity is None:
        yield blank("quantity", '"torque" or "force"')
    else:
        yield entry("quantity", printed(str(quantity)), f"{CONFIRM} torque | force")
    name = "" if part is None else part.channel.name.lower()
    by_sensor = quantity is not Quantity.TORQUE or any(word in name for word in _WORDS_OF_SENSOR)
    source = "sensor" if by_sensor else "drive"
    yield entry("source", printed(source), f"{CONFIRM} sensor: measured; drive: from the motor's current")
    yield from lines[place:]


def _window_lines(
    signals: Sequence[Part], times: Part | TextTimes | None, channels: Channels, *, has_position: bool
) -> Iterator[str]:
    arrays = [part.samples for part in signals if part.samples.ndim == 2]
    rates = [part.channel.sample_rate for part in signals if part.channel.sample_rate is not None]
    timed = [*signals, *([times] if isinstance(times, Part) else [])]
    starts = [part.channel.started_at for part in timed if part.channel.started_at is not None]
    clocks = any(part.channel.clock is not None for part in signals)
    stated = rate_of_numbers(channels) if times is None and not rates and not clocks else None
    yield ""
    yield "[window]"
    if rates:
        yield f"# sample_rate_hz is left out: the file says {rates[0]:g} Hz"
    elif times is None and not clocks:
        yield rate_line(stated)
    if starts:
        yield f"# started_at is left out: the file says {starts[0].isoformat()}"
    elif isinstance(times, TextTimes) and times.is_dated and not rates and not clocks:
        yield "# started_at is left out: [time] says it"
    else:
        yield blank("started_at", "when the record began, with its zone, such as 2025-03-01T06:00:00Z")
    if not has_position:
        yield blank("position_mm", "where the table stood, in mm from the fixed bearing")
        yield entry("position_span_mm", "0.0", f"{CONFIRM} travel of the table during a window; 0 where it stood still")
    if arrays:
        in_rows = arrays[0].shape[0] <= arrays[0].shape[1]
        shape = "x".join(map(str, arrays[0].shape))
        yield entry("windows_in", printed("rows" if in_rows else "columns"), f"{CONFIRM} the array is {shape}")
        yield blank("window_interval_s", "from the start of one window to the start of the next")
    else:
        rate = stated.sample_rate if stated else None
        yield cutting_line(signals, times, rate_of_texts(times, channels) if isinstance(times, TextTimes) else rate)
    yield '# measurement = "at 250 mm"             # optional: joins several files; else each is a measurement'
    yield "# file_interval_s = 60                 # optional: several files, from the start of one to that of the next"
    yield "# preload_n = 300                      # optional: only where it was set on purpose, as for a calibration"
    yield "# payload_kg = 0.0                     # on the table; left out, an interval holds all that may lie there"
    yield "# temperature_c = 21.5                 # optional, as direction (+ | - | both)"
