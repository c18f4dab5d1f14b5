"""Read samples from text columns: ``*.csv``, ``*.txt``, ``*.tsv``.

Without a layout the text is plain. The separator is the first of tab, semicolon and comma that the first line contains
(blanks, if none). A first line of numbers alone means a file without a header: the columns are then named "1", "2", ….
Decimals carry a point: a decimal comma is refused, never guessed. The text is UTF-8, with or without byte order mark,
with any line end. What is not plain is said by a layout, ``[text]`` of a channel map; the refusal says what is not.
Exports of programs that name themselves in their first lines (LVM, TwinCAT) need no layout.
"""

from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_file
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.text import lvm, siemens_trace, twincat
from monitor_core.recordings.raw.text.layout import SEPARATOR_NAMES, SEPARATORS, TextLayout
from monitor_core.recordings.raw.text.rows import Rows, shown, shown_list, split_cells
from monitor_core.recordings.raw.text.table import (
    MAX_COLUMNS,
    Table,
    TableForm,
    has_thousands,
    is_number,
    read_table,
    require_columns,
)

__all__ = ["SEPARATOR_NAMES", "is_number", "read_channels"]

_PLAIN_SEPARATORS = ("\t", ";", ",")
#: Rows that show which columns hold numbers.
_ROWS_OF_SAMPLE = 20
_HEAD = 4096


def read_channels(path: Path, layout: TextLayout | None = None) -> Channels:
    """Read columns of numbers, and with a layout columns of texts (dates and times).

    The file states no time base (a column of times is a channel), but where each channel has its own column of times;
    units only in the row that the layout names. Every row has as many cells as there are names; with a layout, a blank
    cell among numbers is NaN. A column without a name is called by its number, as those of a file without a header.
    ``RecordingFormatError`` if a cell is no number, if rows are of unequal length, or if two columns have one name.
    """
    if layout is not None:
        return _read_with_layout(path, layout)
    with require_file(path).open("rb") as stream:
        head = stream.read(_HEAD)
    if lvm.is_lvm(head):
        return lvm.read_channels(path)
    if twincat.is_twincat(head):
        return twincat.read_channels(path)
    try:
        return _read_plain(path)
    except RecordingFormatError as error:
        from monitor_core.recordings.raw.text.proposal import refusal  # noqa: PLC0415  # only where it is needed

        raise RecordingFormatError(refusal(path, str(error))) from None


def _read_plain(path: Path) -> Channels:
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
    names = cells if has_header else [str(number) for number in range(1, len(cells) + 1)]
    if has_header:
        rows.take()
        if any(cell and not is_number(cell) for cell in cells):  # the index that pandas writes has no name
            names = [name or str(number) for number, name in enumerate(names, start=1)]
    pairs = siemens_trace.time_columns(names) if has_header else None
    own_clocks = pairs is not None and siemens_trace.has_equal_names(names)
    units = siemens_trace.units_in_names(names)
    if own_clocks:
        names = siemens_trace.distinct_names(names)
    _require_distinct(names, path.name)
    if not any(line.strip() for line in rows.ahead(1)):
        raise RecordingFormatError(f"{path.name}, row {rows.row}: expected numbers under the header; got none")
    form = TableForm(tuple(names), separator, blanks=own_clocks)
    table = read_table(rows.blocks(), form, path.stat().st_size, f"{path.name}, row")
    if own_clocks and pairs is not None:
        return siemens_trace.channels_of(path.name, names, table, pairs, units)
    return Channels(path.name, tuple(Channel(name, table.numbers[i]) for i, name in enumerate(names)))


def plain_separator(line: str) -> str | None:
    """Return the first of tab, semicolon and comma that a line contains; ``None`` for blanks."""
    return next((sign for sign in _PLAIN_SEPARATORS if sign in line), None)


def _require_distinct(names: list[str], where: str) -> None:
    seen: set[str] = set()
    for name in names:
        if not name:
            raise RecordingFormatError(f"{where}: expected a name for each column; got {shown_list(names)}")
        if name in seen:
            raise RecordingFormatError(f"{where}: expected columns of different names; got {shown(name)} twice")
        seen.add(name)


def _read_with_layout(path: Path, layout: TextLayout) -> Channels:
    if layout.sheet is not None:
        raise RecordingFormatError(f"{path.name}: expected no sheet in [text] of a text file; got {layout.sheet!r}")
    rows = Rows(path, layout.encoding)
    heads = _heads(rows, layout)
    sample = _sample(rows, layout)
    if not sample:
        raise RecordingFormatError(f"{path.name}, row {rows.row}: expected rows of numbers; the file ends there")
    shown = heads[0] if heads[0] is not None else sample[0]
    separator = plain_separator(shown) if layout.separator is None else SEPARATORS[layout.separator]
    for line in (shown, sample[0]):
        require_columns(line, separator, f"{path.name}, row {rows.row}")
    cells = [split_cells(line, separator) for line in sample if line.count(separator or " ") < MAX_COLUMNS]
    names, n_columns = _names(heads[0], separator, cells, layout)
    trailing = all(len(row) == n_columns + 1 and not row[-1] for row in cells)
    decimal = "." if layout.decimal == "point" else ","
    texts = _columns_of_texts(cells, n_columns, decimal)
    pairs = None if texts else siemens_trace.time_columns(names)
    units = _units(heads[1], separator, n_columns, f"{path.name}, row {layout.unit_row}")
    if pairs is not None:
        units = siemens_trace.units_in_names(names) | units
        names = siemens_trace.distinct_names(names)
    try:
        _require_distinct(names, path.name)
    except RecordingFormatError as error:
        raise RecordingFormatError(f"{error}; header_row = 0 in [text] calls the columns '1', '2', …") from None
    form = TableForm(tuple(names), separator, decimal, texts, quotes=True, blanks=pairs is not None,
                     gaps=pairs is None, trailing=trailing, comment=layout.comment)  # fmt: skip
    table = read_table(rows.blocks(), form, path.stat().st_size, f"{path.name}, row")
    if pairs is not None:
        return siemens_trace.channels_of(path.name, names, table, pairs, units)
    return _channels(path.name, names, table, units)


def _channels(file_name: str, names: list[str], table: Table, units: dict[int, str]) -> Channels:
    channels = tuple(Channel(names[i], samples, unit=units.get(i)) for i, samples in table.numbers.items())
    return Channels(file_name, channels, texts={names[i]: texts for i, texts in table.texts.items()})


def _heads(rows: Rows, layout: TextLayout) -> tuple[str | None, str | None]:
    """Return the row of names and the row of units, and go on to the first row of numbers."""
    header_row = layout.header_row
    if header_row is None:
        first = next(iter(rows.ahead(1)), "")
        decimal = "." if layout.decimal == "point" else ","
        separator = plain_separator(first) if layout.separator is None else SEPARATORS[layout.separator]
        has_header = not all(_is_number(cell, decimal) for cell in split_cells(first, separator)[:MAX_COLUMNS])
        header_row = 1 if has_header else 0
    unit_row = layout.unit_row or 0
    first_row = layout.first_row or max(header_row, unit_row) + 1
    heads: dict[int, str] = {}
    while rows.row < first_row:
        row, line = rows.row, rows.take()
        if line is None:
            raise RecordingFormatError(
                f"{rows.file_name}: expected numbers from row {first_row} on as the layout says; the file has "
                f"{row - 1} rows"
            )
        if row in (header_row, unit_row):
            heads[row] = line.removeprefix(layout.comment or "").strip(" ")
    for name, row in (("header_row", header_row), ("unit_row", unit_row)):
        if row and (row not in heads or not heads[row].strip()):
            got = "a blank row" if row in heads else f"numbers from row {first_row} on"
            raise RecordingFormatError(f"{rows.file_name}: expected {name} {row} above the numbers; got {got}")
    return heads.get(header_row), heads.get(unit_row)


def _sample(rows: Rows, layout: TextLayout) -> list[str]:
    lines = rows.ahead(_ROWS_OF_SAMPLE)
    if layout.comment is not None:
        lines = [line for line in lines if not line.startswith(layout.comment)]
    return [line for line in lines if line.strip()]


def _names(
    header: str | None, separator: str | None, cells: list[list[str]], layout: TextLayout
) -> tuple[list[str], int]:
    """Return the names of the columns; one without a name is called by its number, as all are without a header."""
    n_cells = max((len(row) for row in cells), default=0)
    if header is None:
        if n_cells > 1 and all(len(row) == n_cells and not row[-1] for row in cells):
            n_cells -= 1
        return [str(number) for number in range(1, n_cells + 1)], n_cells
    names = split_cells(header, separator)
    while len(names) > 1 and not names[-1] and all(len(row) < len(names) or not row[len(names) - 1] for row in cells):
        names.pop()
    return [name or str(number) for number, name in enumerate(names, start=1)], len(names)


def _units(line: str | None, separator: str | None, n_columns: int, where: str) -> dict[int, str]:
    if line is None:
        return {}
    cells = split_cells(line, separator)
    if len(cells) > n_columns and any(cells[n_columns:]):
        raise RecordingFormatError(f"{where}: expected at most {n_columns} units; got {len(cells)}")
    plain = {i: cell[1:-1].strip() if siemens_trace.is_bracketed(cell) else cell for i, cell in enumerate(cells)}
    return {i: unit for i, unit in plain.items() if unit not in ("", "-")}


def _columns_of_texts(cells: list[list[str]], n_columns: int, decimal: str) -> frozenset[int]:
    """Return the columns in which no cell is a number; one with signs between thousands is refused as a number."""
    return frozenset(
        i
        for i in range(n_columns)
        if not any(len(row) > i and (_is_number(row[i], decimal) or has_thousands(row[i])) for row in cells)
    )


def _is_number(cell: str, decimal: str) -> bool:
    if decimal == ",":
        return "." not in cell and is_number(cell.replace(",", "."))
    return is_number(cell)
