"""Read text exports of TwinCAT Scope: a block of rows about the export, one about the channels, and the samples.

Each channel, or each group of channels of one sampling time, has a column of times in front of it: these columns are
headed by the names of the rows ("Name", "SymbolName", "Unit", …), the others by what the rows say of a channel.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.channel_time import ChannelTime
from monitor_core.recordings.raw.channels import Channel, Channels, require_distinct
from monitor_core.recordings.raw.text.table import (
    Rows,
    Table,
    TableForm,
    read_table,
    require_columns,
    shown,
    shown_list,
)

_SEPARATORS = ("\t", ";", ",", ":")
_MOST_HEADER_ROWS = 200
#: Zero of time stamps in full, and their unit.
_EPOCH = datetime(1601, 1, 1, tzinfo=UTC)
_TICKS_PER_MICROSECOND = 10
#: Time stamps in full have so many digits since 1632, and until 4769.
_DIGITS_IN_FULL = (17, 18)
_START_KEYS = ("Starttime of export", "StartRecord")
_CHANNEL_KEYS = frozenset(("SymbolName", "Data-Type", "SampleTime[ms]", "SymbolComment", "Unit", "NetID", "NetId"))


@dataclass(frozen=True, slots=True)
class _Header:
    separator: str
    names: tuple[str, ...]
    clocks: dict[int, int]  # column of a channel → column of its times
    units: dict[int, str]
    started_at: datetime | None
    start_ticks: int | None


def is_twincat(head: bytes) -> bool:
    """Tell an export of TwinCAT Scope by its first two rows."""
    lines = head.removeprefix(b"\xef\xbb\xbf").splitlines()
    return len(lines) > 1 and any(
        lines[0].startswith(b"Name" + sign) and lines[1].startswith(b"File" + sign)
        for sign in (separator.encode() for separator in (*_SEPARATORS, " "))
    )


def read_channels(path: Path) -> Channels:
    """Read the channels of an export of TwinCAT Scope, with their units, clocks and start.

    Times are in milliseconds since the start of the export; time stamps in full (option "Full Timestamp") become
    milliseconds since then, exactly. Values are taken as they were exported, scaled or not. Rows in which a channel
    has neither time nor value hold no sample of it. ``RecordingFormatError`` if the file is damaged, or was exported
    without times.
    """
    rows = Rows(path)
    header = _header(rows)
    line = next(iter(rows.ahead(1)), "")
    times = sorted(set(header.clocks.values()))
    cells = line.split(header.separator)
    in_full = all(_is_stamp(cells[i]) for i in times if i < len(cells)) and bool(times) and bool(cells[0].strip())
    form = TableForm(
        header.names, header.separator, "." if header.separator == "," else "",
        texts=frozenset(times) if in_full else frozenset(), blanks=True, trailing=True, comment="EOF",
    )  # fmt: skip
    table = read_table(rows.blocks(), form, f"{path.name}, row")
    if table.n_rows == 0:
        raise RecordingFormatError(
            f"{path.name}, row {rows.row}: expected samples below the header; the file ends there"
        )
    return Channels(path.name, tuple(_channels(path.name, header, table, in_full=in_full)))


def _is_stamp(cell: str) -> bool:
    text = cell.strip()
    return text.isascii() and text.isdigit() and len(text) in _DIGITS_IN_FULL


def _header(rows: Rows) -> _Header:
    line_of_name = rows.ahead(1)[0]
    separator = next((sign for sign in _SEPARATORS if line_of_name.startswith(f"Name{sign}")), None)
    if separator is None:
        raise RecordingFormatError(
            f"{rows.file_name}: expected an export of TwinCAT Scope with tabs or semicolons; blanks also stand "
            "in names: export it with another separator"
        )
    about, of_channels = dict[str, str](), dict[str, list[str]]()
    for _ in range(_MOST_HEADER_ROWS):
        line = rows.take()
        if line is None:
            break
        require_columns(line, separator, f"{rows.file_name}, row {rows.row - 1}")
        cells = [cell.strip() for cell in line.split(separator)]
        if not any(cells):
            if of_channels.keys() & _CHANNEL_KEYS:
                return _checked(rows, separator, about, of_channels)
        elif cells[0] in ("Name", *_CHANNEL_KEYS) and ("File" in about or "Name" in about) and len(about) > 1:
            of_channels[cells[0]] = cells
        elif of_channels:
            if cells[0].replace(",", ".").replace(".", "").isdigit():
                raise RecordingFormatError(
                    f"{rows.file_name}, row {rows.row - 1}: expected a blank row above the samples; got none"
                )
            of_channels[cells[0]] = cells
        else:
            about[cells[0]] = cells[1] if len(cells) > 1 else ""
    raise RecordingFormatError(
        f"{rows.file_name}: expected rows about the channels (Name, SymbolName, …) and a blank one below them; "
        f"got none within {rows.row - 1} rows: export it with its header"
    )


def _checked(rows: Rows, separator: str, about: dict[str, str], of_channels: dict[str, list[str]]) -> _Header:
    where = rows.file_name
    labels = of_channels.setdefault("Name", [])
    while labels and not labels[-1]:
        labels = labels[:-1]
    clocks: dict[int, int] = {}
    clock = None
    # rows with a decimal comma among commas have more cells
    others = [cells for key, cells in of_channels.items() if key != "Name" and len(cells) == len(of_channels["Name"])]
    for i, label in enumerate(labels):
        # a channel may be called "Name" too: its other rows do not repeat their own names
        if label == "Name" and all(cells[i] == cells[0] for cells in others):
            clock = i
        elif clock is None or not label:
            raise RecordingFormatError(f"{where}, Name: expected a column of times and names; got {shown_list(labels)}")
        else:
            clocks[i] = clock
    if not clocks:
        raise RecordingFormatError(f"{where}, Name: expected the names of channels; got {shown_list(labels)}")
    numbers = {column: number for number, column in enumerate(sorted(set(clocks.values())), start=1)}
    names = [f"Time {numbers.get(i, 0)}" if i not in clocks else label for i, label in enumerate(labels)]
    require_distinct(names, f"{where}, Name", "channels")
    if set(range(len(names))) - clocks.keys() - numbers.keys():
        raise RecordingFormatError(
            f"{where}, Name: expected channels behind each column of times; got {shown_list(labels)}"
        )
    cells = of_channels.get("Unit", [])
    units = {i: cells[i].partition(" (")[0] for i in clocks if len(cells) > i and not cells[i].startswith("(")}
    ticks = next((about[key] for key in _START_KEYS if key in about), None)
    start = None
    if ticks is not None:
        if not _is_stamp(ticks):
            raise RecordingFormatError(f"{where}, {_START_KEYS[0]}: expected a time stamp; got {ticks[:40]!r}")
        start = _EPOCH + timedelta(microseconds=int(ticks) // _TICKS_PER_MICROSECOND)
    return _Header(separator, tuple(names), clocks, {i: unit for i, unit in units.items() if unit}, start,
                   None if ticks is None else int(ticks))  # fmt: skip


def _channels(file_name: str, header: _Header, table: Table, *, in_full: bool) -> Iterator[Channel]:
    columns = sorted(header.clocks)
    clocks: dict[int, Channel] = {}
    held: dict[int, np.ndarray | None] = {}
    for i in columns:
        clock, name = header.clocks[i], header.names[i]
        if clock not in clocks:
            clocks[clock], held[clock] = _clock(file_name, header, table, clock, in_full=in_full)
            yield clocks[clock]
        blank, taken = table.blank.get(i), held[clock]
        if (taken is None) != (blank is None) or (taken is not None and blank is not None and (taken == blank).any()):
            raise RecordingFormatError(
                f"{file_name}, {shown(name)}: expected a value for each of its times; got rows with one of them alone"
            )
        samples = table.numbers[i]
        yield Channel(name, samples if taken is None else samples[taken], header.units.get(i),
                      time=ChannelTime(header.started_at, clock=header.names[clock]))  # fmt: skip


def _clock(
    file_name: str, header: _Header, table: Table, column: int, *, in_full: bool
) -> tuple[Channel, np.ndarray | None]:
    """Return a column of times, and in which rows it holds one; None: in all."""
    name = header.names[column]
    if in_full:
        milliseconds, taken = _since_start(f"{file_name}, {shown(name)}", table.texts[column], header)
    else:
        blank = table.blank.get(column)
        taken = None if blank is None else ~blank
        milliseconds = table.numbers[column] if taken is None else table.numbers[column][taken]
    if not milliseconds.size:
        raise RecordingFormatError(f"{file_name}, {shown(name)}: expected times; the column is blank")
    return Channel(name, milliseconds, "ms", ChannelTime(header.started_at)), taken


def _since_start(where: str, texts: Sequence[str], header: _Header) -> tuple[np.ndarray, np.ndarray | None]:
    """Return milliseconds of time stamps in full since the start; a double cannot hold these to the tick."""
    stamps = [text for text in texts if text]
    for text in stamps:
        if not _is_stamp(text):
            raise RecordingFormatError(f"{where}: expected a time stamp of 100 ns since 1601; got {text[:40]!r}")
    if header.start_ticks is None or not stamps:
        raise RecordingFormatError(f"{where}: expected times and the start of the export; got {len(stamps)} times")
    ticks = np.array([int(text) for text in stamps], dtype=np.int64) - header.start_ticks
    taken = None if len(stamps) == len(texts) else np.array([bool(text) for text in texts])
    return ticks / 10000.0, taken
