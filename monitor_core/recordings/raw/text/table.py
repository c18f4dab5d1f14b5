"""Turn rows of text into columns of numbers, each row checked, at the speed of ``numpy.loadtxt``."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import MAX_SAMPLES
from monitor_core.recordings.raw.text.layout import SEPARATOR_NAMES
from monitor_core.recordings.raw.text.rows import shown, split_cells

#: Most columns of a file, and most numbers in all of them.
MAX_COLUMNS = 4096
MAX_NUMBERS = 2**27
#: Two kinds of signs, or one sign twice: 1.234,5 and 1,234.5 and 1.234.567.
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:\.\d{3}){2,}|(?:,\d{3}){2,}"
                        r"|(?:['’\s]\d{3})+(?:[.,]\d*)?)", re.ASCII)  # fmt: skip
_QUOTED = re.compile(r'"([^"]*)"')
_UNIT_SEPARATOR = "\x1f"
_DECIMAL_NAMES = {".": "point", ",": "comma"}


@dataclass(frozen=True, slots=True)
class TableForm:
    """How the rows of a table are written."""

    names: tuple[str, ...]
    separator: str | None  # None: any number of blanks
    decimal: str = "."  # "," or "."; "" for either, but not both in one file
    texts: frozenset[int] = frozenset()  # which columns are of texts
    quotes: bool = False  # cells may stand in quotes
    blanks: bool = False  # cells may be blank: no sample there
    gaps: bool = False  # cells may be blank: NaN stands there
    trailing: bool = False  # a separator ends each row
    comment: str | None = None  # rows that begin so are left out
    ends_at_blank: bool = False  # a blank row ends the table; else only blank rows may follow one


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of numbers and of texts, by their number."""

    numbers: dict[int, FloatArray]  # shape (n_rows,), write-protected
    texts: dict[int, tuple[str, ...]]
    blank: dict[int, BoolArray]  # columns in which cells were blank, and where
    n_rows: int


def is_number(text: str) -> bool:
    """Tell whether a cell is a number with a decimal point (Python alone would also take ``1_000``)."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text and text.isascii()


def has_thousands(text: str) -> bool:
    """Tell whether a cell is a number in which signs part the thousands."""
    return _THOUSANDS.fullmatch(text.strip('"')) is not None


def require_columns(line: str, separator: str | None, where: str) -> None:
    """Refuse a row of more columns than any recording has, before it is split."""
    n_columns = len(line.split(separator)) if separator is None else line.count(separator) + 1
    if n_columns > MAX_COLUMNS:
        raise RecordingFormatError(f"{where}: expected at most {MAX_COLUMNS} columns; got {n_columns}")


def read_table(blocks: Iterable[tuple[int, list[str]]], form: TableForm, n_bytes: int, where: str) -> Table:
    """Read rows to the end.

    Parameters
    ----------
    blocks : iterable of (int, list of str)
        Number of the first row of a block, counted from 1, and the rows.
    form : TableForm
        How they are written.
    n_bytes : int
        Size of the file, to judge how much memory is needed. [B]
    where : str
        File and the word "row", for messages.

    Returns
    -------
    Table
        The columns.

    Raises
    ------
    RecordingFormatError
        At the first row that does not fit the form.

    """
    reader = _Reader(form, n_bytes, where)
    for first_row, lines in blocks:
        if not reader.add(first_row, lines):
            break
    return reader.table()


class _Reader:
    """Columns that grow block by block. Rows are parsed together; only where that fails, cell by cell."""

    def __init__(self, form: TableForm, n_bytes: int, where: str) -> None:
        self._form = form
        self._where = where
        self._n_bytes = n_bytes
        self._columns = [i for i in range(len(form.names)) if i not in form.texts]
        self._numbers = np.empty((len(self._columns), 0))
        self._blank: BoolArray | None = None
        self._texts: dict[int, list[str]] = {i: [] for i in sorted(form.texts)}
        self._n_rows = 0
        self._blank_row: int | None = None  # a blank row that only blank ones may follow
        self._commas = form.decimal != "." and (form.separator != "," or form.quotes)  # in numbers
        self._decimal = form.decimal  # "" until a number with a comma or a point shows it

    def add(self, first_row: int, lines: list[str]) -> bool:
        """Take a block; False if the table has ended."""
        rows: Sequence[int] = range(first_row, first_row + len(lines))
        if self._form.comment is not None:
            kept = [i for i, line in enumerate(lines) if not line.startswith(self._form.comment)]
            if len(kept) < len(lines):
                rows, lines = [rows[i] for i in kept], [lines[i] for i in kept]
        n_filled, ended = len(lines), False
        if self._form.ends_at_blank:
            ended = any(not line or line.isspace() for line in lines)
            if ended:
                n_filled = next(i for i, line in enumerate(lines) if not line.strip())
        else:
            while n_filled and not lines[n_filled - 1].strip():
                n_filled -= 1
            if n_filled and self._blank_row is not None:
                self._refuse(self._blank_row, "expected numbers", f"got a blank row; remove row {self._blank_row}")
            if n_filled < len(lines) and self._blank_row is None:
                self._blank_row = rows[n_filled]
        if n_filled:
            self._add(rows[:n_filled], lines[:n_filled])
        return not ended

    def table(self) -> Table:
        """Return the columns that have been read."""
        numbers, blank = {}, {}
        for i, column in enumerate(self._columns):
            samples = self._numbers[i, : self._n_rows]
            samples.setflags(write=False)
            numbers[column] = samples
            if self._blank is not None and self._blank[i, : self._n_rows].any():
                blank[column] = self._blank[i, : self._n_rows]
        return Table(numbers, {i: tuple(texts) for i, texts in self._texts.items()}, blank, self._n_rows)

    def _add(self, rows: Sequence[int], lines: list[str]) -> None:
        if not self._columns:
            self._cells(rows, lines)
            self._reserve(len(lines), lines)
            self._n_rows += len(lines)
            return
        parsed = self._together(lines)
        values, blank = self._cells(rows, lines) if parsed is None else parsed
        self._reserve(len(lines), lines)
        filled = slice(self._n_rows, self._n_rows + len(lines))
        self._numbers[:, filled] = values.T
        if blank is not None:
            if self._blank is None:
                self._blank = np.zeros(self._numbers.shape, dtype=np.bool_)
            self._blank[:, filled] = blank.T
        self._n_rows += len(lines)

    def _reserve(self, n_more: int, lines: list[str]) -> None:
        needed, held = self._n_rows + n_more, self._numbers.shape[1]
        if needed > MAX_SAMPLES or needed * len(self._form.names) > MAX_NUMBERS:
            raise RecordingFormatError(
                f"{self._where} {needed}: expected at most {MAX_SAMPLES} rows and {MAX_NUMBERS} numbers; got more"
            )
        if needed <= held:
            return
        if held == 0:  # what is never written to takes no memory
            characters = sum(map(len, lines)) + len(lines)
            needed = max(needed, min(int(1.05 * self._n_bytes / characters * len(lines)), MAX_SAMPLES))
            needed = min(needed, MAX_NUMBERS // len(self._form.names))
        else:
            needed = max(needed, held + held // 4)
        self._numbers = _widened(self._numbers, self._n_rows, needed)
        if self._blank is not None:
            self._blank = _widened(self._blank, self._n_rows, needed)

    def _together(self, lines: list[str]) -> tuple[FloatArray, BoolArray | None] | None:
        """Parse rows in one go; ``None`` if that cannot be, or if not all of them fit."""
        separator = self._form.separator
        if self._form.quotes and separator is not None:
            lines, separator = _unquoted(lines, separator)
        parted = self._parted(lines, separator)
        if parted is None:
            return None
        lines, texts = parted
        blank = None
        if self._form.blanks and separator is not None:
            lines, blank = _filled(lines, separator, len(self._columns))
        pointed = self._with_points(lines) if self._commas else (lines, self._decimal)
        if pointed is None or not any(line.strip() for line in lines):
            return None
        lines, decimal = pointed
        table = _loaded(lines, separator)
        if table is None and self._form.gaps and separator is not None:
            lines, gaps = _filled(lines, separator, len(self._columns), short=False)
            table = None if gaps is None else _loaded(lines, separator)
        if table is None:
            return None
        # loadtxt skips blank lines in silence
        if table.shape != (len(lines), len(self._columns)):
            return None
        self._decimal = decimal
        for i, column_texts in enumerate(texts):
            self._texts[i].extend(_shared(column_texts, self._texts[i]))
        return table, blank

    def _parted(self, lines: list[str], separator: str | None) -> tuple[list[str], list[list[str]]] | None:
        """Part columns of texts in front from the numbers, and cut off separators behind the last cells."""
        n_texts = len(self._form.texts)
        if self._form.trailing and separator is not None:
            if not all(line.endswith(separator) for line in lines):
                return None
            lines = [line[:-1] for line in lines]
        if not n_texts:
            return lines, []
        if separator is None or self._form.texts != frozenset(range(n_texts)):
            return None
        parts = [line.split(separator, n_texts) for line in lines]
        if any(len(part) <= n_texts for part in parts):
            return None
        texts = [[part[i].strip() for part in parts] for i in range(n_texts)]
        if any('"' in text for column in texts for text in column):
            texts = [[f[1] if (f := _QUOTED.fullmatch(text)) else text for text in column] for column in texts]
            if any('"' in text for column in texts for text in column):
                return None
        return [part[n_texts] for part in parts], texts

    def _with_points(self, lines: list[str]) -> tuple[list[str], str] | None:
        """Write decimal points for commas; ``None`` if both are there."""
        joined, decimal = "\n".join(lines), self._decimal
        has_comma, has_point = "," in joined, "." in joined
        if has_point and (has_comma or decimal == ","):
            return None
        if has_comma and decimal != ".":
            lines = joined.replace(",", ".").split("\n")
        return lines, decimal or ("," if has_comma else "." if has_point else "")

    def _cells(self, rows: Sequence[int], lines: list[str]) -> tuple[FloatArray, BoolArray | None]:
        """Parse rows cell by cell; refuse the first that does not fit."""
        form = self._form
        values = np.empty((len(lines), len(self._columns)))
        blank = np.zeros(values.shape, dtype=np.bool_) if form.blanks else None
        texts: dict[int, list[str]] = {i: [] for i in self._texts}
        for number, (row, line) in enumerate(zip(rows, lines, strict=True)):
            cells = self._cells_of(row, line)
            for at, column in enumerate(self._columns):
                cell = cells[column]
                if blank is not None and not cell:
                    values[number, at], blank[number, at] = np.nan, True
                elif form.gaps and not cell:
                    values[number, at] = np.nan
                else:
                    values[number, at] = self._number(cells, row, column)
            for column, column_texts in texts.items():
                column_texts.append(cells[column])
        for column, column_texts in texts.items():
            self._texts[column].extend(_shared(column_texts, self._texts[column]))
        return values, blank if blank is not None and blank.any() else None

    def _cells_of(self, row: int, line: str) -> list[str]:
        form, n_columns = self._form, len(self._form.names)
        if len(line) > n_columns:  # a row of separators is not split into a million cells
            require_columns(line, form.separator, f"{self._where} {row}")
        cells = split_cells(line, form.separator, quotes=form.quotes)
        if form.trailing and len(cells) == n_columns + 1 and not cells[-1]:
            cells.pop()
        if form.blanks and len(cells) < n_columns:
            cells += [""] * (n_columns - len(cells))
        if len(cells) != n_columns:
            word, sign = "cells" if form.texts else "numbers", SEPARATOR_NAMES.get(form.separator, "colon")
            step = self._step(cells, row, f"complete row {row} or remove it")
            self._refuse(row, f"expected {n_columns} {word} separated by {sign}", f"got {len(cells)}; {step}")
        return cells

    def _number(self, cells: list[str], row: int, column: int) -> float:
        cell = point = cells[column]
        if self._commas:
            self._decimal = self._decimal or ("," if "," in cell else "." if "." in cell else "")
            if self._decimal == ",":
                point = "" if "." in cell else cell.replace(",", ".")
        if not is_number(point):
            expected = f"expected a number with a decimal {_DECIMAL_NAMES.get(self._decimal, 'point')}"
            if has_thousands(cell):
                self._refuse(row, expected, f"got {cell[:40]!r}: export without thousands separators", column)
            of_gap = f"write nan for the missing number of row {row}" if not any(map(str.isdigit, cell)) else ""
            numbers = [cells[i] for i in self._columns]
            step = of_gap if len(numbers) == 1 else self._step(numbers, row, of_gap)
            self._refuse(row, expected, f"got {cell[:40]!r}{step and f'; {step}'}", column)
        return float(point)

    def _step(self, cells: list[str], row: int, otherwise: str) -> str:
        """Say what is to be done with a row that does not fit, by whether there are numbers in it."""
        filled = [cell for cell in cells[:MAX_COLUMNS] if cell]
        if any(is_number(cell.replace(",", ".")) for cell in filled):
            return otherwise
        return f"remove row {row}, which holds no numbers"

    def _refuse(self, row: int, expected: str, got: str, column: int | None = None) -> None:
        place = (
            f"{self._where} {row}"
            if column is None
            else f"{self._where} {row}, column {shown(self._form.names[column])}"
        )
        raise RecordingFormatError(f"{place}: {expected}; {got}")


def _unquoted(lines: list[str], separator: str) -> tuple[list[str], str]:
    """Take the quotes off rows in which each cell has them; return the rows and the sign between cells."""
    if not all(line[:1] == '"' == line[-1:] for line in lines):
        return lines, separator
    parted = "\n".join(line[1:-1] for line in lines).replace(f'"{separator}"', _UNIT_SEPARATOR)
    return (lines, separator) if '"' in parted else (parted.split("\n"), _UNIT_SEPARATOR)


def _loaded(lines: list[str], separator: str | None) -> FloatArray | None:
    try:
        return np.loadtxt(lines, delimiter=separator, ndmin=2, comments=None, dtype=np.float64)
    except ValueError:
        return None


def _filled(
    lines: list[str], separator: str, n_columns: int, *, short: bool = True
) -> tuple[list[str], BoolArray | None]:
    """Write "nan" into blank cells, and say where; rows that are ``short`` lack their last cells."""
    blank: BoolArray | None = None
    filled = lines
    for i, line in enumerate(lines):
        if line.count(separator) == n_columns - 1 and not _may_have_blank_cells(line, separator):
            continue
        cells = [cell.strip() for cell in line.split(separator)]
        cells += [""] * (n_columns - len(cells) if short else 0)
        if len(cells) == n_columns and "" in cells:
            if blank is None:
                blank, filled = np.zeros((len(lines), n_columns), dtype=np.bool_), list(lines)
            blank[i] = [not cell for cell in cells]
            filled[i] = separator.join(cell or "nan" for cell in cells)
    return filled, blank


def _may_have_blank_cells(line: str, separator: str) -> bool:
    return separator * 2 in line or " " in line or line.startswith(separator) or line.endswith(separator)


def _widened(array: np.ndarray, n_used: int, n_columns: int) -> np.ndarray:
    wider = np.zeros((array.shape[0], n_columns), dtype=array.dtype)
    wider[:, :n_used] = array[:, :n_used]
    return wider


def _shared(texts: list[str], before: list[str]) -> list[str]:
    """Return the texts, with one object for those that follow each other and are equal, as dates are."""
    last = before[-1] if before else ""
    for i, text in enumerate(texts):
        if text == last:
            texts[i] = last
        else:
            last = text
    return texts
