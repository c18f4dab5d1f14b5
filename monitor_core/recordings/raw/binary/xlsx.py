"""Read Excel workbooks, ``*.xlsx``, through openpyxl (extra ``xlsx``): columns of numbers under their names.

The names stand in the first row, unless the ``[text]`` of a channel map says otherwise; a first row of numbers alone
means a sheet without names: the columns are then "1", "2", …. Formulas count with the values that Excel saved. A
column of dates is a channel of seconds from the earliest first date of such columns, one of durations a channel of
seconds; a sheet has no time zone, so there is no start.
"""

import math
import warnings
from array import array
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.bounds import MAX_CHANNELS, require_plausible_channels
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples, require_distinct
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.proposal import propose_for_cells

if TYPE_CHECKING:
    from openpyxl.cell.read_only import EmptyCell, ReadOnlyCell
    from openpyxl.workbook import Workbook
    from openpyxl.worksheet._read_only import ReadOnlyWorksheet as Sheet

_MOST_ROWS = 2**20  # of a sheet, by the format
_MOST_PROPOSED_FROM = 400  # rows
_FREE_EMPTY_CELLS = 2**20
_SECONDS_PER_DAY = 86400.0


class Layout(Protocol):
    """Where the columns of a sheet stand; rows are counted from 1. ``None``: as in a plain sheet."""

    @property
    def header_row(self) -> int | None:
        """Row of the names; 0 where there is none."""

    @property
    def unit_row(self) -> int | None:
        """Row of the units."""

    @property
    def first_row(self) -> int | None:
        """First row of numbers."""

    @property
    def sheet(self) -> str | None:
        """Name of the sheet."""


@dataclass(slots=True)
class _Column:
    """Cells of a column, from the top."""

    name: str
    unit: str | None
    numbers: "array[float]" = field(default_factory=lambda: array("d"))
    first_text: tuple[int, str] | None = None  # row and text
    are_dates: bool | None = None  # the numbers; None: there are none yet
    n_empty: int = 0  # cells since the last number
    number_format: str | None = None  # of the first cell that holds something

    def add(self, value: object, *, is_date: bool, row: int, where: str) -> None:
        if value is None:
            self.n_empty += 1
            return
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.first_text = self.first_text or (row, str(value))
        else:
            if self.are_dates not in (None, is_date):
                kinds = ("numbers", "a date or a time")[:: 1 if is_date else -1]
                raise RecordingFormatError(
                    f"{where}, row {row}, column {self.name!r}: expected {kinds[0]} as above; got {kinds[1]}"
                )
            self.are_dates = is_date
            self.numbers.extend([math.nan] * self.n_empty)
            self.numbers.append(value)
            self.n_empty = 0
        if self.first_text is not None and self.are_dates is not None:
            at, text = self.first_text
            raise RecordingFormatError(
                f"{where}, row {at}, column {self.name!r}: expected numbers alone; got {text[:40]!r}"
            )


def read_channels(path: Path, layout: Layout | None = None) -> Channels:
    """Read the columns of a sheet; ``layout`` says where they stand, if not under the names in the first row.

    Columns of texts are named as not read, also where these are numbers stored as text; an empty cell above a number is
    NaN. ``RecordingFormatError`` if the workbook is damaged, if it has several sheets and none is named,
    if a cell among numbers is a text, an error, a truth value or a date, or if two columns have one name;
    ``MissingReaderError`` if openpyxl is not installed.
    """
    with _opened(path) as book:
        sheet = _sheet(book, layout, path.name)
        where = f"{path.name}, {sheet.title}"
        columns = _columns(sheet, layout, where)
        left_out = tuple(_texts(columns.values()))
        return Channels(path.name, _channels(columns, where), left_out=left_out)


def _texts(columns: Iterable[_Column]) -> Iterator[str]:
    """Say what columns of texts are."""
    for column in columns:
        if column.first_text is not None:
            row, text = column.first_text
            is_number = text.strip().replace(",", ".").lstrip("+-").replace(".", "", 1).isdigit()
            stored = f"numbers stored as text, from row {row} on: turn them into numbers in Excel"
            yield f"{column.name} ({stored if is_number else 'texts'})"


@contextmanager
def _opened(path: Path) -> Iterator["Workbook"]:
    """Open a workbook whose dates are numbers; raises as :func:`read_channels`."""
    try:
        import openpyxl  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(f"{path.name}: reading XLSX needs openpyxl; pip install openpyxl") from error

    with (
        refusing(path.name, "an Excel workbook (.xlsx)"),
        require_file(path).open("rb") as stream,
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # what openpyxl warns of is formatting that it does not keep
        book = openpyxl.load_workbook(stream, read_only=True, data_only=True, keep_links=False)
        try:
            # as numbers, told by their style: openpyxl would round a date to the millisecond
            book.date_styles, book._date_formats = frozenset(book._date_formats), set()
            yield book
        finally:
            book.close()


def _sheets_of(book: "Workbook") -> list["Sheet"]:
    for sheet in book.worksheets:
        sheet.reset_dimensions()  # what a sheet says of its size is not believed
    return list(book.worksheets)


def _sheet(book: "Workbook", layout: Layout | None, where: str) -> "Sheet":
    sheets = {sheet.title: sheet for sheet in _sheets_of(book)}
    stated = None if layout is None else layout.sheet
    names = ", ".join(repr(name) for name in list(sheets)[:20])
    if stated is not None:
        if stated not in sheets:
            raise RecordingFormatError(f"{where}: expected a sheet {stated!r}; the workbook has {names}")
        return sheets[stated]
    filled = [sheet for sheet in sheets.values() if any(True for _ in _rows_of(sheet, where))]
    if len(filled) != 1:
        raise RecordingFormatError(
            f"{where}: expected one sheet with cells, or the name of one as sheet in [text]; the workbook has {names}"
        )
    return filled[0]


def _rows_of(sheet: "Sheet", where: str) -> Iterator[tuple[int, tuple[object, ...]]]:
    """Yield the values of the rows that have cells, with their numbers."""
    for number, values, _ in _cells_of(sheet, where):
        yield number, values


def _cells_of(
    sheet: "Sheet", where: str
) -> Iterator[tuple[int, tuple[object, ...], tuple["ReadOnlyCell | EmptyCell", ...]]]:
    """Yield the rows that have cells: number, values, cells."""
    n_filled = n_empty = 0
    for number, cells in enumerate(sheet.iter_rows(), start=1):
        values = tuple([cell.value for cell in cells])
        empty = values.count(None)
        n_empty, n_filled = n_empty + empty, n_filled + len(cells) - empty
        if number > _MOST_ROWS or len(cells) > MAX_CHANNELS or n_empty > _FREE_EMPTY_CELLS + 4 * n_filled:
            raise RecordingFormatError(
                f"{where}: expected at most {_MOST_ROWS} rows and {MAX_CHANNELS} columns, most of them filled; "
                f"got {n_filled} filled cells and {n_empty} empty ones by row {number}"
            )
        if empty < len(cells):
            yield number, values, cells


def _columns(sheet: "Sheet", layout: Layout | None, where: str) -> dict[int, _Column]:
    """Return the columns by their place, counted from 0."""
    header_row = None if layout is None else layout.header_row
    unit_row = (layout.unit_row if layout is not None else None) or 0
    heads: dict[int, tuple[object, ...]] = {}
    columns: dict[int, _Column] = {}
    first_row = last_head = n_rows = 0
    dates: frozenset[int] = getattr(sheet.parent, "date_styles", frozenset())
    for number, cells, row in _cells_of(sheet, where):
        if not first_row:
            if header_row is None:
                header_row = 0 if all(_is_number(cell) for cell in cells if cell is not None) else number
                header_row = _require_at_top(header_row, number, cells, where)
            last_head = max(header_row, unit_row)
            first_row = (layout.first_row if layout is not None else None) or last_head + 1
        if number in (header_row, unit_row):
            heads[number] = cells
        if number < first_row:
            continue
        for place, cell in enumerate(cells):
            if place not in columns and cell is not None:
                columns[place] = _column(place, heads, header_row or 0, unit_row, where)
                columns[place].n_empty = n_rows
                columns[place].number_format = getattr(row[place], "number_format", None)
        for place, column in columns.items():
            value = cells[place] if place < len(cells) else None
            is_date = value is not None and getattr(row[place], "_style_id", None) in dates
            column.add(value, is_date=is_date, row=number, where=where)
        n_rows += 1
    if not columns:
        raise RecordingFormatError(f"{where}: expected numbers from row {first_row or 1} on; got none")
    return columns


def _require_at_top(header_row: int, number: int, cells: tuple[object, ...], where: str) -> int:
    n_texts = sum(isinstance(cell, str) for cell in cells)
    n_filled = sum(cell is not None for cell in cells)
    if header_row and n_texts < n_filled:
        raise RecordingFormatError(
            f"{where}, row {number}: expected the names of the columns; got {n_texts} texts among {n_filled} cells: "
            "say header_row in [text] of a channel map"
        )
    return header_row


def _is_number(cell: object) -> bool:
    return isinstance(cell, (int, float)) and not isinstance(cell, bool)


def _column(place: int, heads: dict[int, tuple[object, ...]], header_row: int, unit_row: int, where: str) -> _Column:
    def head(row: int) -> str:
        cells = heads.get(row, ())
        cell = cells[place] if place < len(cells) else None
        return "" if cell is None else str(cell).strip()

    name = head(header_row) if header_row else str(place + 1)
    if not name:
        raise RecordingFormatError(
            f"{where}: expected a name in row {header_row} for each column; column {place + 1} has none: if the names "
            "are in another row, say header_row in [text] of a channel map"
        )
    return _Column(name, (head(unit_row) or None) if unit_row else None)


def _shown_as(number_format: str | None) -> str | None:
    """Return how a column is shown: "date", "duration", or nothing for numbers."""
    from openpyxl.styles.numbers import is_date_format, is_timedelta_format  # noqa: PLC0415

    if is_timedelta_format(number_format):
        return "duration"
    if not is_date_format(number_format):
        return None
    # a time of day alone counts from midnight
    return "date" if any(letter in str(number_format).lower() for letter in "yd") else "duration"


def _channels(columns: dict[int, _Column], where: str) -> tuple[Channel, ...]:
    kept = {place: column for place, column in sorted(columns.items()) if column.numbers}
    require_distinct([column.name for column in kept.values()], where)
    require_plausible_channels([(column.name, len(column.numbers)) for column in kept.values()], where)
    formats = {place: _shown_as(column.number_format) for place, column in kept.items()}
    dates = [column.numbers for place, column in kept.items() if formats[place] == "date"]
    zero = min((next(filter(math.isfinite, numbers), math.inf) for numbers in dates), default=0.0)
    return tuple(_channel(column, formats[place], zero) for place, column in kept.items())


def _channel(column: _Column, shown_as: str | None, zero: float) -> Channel:
    values = np.frombuffer(column.numbers, np.float64)
    if shown_as is None:
        return Channel(column.name, native_samples(values.copy()), column.unit)
    if shown_as == "duration":
        return Channel(column.name, native_samples(values * _SECONDS_PER_DAY), "s")
    # days since 1900 tell instants to 0.6 µs
    return Channel(column.name, native_samples(np.round((values - zero) * _SECONDS_PER_DAY, 6)), "s")


def propose_layout(path: Path) -> TextLayout | None:
    """Propose a layout that reads a workbook; ``None`` if there is none. It is for a person to confirm."""
    with _opened(path) as book:
        sheets = {sheet.title: _cells(sheet, path.name) for sheet in _sheets_of(book)}
    filled = {title: rows for title, rows in sheets.items() if rows}
    for title, rows in sorted(filled.items(), key=lambda sheet: -len(sheet[1])):
        layout = propose_for_cells(rows)
        if layout is None:
            continue
        proposed = replace(layout, sheet=title if len(filled) > 1 else None)
        try:
            read_channels(path, proposed)
        except RecordingFormatError:
            continue
        return proposed
    return None


def _cells(sheet: "Sheet", where: str) -> Sequence[Sequence[str]]:
    """Return the first rows of a sheet as texts, those without a cell, too: rows are known by their numbers."""
    found: list[list[str]] = []
    for number, cells in islice(_rows_of(sheet, where), _MOST_PROPOSED_FROM):
        if number > _MOST_PROPOSED_FROM:
            break
        found += [[] for _ in range(number - 1 - len(found))]
        texts = ["" if cell is None else " ".join(str(cell).split()) for cell in cells]
        while texts and not texts[-1]:
            texts.pop()
        found.append(texts)
    return found
