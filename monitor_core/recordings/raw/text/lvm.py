"""Read LabVIEW measurement files, ``*.lvm``, as their specification (NI, versions 0.92 to 2.0) describes them.

This is a reader of our own: lvm-read takes what it cannot parse for NaN, and by default unpickles a file that lies next
to the recording.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.channel_time import ChannelTime, Run, time_of_step
from monitor_core.recordings.raw.channels import Channel, Channels, require_distinct
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.table import (
    MAX_COLUMNS,
    Rows,
    Table,
    TableForm,
    is_number,
    read_table,
    require_columns,
    require_utf8,
    shown,
    shown_list,
)

_SIGNATURE = b"LabVIEW Measurement"
_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ","}
_MOST_HEADER_ROWS = 1000
_MOST_SEGMENTS = 4096
_DATE_AND_TIME = re.compile(r"(\d{4})[-/.](\d\d?)[-/.](\d\d?) (\d\d?):(\d\d):(\d\d)(\.\d+)?", re.ASCII)
#: Of so many x the mean step is known to a hundredth, although they are printed to few digits.
_FEWEST_STEPS, _SAME_STEP = 200, 0.02


@dataclass(frozen=True, slots=True)
class _FileHeader:
    separator: str
    decimal: str
    columns_of_x: str  # "No" | "One" | "Multi"
    believe_rows: bool

    @property
    def stride(self) -> int:
        """How many columns a channel takes."""
        return 2 if self.columns_of_x == "Multi" else 1


@dataclass(frozen=True, slots=True)
class _Column:
    """A channel as the header of its segment states it."""

    name: str
    number: int  # counted from 0
    clock: int | None  # column of its x; None: x stands in no column
    n_samples: int | None
    unit: str | None
    step: float | None  # [s]; None: x is no time, or no step is stated
    believe_rows: bool  # where the header states more samples
    n_digits: int  # that the step is printed to
    x0: float | None  # first x [s]
    date_and_time: str  # of x = 0, of no zone

    @property
    def begins(self) -> tuple[float | None, str, float | None]:
        """Say when its samples were taken, as its header states it."""
        return self.x0, self.date_and_time, self.step


def is_lvm(head: bytes) -> bool:
    """Tell an LVM file by how it begins."""
    return head.removeprefix(b"\xef\xbb\xbf").startswith(_SIGNATURE)


def read_channels(path: Path, layout: TextLayout | None = None) -> Channels:
    """Read the channels of an LVM file with their units and rates.

    Where x stands in columns ("X_Columns" One or Multi), these are channels too, and the clocks of the others; else the
    rate is that of ``Delta_X`` and the first x is ``X0``, as they are of a channel whose ``X0``, ``Date``, ``Time`` or
    step differ from those of the one column of x. ``Date`` and ``Time`` carry no zone, so it is not known when that
    was, but how far channels and segments are apart. Channels without samples are left out. Several segments of equal
    channels are rows of two-dimensional arrays; where they differ, channels are named "segment/channel". ``layout`` may
    say that rows are believed where a header states more samples than there are. ``RecordingFormatError`` if the file
    is damaged or cut off.
    """
    if layout is not None and layout != TextLayout(believe="rows"):
        raise RecordingFormatError(f'{path.name}: expected only believe = "rows" in [text] of an LVM file')
    rows = Rows(path, _encoding(path))
    header = _file_header(rows, believe_rows=layout is not None)
    segments: list[tuple[tuple[Channel, str], ...]] = []
    while _skip_blank(rows):
        if len(segments) == _MOST_SEGMENTS:
            raise RecordingFormatError(f"{path.name}: expected at most {_MOST_SEGMENTS} segments; got more")
        segments.append(_segment(rows, header))
    if not segments:
        raise RecordingFormatError(f"{path.name}: expected a segment of samples behind the header; the file ends there")
    return Channels(path.name, _joined(segments, path.name))


def _encoding(path: Path) -> str:
    """Return UTF-8 if the file is that, else Latin-1: the program writes in the code page of its machine."""
    try:
        require_utf8(path)
    except RecordingFormatError:
        return "latin-1"
    return "utf-8"


def _file_header(rows: Rows, *, believe_rows: bool) -> _FileHeader:
    where, entries = rows.file_name, dict[str, str]()
    for line in _header_rows(rows):
        key, _, value = line.replace(",", "\t", 1).partition("\t") if "\t" not in line else line.partition("\t")
        entries[key.strip()] = value if value == "," else value.strip("\t ").rstrip(",")
    separator = entries.get("Separator", "Tab")
    if separator.lower() not in _SEPARATORS:
        raise RecordingFormatError(f"{where}, Separator: expected Tab or Comma; got {separator[:40]!r}")
    decimal = entries.get("Decimal_Separator", ".") or ","
    if decimal not in (".", ",") or (decimal, separator.lower()) == (",", "comma"):
        raise RecordingFormatError(
            f"{where}, Decimal_Separator: expected a point, or a comma in columns of tabs; got {decimal[:40]!r}"
        )
    of_x = entries.get("X_Columns", "One").capitalize()
    if of_x not in ("No", "One", "Multi"):
        raise RecordingFormatError(f"{where}, X_Columns: expected No, One or Multi; got {of_x[:40]!r}")
    return _FileHeader(_SEPARATORS[separator.lower()], decimal, of_x, believe_rows)


def _header_rows(rows: Rows) -> Iterator[str]:
    """Take the rows of a header up to its end; special blocks inside are no part of it."""
    special = False
    for _ in range(_MOST_HEADER_ROWS):
        line = rows.take()
        if line is None:
            raise RecordingFormatError(f"{rows.file_name}: expected {_END}; the file ends in row {rows.row - 1}")
        if line.startswith(_END):
            return
        if line.startswith(("***Start_Special***", "***End_Special***")):
            special = line.startswith("***Start")
        elif not special and line.strip():
            yield line
    raise RecordingFormatError(f"{rows.file_name}: expected {_END} within {_MOST_HEADER_ROWS} rows; got none by then")


def _skip_blank(rows: Rows) -> bool:
    while line := rows.ahead(1):
        if line[0].strip("\t ,"):
            return True
        rows.take()
    return False


def _segment(rows: Rows, header: _FileHeader) -> tuple[tuple[Channel, str], ...]:
    where = f"{rows.file_name}, row {rows.row}"
    stated: dict[str, list[str]] = {}
    for line in _header_rows(rows):
        require_columns(line, header.separator, where)
        key, *values = line.split(header.separator)
        stated[key.strip()] = [value.strip() for value in values]
    n_channels = _whole(stated.get("Channels", [""])[0], f"{where}, Channels")
    names = _names(rows, header, n_channels, where)
    columns = [_column(stated, header, names, i, where) for i in range(n_channels)]
    # where x stands in no column, the first cell of each row is blank, and is left out
    n_left_out = int(header.columns_of_x == "No")
    form = TableForm(tuple(names[n_left_out:]), header.separator, header.decimal, blanks=True)
    table = read_table(_table_rows(rows, header, len(names)), form, f"{rows.file_name}, row")
    numbers = {column + n_left_out: values for column, values in table.numbers.items()}
    blank = {column + n_left_out: cells for column, cells in table.blank.items()}
    return tuple(_channels(columns, names, replace(table, numbers=numbers, blank=blank), where))


def _names(rows: Rows, header: _FileHeader, n_channels: int, where: str) -> list[str]:
    """Take the row of labels, and return the names of the columns; those of x have the number of their channel."""
    line = rows.take() or ""
    require_columns(line, header.separator, where)
    labels = [cell.strip() for cell in line.split(header.separator)]
    if labels[0] != "X_Value" or not 0 < n_channels <= MAX_COLUMNS:
        raise RecordingFormatError(
            f"{where}: expected the channels of a segment and a row of their names that begins with 'X_Value'; "
            f"got {n_channels} channels and {labels[0][:40]!r}"
        )
    numbers = [header.stride * i + 1 for i in range(n_channels)]
    names = labels[: numbers[-1] + 1]
    if len(names) <= numbers[-1] or any(not names[number] for number in numbers):
        raise RecordingFormatError(f"{where}: expected the names of {n_channels} channels; got {shown_list(labels)}")
    if header.stride == 2:
        names = [f"X_Value {i // 2 + 1}" if i % 2 == 0 else name for i, name in enumerate(names)]
    require_distinct(names, where, "channels")
    return names


def _column(stated: Mapping[str, list[str]], header: _FileHeader, names: list[str], i: int, where: str) -> _Column:
    number = header.stride * i + 1

    def entry(key: str) -> str:
        return dict(enumerate(stated.get(key, []), start=1)).get(number, "")

    step, has_x = _step(entry("Delta_X"), header.decimal, f"{where}, Delta_X"), header.columns_of_x != "No"
    of_time = entry("X_Dimension").lower() in ("time", "")
    x0 = entry("X0").replace(header.decimal, ".") or ("0" if entry("Time") else "")
    if x0 and (not is_number(x0) or not np.isfinite(float(x0))):
        raise RecordingFormatError(f"{where}, X0: expected a number; got {x0[:40]!r}")
    return _Column(
        names[number],
        number,
        (number - 1 if header.stride == 2 else 0) if has_x else None,
        _whole(entry("Samples"), f"{where}, Samples") if entry("Samples") else None,
        entry("Y_Unit_Label") or None,
        step if of_time else None,
        header.believe_rows,
        len(re.sub(r"[eE].*|\D", "", entry("Delta_X")).lstrip("0")),
        float(x0) if of_time and x0 else None,
        f"{entry('Date')} {entry('Time')}".replace(",", ".").strip(),
    )


def _whole(text: str, where: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise RecordingFormatError(f"{where}: expected a whole number; got {text[:40]!r}")
    return int(text)


def _step(text: str, decimal: str, where: str) -> float | None:
    if not text:
        return None
    plain = text.replace(decimal, ".")
    if not is_number(plain) or not (0.0 < float(plain) < np.inf):
        raise RecordingFormatError(f"{where}: expected a positive step; got {text[:40]!r}")
    return float(plain)


def _table_rows(rows: Rows, header: _FileHeader, n_columns: int) -> Iterator[tuple[int, list[str]]]:
    """Take the rows of a segment without their comments; a blank row ends it, and is left for the next."""
    separator, has_blank = header.separator, header.columns_of_x == "No"
    n_separators = n_columns - 1 - int(has_blank)
    for first_row, lines in rows.blocks(until_blank=True):
        samples = [line.removeprefix(separator) for line in lines] if has_blank else lines
        yield first_row, [_without_comment(line, separator, n_separators) for line in samples]


def _without_comment(line: str, separator: str, n_separators: int) -> str:
    if line.count(separator) <= n_separators:
        return line
    return separator.join(line.split(separator, n_separators + 1)[: n_separators + 1])


def _channels(
    columns: Sequence[_Column], names: Sequence[str], table: Table, where: str
) -> Iterator[tuple[Channel, str]]:
    """Yield the channels, and the date and time that each counts from."""
    clocks: dict[int, Channel] = {}
    for column in columns:
        place = f"{where}, {shown(column.name)}"
        blank, stated = table.blank.get(column.number), column.n_samples
        if stated == 0 and blank is not None and blank.all():
            continue
        samples = _held(table, column.number, f"{place}: expected a number")
        clock = column.clock
        if not samples.size or (stated is not None and samples.size < stated and not column.believe_rows):
            times = None if clock is None else _held(table, clock, f"{where}: expected x")
            raise RecordingFormatError(
                f"{place}: expected {stated or 'some'} samples as its header says; got {samples.size}"
                f"{_why_fewer(column, samples.size, times)}"
            )
        if clock is not None and clock == columns[0].clock and column.begins != columns[0].begins:
            if column.step is None:
                raise RecordingFormatError(
                    f"{place}: expected X0, Date and Time of the one column of x, or Delta_X; it begins at "
                    f"{column.x0} s behind {column.date_and_time!r}, and that at {columns[0].x0} s behind "
                    f"{columns[0].date_and_time!r}"
                )
            clock = None  # the one column of x is of the first channel
        if clock is not None and clock not in clocks:
            times = _held(table, clock, f"{where}, {shown(names[clock])}: expected x")
            clocks[clock] = Channel(names[clock], times, "s")
            yield clocks[clock], ""
        is_shorter = samples.size == stated and column.step is not None
        if clock is not None and clocks[clock].samples.size > samples.size and is_shorter:
            clock = None  # a record of its own
        if clock is not None and clocks[clock].samples.size != samples.size:
            raise RecordingFormatError(
                f"{place}: expected a value for each x; got {samples.size} values and {clocks[clock].samples.size} x"
            )
        if clock is not None and stated == samples.size and column.step is not None:
            _require_step(clocks[clock].samples, column.step, place)
        # more samples than stated: packets under one header, which does not say that none is missing between them
        step = column.step if clock is None and stated in (None, samples.size) else None
        time = ChannelTime(clock=None if clock is None else names[clock])
        if step is not None:
            time = time_of_step(samples.size, step, column.n_digits, column.x0)
        yield Channel(column.name, samples, column.unit, time), column.date_and_time


def _require_step(times: SampleArray, step: float, where: str) -> None:
    """Refuse a column of x that contradicts the step of the header."""
    if times.size < _FEWEST_STEPS or not times[-1] > times[0]:
        return
    found = float(times[-1] - times[0]) / (times.size - 1)
    if abs(found / step - 1.0) > _SAME_STEP:
        raise RecordingFormatError(f"{where}: expected x in steps of {step:g} s as Delta_X says; got {found:.6g} s")


def _offsets(texts: Sequence[str], where: str) -> dict[str, float]:
    """Return how far dates and times, of no zone, are behind the earliest [s]; how one is written matters to no other.

    ``RecordingFormatError`` if there are several, and one of them is not written as the specification says.
    """
    distinct = dict.fromkeys(text for text in texts if text)
    if len(distinct) < 2:  # nothing to compare
        return dict.fromkeys(["", *distinct], 0.0)
    moments = dict[str, datetime]()
    for text in distinct:
        match = _DATE_AND_TIME.fullmatch(text)
        try:
            year, month, day, hour, minute, second = (int(n) for n in (match.groups()[:6] if match is not None else ()))
            moments[text] = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        except ValueError:
            raise RecordingFormatError(
                f"{where}: expected Date and Time such as '2025/03/01' and '06:00:00.5'; got {text[:60]!r}"
            ) from None
        moments[text] += timedelta(seconds=float(f"0{match[7] or '.0'}") if match else 0.0)
    earliest = min(moments.values())
    return {"": 0.0} | {text: (moment - earliest).total_seconds() for text, moment in moments.items()}


def _why_fewer(column: _Column, n_samples: int, times: FloatArray | None) -> str:
    """Say why there are fewer rows than the header states: the file was thinned where x covers what it states."""
    if n_samples < 2 or times is None or column.step is None or column.n_samples is None:
        return ": the file is cut off"
    step = float(times[-1] - times[0]) / (times.size - 1)
    if abs(step * n_samples - column.step * column.n_samples) > 2.0 * step:
        return ": the file is cut off"
    return (
        f" every {step:.6g} s where it says {column.step:.6g} s: rows were left out when it was written; "
        'believe = "rows" in [text] of the map takes the rows and their x'
    )


def _held(table: Table, column: int, expected: str) -> FloatArray:
    """Return the samples of a column, which ends where its cells are blank."""
    blank = table.blank.get(column)
    n_held = table.n_rows if blank is None else int(np.argmax(blank))
    if blank is not None and not blank[n_held:].all():
        raise RecordingFormatError(f"{expected} in each row; got a blank cell")
    return table.numbers[column][:n_held]


def _joined(read: Sequence[tuple[tuple[Channel, str], ...]], where: str) -> tuple[Channel, ...]:
    """Join segments of equal channels to arrays of a row each, or number them; their times count from the earliest."""
    offsets = _offsets([text for of_segment in read for _, text in of_segment], where)
    segments = [
        tuple(replace(channel, time=replace(channel.time, offset=offsets[text])) for channel, text in of_segment)
        for of_segment in read
    ]
    if len(segments) == 1:
        return segments[0]
    alike = {
        tuple((c.name, c.samples.shape, c.unit, c.time.sample_rate, c.time.clock) for c in channels)
        for channels in segments
    }
    if len(alike) == 1 and all(c.time.clock is None for c in segments[0]) and segments[0][0].time.sample_rate:
        return tuple(
            Channel(same[0].name, np.stack([channel.samples for channel in same]), same[0].unit,
                    replace(same[0].time, offset=0.0, runs=tuple(_row(channel.time) for channel in same)))
            for same in zip(*segments, strict=True)
        )  # fmt: skip
    return tuple(
        replace(c, name=f"{number}/{c.name}",
                time=c.time if c.time.clock is None else replace(c.time, clock=f"{number}/{c.time.clock}"))
        for number, channels in enumerate(segments, start=1)
        for c in channels
    )  # fmt: skip


def _row(time: ChannelTime) -> Run:
    (run,) = time.runs
    return replace(run, start=None if run.start is None else run.start + time.offset)
