"""Read traces of drives whose every signal has a column of times in front of it, as those of SINUMERIK and SINAMICS.

The columns come in pairs, time and value; the columns of times have one name, or are numbered. Signals that were
sampled more slowly have fewer rows: their cells are blank. Separators, decimal sign and the rows of names and units
differ between programs and countries: where they are not plain, a layout says them.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import canonical_unit
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.rows import shown, shown_list
from monitor_core.recordings.raw.text.table import Table

_TIME_WORDS = frozenset(("time", "zeit", "timestamp", "zeitstempel", "temps", "tempo"))
_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)")
_WORD = re.compile(r"[^\W\d_]+")


def read_channels(path: Path, layout: TextLayout | None = None) -> Channels:
    """Read a trace; each channel names its clock, the channel of its sampling times.

    ``RecordingFormatError`` if the columns are no pairs of time and value, or as for other text columns.
    """
    from monitor_core.recordings.raw.text.csv_samples import read_channels as read_columns  # noqa: PLC0415  # it calls this one

    channels = read_columns(path, layout)
    if not any(channel.clock for channel in channels.channels):
        raise RecordingFormatError(
            f"{path.name}: expected pairs of columns, time and value; got {shown_list(channels.names)}"
        )
    return channels


def time_columns(names: Sequence[str]) -> dict[int, int] | None:
    """Return the column of times of each column of values, if columns come in pairs of time and value; else None."""
    if len(names) < 4 or len(names) % 2:
        return None
    of_times = [_is_time(name) for name in names]
    if not all(of_times[0::2]) or any(of_times[1::2]):
        return None
    return {column: column - 1 for column in range(1, len(names), 2)}


def units_in_names(names: Sequence[str]) -> dict[int, str]:
    """Return the units in brackets behind names, such as "Time [ms]", where they are known here."""
    found = {i: _unit_in_name(name) for i, name in enumerate(names)}
    return {i: unit for i, unit in found.items() if unit is not None}


def has_equal_names(names: Sequence[str]) -> bool:
    """Tell whether the columns of times share a name, as no other file of columns has them."""
    return len(set(names[0::2])) < len(names[0::2])


def distinct_names(names: Sequence[str]) -> list[str]:
    """Return the names, with numbers where columns of times share one: "Time 1", "Time 2", …."""
    if not has_equal_names(names):
        return list(names)
    numbered = [_BRACKETS.sub("", name).strip() or name for name in names]
    return [f"{numbered[i]} {i // 2 + 1}" if i % 2 == 0 else name for i, name in enumerate(names)]


def channels_of(
    file_name: str, names: Sequence[str], table: Table, pairs: Mapping[int, int], units: Mapping[int, str]
) -> Channels:
    """Return the channels of a table with their clocks; rows in which time and value are blank hold no sample.

    ``RecordingFormatError`` if a value has no time, or a time no value.
    """
    channels = []
    for i, samples in table.numbers.items():
        blank, clock = table.blank.get(i), pairs.get(i)
        if clock is not None:
            of_clock = table.blank.get(clock)
            if (blank is None) != (of_clock is None) or (
                blank is not None and of_clock is not None and (blank != of_clock).any()
            ):
                raise RecordingFormatError(
                    f"{file_name}, {shown(names[i])}: expected a time for each value; got rows with one of them alone"
                )
        held = samples if blank is None else samples[~blank]
        if not held.size:
            raise RecordingFormatError(f"{file_name}, {shown(names[i])}: expected numbers; the column is blank")
        channels.append(Channel(names[i], held, units.get(i), clock=None if clock is None else names[clock]))
    return Channels(file_name, tuple(channels))


def is_bracketed(cell: str) -> bool:
    """Tell whether a cell stands in brackets, as units do."""
    return len(cell) > 2 and _BRACKETS.fullmatch(cell) is not None


def _is_time(name: str) -> bool:
    words = _WORD.findall(_BRACKETS.sub(" ", name))
    return bool(words) and any(word == "t" or word.lower() in _TIME_WORDS for word in (words[0], words[-1]))


def _unit_in_name(name: str) -> str | None:
    found = _BRACKETS.search(name)
    unit = (found.group(1) or found.group(2) or "").strip() if found else ""
    return unit if canonical_unit(unit) is not None else None
