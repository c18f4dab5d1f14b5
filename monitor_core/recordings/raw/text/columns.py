"""Read text files of columns: ``*.csv``, ``*.txt``, ``*.tsv``; how one is written is said, never guessed.

Without a layout the text is plain. The separator is the first of tab, semicolon and comma that the first line contains
(blanks, if none). A first line of numbers alone means a file without a header: the columns are then named "1", "2", ….
Decimals carry a point: a decimal comma is refused, never guessed. The text is UTF-8, with or without byte order mark,
with any line end. What is not plain is said by a layout, ``[text]`` of a channel map; the refusal says what is not.
Exports of programs that name themselves in their first lines (LVM, TwinCAT) need no layout.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import listed, require_file
from monitor_core.recordings.raw.channel_time import ChannelTime, Run
from monitor_core.recordings.raw.channels import Channel, Channels, Stored, require_distinct, single_numbers
from monitor_core.recordings.raw.stated_numbers import numbers_above
from monitor_core.recordings.raw.text import lvm, twincat
from monitor_core.recordings.raw.text.layout import (
    DECIMALS,
    SEPARATORS,
    TextLayout,
    distinct_names,
    has_equal_names,
    is_bracketed,
    time_columns,
    units_in_names,
)
from monitor_core.recordings.raw.text.proposal import TextProposal, plain_separator, propose
from monitor_core.recordings.raw.text.table import (
    MAX_COLUMNS,
    Rows,
    Table,
    TableForm,
    Watch,
    has_thousands,
    is_number,
    read_table,
    require_columns,
    shown,
    shown_list,
    split_cells,
)

#: Rows that show which columns hold numbers.
_ROWS_OF_SAMPLE = 20
_HEAD = 4096
#: Samples of an accelerometer as Klipper writes them: its documentation says in which units.
_KLIPPER = b"#time,accel_x,accel_y,accel_z"
_ENCODINGS = {"utf-16": "the encoding UTF-16", "latin-1": "Latin-1"}


def read_channels(path: Path, layout: TextLayout | None = None) -> Channels:
    """Read columns of numbers, and with a layout columns of texts (dates and times).

    The file states no time base (a column of times is a channel), but where each channel has its own column of times;
    units only in the row that the layout names. Every row has as many cells as there are names; with a layout, a blank
    cell among numbers is NaN. A column without a name is called by its number, as those of a file without a header.
    ``RecordingFormatError`` if a cell is no number, if rows are of unequal length, or if two columns have one name.
    """
    if layout is not None and layout.believe is None:
        return _read_with_layout(path, layout)
    if (channels := _export_of_program(path, layout)) is not None:
        return channels
    if layout is not None:
        raise RecordingFormatError(f"{path.name}: expected believe in [text] of an export whose header counts samples")
    try:
        return _read_plain(path)
    except RecordingFormatError as error:
        plain = str(error)
    try:
        proposal = propose(path)
    except RecordingFormatError:
        raise RecordingFormatError(plain) from None
    raise RecordingFormatError(_refusal(path, plain, proposal))


def read_as_proposed(path: Path, watch: Watch | None = None) -> tuple[Channels, TextLayout | None]:
    """Read a text in the layout that is proposed for it, for a person to confirm; None where it is plain.

    A text that is plain but for blank cells is read in its layout, too: they are NaN. Of a long one, the samples stay
    in the file; ``watch`` sees them while it is gone through. Raises as :func:`read_channels`, and if no rows of
    numbers are found.
    """
    if (channels := _export_of_program(path)) is not None:
        return channels, None
    proposal = propose(path)
    if proposal.reasons:
        return _read_with_layout(path, proposal.layout, watch), proposal.layout
    try:
        return _read_plain(path, watch), None
    except RecordingFormatError as error:
        plain = error
    try:
        return _read_with_layout(path, proposal.layout, watch), proposal.layout
    except RecordingFormatError:
        raise plain from None


def _export_of_program(path: Path, layout: TextLayout | None = None) -> Channels | None:
    with require_file(path).open("rb") as stream:
        head = stream.read(_HEAD)
    if lvm.is_lvm(head):
        return lvm.read_channels(path, layout)
    if head.startswith(_KLIPPER):
        time, *accelerations = _read_plain(path).channels
        named = (replace(channel, unit="mm/s2", time=ChannelTime(clock="time")) for channel in accelerations)
        return Channels(path.name, (replace(time, name="time", unit="s"), *named))
    return twincat.read_channels(path) if twincat.is_twincat(head) else None


def _refusal(path: Path, plain: str, proposal: TextProposal) -> str:
    """Return why a file is refused and the step that goes on; ``plain``: what the reader without a layout says.

    The command that writes a map is named only where the layout that it proposes reads the file: else the refusal is
    that of the layout, which says what is to be done in the file.
    """
    layout, reasons = proposal.layout, proposal.reasons
    try:
        _read_with_layout(path, layout)
    except RecordingFormatError as error:
        if layout.encoding != "utf-8":
            return f"{plain}; in {_ENCODINGS[layout.encoding]}: {error}"
        return str(error) if reasons else plain
    what = listed(reasons or ("cells without a number",), "and")
    command = f"`preload check {path.name} --write-map MAP`"
    return f"{plain}; the file has {what}: {command} writes a channel map with a table [text] that says so"


def _read_plain(path: Path, watch: Watch | None = None) -> Channels:
    rows = Rows(path)
    line = next(iter(rows.ahead(1)), None)
    if line is None or not line.strip():
        if not any(line.strip() for _, lines in rows.blocks() for line in lines):
            raise RecordingFormatError(f"{path.name}: expected columns of numbers; the file is blank")
        raise RecordingFormatError(f"{path.name}, row 1: expected names or numbers; got a blank row")
    separator = plain_separator(line)
    require_columns(line, separator, f"{path.name}, row 1")
    cells = split_cells(line, separator)
    has_header = not all(is_number(cell) for cell in cells)
    names = cells if has_header else [""] * len(cells)
    if not has_header or any(cell and not is_number(cell) for cell in cells):  # the index of pandas has no name
        names = _numbered(names)
    if has_header:
        rows.take()
    pairs = time_columns(names) if has_header and has_equal_names(names) else None
    units = {} if pairs is None else units_in_names(names)
    names = names if pairs is None else distinct_names(names)
    _require_names(names, path.name)
    if not any(line.strip() for line in rows.ahead(1)):
        raise RecordingFormatError(f"{path.name}, row {rows.row}: expected numbers under the header; got none")
    form = TableForm(tuple(names), separator, blanks=pairs is not None, marks=pairs is None)
    return _channels(rows, form, watch, partial(_read_plain, path), pairs=pairs, units=units)


def _read_with_layout(path: Path, layout: TextLayout, watch: Watch | None = None) -> Channels:
    if layout.sheet is not None:
        raise RecordingFormatError(f"{path.name}: expected no sheet in [text] of a text file; got {layout.sheet!r}")
    rows, decimal = Rows(path, layout.encoding), DECIMALS[layout.decimal]
    header, unit_line, numbers = _heads(rows, layout)
    sample = _sample(rows, layout)
    if not sample:
        raise RecordingFormatError(f"{path.name}, row {rows.row}: expected rows of numbers; the file ends there")
    separator = _separator(layout, sample[0] if header is None else header)
    for line in (sample[0] if header is None else header, sample[0]):
        require_columns(line, separator, f"{path.name}, row {rows.row}")
    cells = [split_cells(line, separator) for line in sample if line.count(separator or " ") < MAX_COLUMNS]
    names = _names(header, separator, cells)
    texts = frozenset(i for i in range(len(names)) if not any(_may_be_number(row, i, decimal) for row in cells))
    pairs = None if texts else time_columns(names)
    units = _units(unit_line, separator, len(names), f"{path.name}, row {layout.unit_row}")
    if pairs is not None:
        units = units_in_names(names) | units
        names = distinct_names(names)
    try:
        _require_names(names, path.name)
    except RecordingFormatError as error:
        raise RecordingFormatError(f"{error}; header_row = 0 in [text] calls the columns '1', '2', …") from None
    trailing = all(len(row) == len(names) + 1 and not row[-1] for row in cells)
    form = TableForm(tuple(names), separator, decimal, texts, quotes=True, blanks=pairs is not None,
                     gaps=pairs is None, trailing=trailing, comment=layout.comment, marks=pairs is None)  # fmt: skip
    channels = _channels(rows, form, watch, partial(_read_with_layout, path, layout), pairs=pairs, units=units)
    return replace(channels, numbers=numbers)


def _separator(layout: TextLayout, line: str) -> str | None:
    return plain_separator(line) if layout.separator is None else SEPARATORS[layout.separator]


def _numbered(names: Sequence[str]) -> list[str]:
    """Return the names; a column without one is called by its number."""
    return [name or str(number) for number, name in enumerate(names, start=1)]


def _require_names(names: Sequence[str], where: str) -> None:
    if "" in names:
        raise RecordingFormatError(f"{where}: expected a name for each column; got {shown_list(names)}")
    require_distinct(names, where)


def _heads(rows: Rows, layout: TextLayout) -> tuple[str | None, str | None, dict[str, float]]:
    """Return the row of names, that of units and the numbers stated above, and go on to the first row of the table."""
    header_row, unit_row = layout.header_row, layout.unit_row or 0
    if header_row is None:
        line = next(iter(rows.ahead(1)), "")
        cells = split_cells(line, _separator(layout, line))[:MAX_COLUMNS]
        header_row = 0 if all(is_number(cell, DECIMALS[layout.decimal]) for cell in cells) else 1
    first_row = layout.first_row or max(header_row, unit_row) + 1
    heads, above = dict[int, str](), list[str]()
    while rows.row < first_row:
        row, line_or_end = rows.row, rows.take()
        if line_or_end is None:
            raise RecordingFormatError(
                f"{rows.file_name}: expected numbers from row {first_row} on as the layout says; the file has "
                f"{row - 1} rows"
            )
        if row in (header_row, unit_row):
            heads[row] = line_or_end.removeprefix(layout.comment or "").strip(" ")
        else:
            above.append(line_or_end)
    for name, row in (("header_row", header_row), ("unit_row", unit_row)):
        if row and not heads.get(row, "").strip():
            got = "a blank row" if row in heads else f"numbers from row {first_row} on"
            raise RecordingFormatError(f"{rows.file_name}: expected {name} {row} above the numbers; got {got}")
    return heads.get(header_row), heads.get(unit_row), single_numbers(numbers_above(above))


def _sample(rows: Rows, layout: TextLayout) -> list[str]:
    lines = rows.ahead(_ROWS_OF_SAMPLE)
    return [line for line in lines if line.strip() and not (layout.comment and line.startswith(layout.comment))]


def _names(header: str | None, separator: str | None, cells: Sequence[Sequence[str]]) -> list[str]:
    """Return the names of the columns; all are called by their numbers where there is no header."""
    if header is None:
        n_cells = max((len(row) for row in cells), default=0)
        ends_blank = n_cells > 1 and all(len(row) == n_cells and not row[-1] for row in cells)
        return _numbered([""] * (n_cells - 1 if ends_blank else n_cells))
    names = split_cells(header, separator)
    while len(names) > 1 and not names[-1] and all(len(row) < len(names) or not row[len(names) - 1] for row in cells):
        names.pop()
    return _numbered(names)


def _units(line: str | None, separator: str | None, n_columns: int, where: str) -> dict[int, str]:
    cells = [] if line is None else split_cells(line, separator)
    if any(cells[n_columns:]):
        raise RecordingFormatError(f"{where}: expected at most {n_columns} units; got {len(cells)}")
    plain = {i: cell[1:-1].strip() if is_bracketed(cell) else cell for i, cell in enumerate(cells)}
    return {i: unit for i, unit in plain.items() if unit not in ("", "-")}


def _may_be_number(cells: Sequence[str], i: int, decimal: str) -> bool:
    """Tell whether a cell is no text; one with signs between thousands is refused as a number."""
    return len(cells) > i and (is_number(cells[i], decimal) or has_thousands(cells[i], decimal))


def _channels(
    rows: Rows,
    form: TableForm,
    watch: Watch | None,
    again: Callable[[Watch], Channels],
    *,
    pairs: Mapping[int, int] | None,
    units: Mapping[int, str],
) -> Channels:
    """Read the channels of a table; where each has its own times, rows without time and value hold no sample of it.

    ``again`` reads the file with all samples, where ``watch`` sees them and the beginning alone is kept of them.
    ``RecordingFormatError`` if a value has no time, or a time no value.
    """
    file_name, names, channels = rows.file_name, form.names, list[Channel]()
    watch = None if pairs else watch
    table = read_table(rows.blocks(), form, f"{file_name}, row", watch)
    time = ChannelTime(runs=_runs(table))
    read = None if watch is None else lru_cache(maxsize=1)(partial(_read_again, again))
    # of which all must be seen to know whether they vary: the file is read once more for all of them
    together = frozenset(i for i, begun in enumerate(table.numbers.values()) if np.all(begun == begun[:1]))
    for number, (i, samples) in enumerate(table.numbers.items()):
        if pairs is None:
            stored: Stored | SampleArray = samples
            if read is not None and samples.size < table.n_rows:
                stored = Stored((table.n_rows,), samples, number, partial(_pieces, read, together))
            channels.append(Channel(names[i], stored, units.get(i), time))
            continue
        blank, clock = table.blank.get(i), pairs.get(i)
        if clock is not None and not _equal(blank, table.blank.get(clock)):
            raise RecordingFormatError(
                f"{file_name}, {shown(names[i])}: expected a time for each value; got rows with one of them alone"
            )
        held = samples if blank is None else samples[~blank]
        if not held.size:
            raise RecordingFormatError(f"{file_name}, {shown(names[i])}: expected numbers; the column is blank")
        channels.append(
            Channel(names[i], held, units.get(i), time=ChannelTime(clock=None if clock is None else names[clock]))
        )
    return Channels(file_name, tuple(channels), texts={names[i]: texts for i, texts in table.texts.items()})


class _Kept:
    """Keeps some of the columns of a table, by number, while it is read again."""

    def __init__(self, wanted: Collection[int]) -> None:
        self._wanted = wanted
        self.pieces: dict[int, list[FloatArray]] = {}

    def begin(self, n_columns: int) -> None:
        self.pieces = {number: [] for number in range(n_columns) if number in self._wanted}

    def add(self, number: int, piece: FloatArray) -> None:
        if number in self.pieces:
            self.pieces[number].append(piece.copy())


def _read_again(again: Callable[[Watch], Channels], wanted: frozenset[int]) -> dict[int, list[FloatArray]]:
    kept = _Kept(wanted)
    again(kept)
    return kept.pieces


def _pieces(
    read: Callable[[frozenset[int]], dict[int, list[FloatArray]]], together: frozenset[int], wanted: Collection[int]
) -> Iterator[tuple[int, SampleArray]]:
    numbers = frozenset(wanted)
    read_now = read(numbers | together if numbers & together else numbers)
    for number in wanted:
        yield from ((number, piece) for piece in read_now[number])


def _runs(table: Table) -> tuple[Run, ...]:
    """Return the rows between those without a number; a column that counts the samples says how many are missing."""
    if not table.breaks:
        return ()
    begins = [n_rows for n_rows, _ in table.breaks]
    counted = [np.diff(numbers) for numbers in table.numbers.values() if numbers.size == table.n_rows]
    counter = next((steps for steps in counted if np.all(np.delete(steps, np.array(begins) - 1) == 1.0)), None)
    runs = [Run(begins[0])]
    for (begin, mark), end in zip(table.breaks, [*begins[1:], table.n_rows], strict=True):
        n_lost = None if counter is None or not counter[begin - 1] >= 1.0 else int(counter[begin - 1]) - 1
        runs.append(Run(end - begin, None, mark=mark, n_lost=n_lost))
    return tuple(runs)


def _equal(blank: BoolArray | None, other: BoolArray | None) -> bool:
    return other is None if blank is None else other is not None and bool((blank == other).all())
