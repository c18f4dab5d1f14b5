"""Read the rows of a text file in blocks, and turn them into columns of numbers, each row checked.

A large file never stands in memory as text.
"""

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NoReturn, Protocol

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import MAX_SAMPLES, require_file, utf16_codec
from monitor_core.recordings.raw.channels import HEAD
from monitor_core.recordings.raw.text.layout import SEPARATOR_NAMES

#: Bytes read at a time; a row may be of as many characters.
BLOCK = 2**20
#: Most columns of a file, and most numbers in all of them.
MAX_COLUMNS = 4096
MAX_NUMBERS = 2**27
_CODECS = {"utf-8": "utf-8-sig", "latin-1": "latin-1", "utf-16": "utf-16"}
_ENCODING_NAMES = {"utf-8": "UTF-8", "latin-1": "Latin-1", "utf-16": "UTF-16"}
_HEAD = 2**16  # of it the order of bytes shows
_MOST_SHOWN = 60
_MOST_LISTED = 12
#: Two kinds of signs, or one sign twice: 1.234,5 and 1,234.5 and 1.234.567.
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:\.\d{3}){2,}|(?:,\d{3}){2,}"
                        r"|(?:['’\s]\d{3})+(?:[.,]\d*)?)", re.ASCII)  # fmt: skip
_THOUSANDS_BY_POINTS = re.compile(rf"(?:{_THOUSANDS.pattern}|[+-]?\d{{1,3}}(?:\.\d{{3}})+)", re.ASCII)
_DECIMAL_NAMES = {".": "point", ",": "comma"}


class Rows:
    """The rows of a text file from the first to the last, counted from 1; line ends may be of any kind."""

    def __init__(self, path: Path, encoding: str = "utf-8") -> None:
        """Begin at the first row; ``encoding`` is one of ``[text]``."""
        self.file_name = path.name
        self.row = 1  # number of the row that comes next
        self._blocks = _lines(path, encoding)
        self._read: list[str] = []
        self._n_taken = 0  # of the rows that were read

    def take(self) -> str | None:
        """Return the next row, or ``None`` at the end of the file."""
        lines = self.ahead(1)
        self._n_taken += len(lines)
        self.row += len(lines)
        return lines[0] if lines else None

    def ahead(self, most: int) -> list[str]:
        """Return the rows that come next, as many as there are, without taking them."""
        while len(self._read) - self._n_taken < most and (block := next(self._blocks, None)):
            self._read, self._n_taken = self._read[self._n_taken :] + block, 0
        return self._read[self._n_taken : self._n_taken + most]

    def blocks(self, *, until_blank: bool = False) -> Iterator[tuple[int, list[str]]]:
        """Take the rows that are left, or those up to a blank one: number of the first of a block, and the block."""
        while self.ahead(1):
            lines = self._read[self._n_taken :]
            blank = (i for i, line in enumerate(lines) if not line or line.isspace()) if until_blank else iter(())
            n_rows = next(blank, len(lines))
            first_row, self.row = self.row, self.row + n_rows
            self._n_taken += n_rows
            if n_rows:
                yield first_row, lines[:n_rows]
            if n_rows < len(lines):
                return


def require_utf8(path: Path) -> None:
    """Refuse a file that is no text in UTF-8; all of it is read."""
    for _ in _decoded(path, "utf-8"):
        pass


def _lines(path: Path, encoding: str) -> Iterator[list[str]]:
    rest = ""
    for text in _decoded(path, encoding):
        lines = (rest + text).split("\n")
        rest = lines.pop()
        if len(rest) > BLOCK:
            raise RecordingFormatError(f"{path.name}: expected rows of at most {BLOCK} characters; got a longer one")
        if lines:
            yield lines
    if rest:
        yield [rest]


def _decoded(path: Path, encoding: str) -> Iterator[str]:
    expected = f"{path.name}: expected {_ENCODING_NAMES[encoding]} text"
    with require_file(path).open("rb") as stream:
        codec = _CODECS[encoding] if encoding != "utf-16" else utf16_codec(stream.read(_HEAD)) or "utf-16"
        stream.seek(0)
        decoder = codecs.getincrementaldecoder(codec)()
        with_newlines, n_bytes, ended = io.IncrementalNewlineDecoder(decoder, translate=True), 0, False
        while not ended:
            content, waiting = stream.read(BLOCK), len(decoder.getstate()[0])
            ended = len(content) < BLOCK
            try:
                yield with_newlines.decode(content, final=ended)
            except UnicodeDecodeError as error:
                byte = f"byte {n_bytes - waiting + error.start} is {error.object[error.start]:#04x}"
                raise RecordingFormatError(f"{expected}; {byte}") from None
            except UnicodeError:
                raise RecordingFormatError(f"{expected}; it has no byte order mark") from None
            n_bytes += len(content)


def shown(text: str) -> str:
    """Return a text of a file as a message shows it: its beginning, in quotes, without control characters."""
    return repr(text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 1]}…")


def shown_list(texts: Sequence[str]) -> str:
    """Return the first of some texts of a file as a message shows them."""
    return ", ".join(shown(text) for text in texts[:_MOST_LISTED]) + (", …" if len(texts) > _MOST_LISTED else "")


def split_cells(line: str, separator: str | None, *, quotes: bool = True) -> list[str]:
    """Return the cells of a row without the blanks around them; cells in quotes lose these, and may hold separators."""
    cells = line.split(separator)
    if quotes and '"' in line:
        if separator is None:
            line, separator = " ".join(cells), " "
        try:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])
        except csv.Error:
            cells = line.split(separator)
    return [cell.strip() for cell in cells]


def is_number(text: str, decimal: str = ".") -> bool:
    """Tell whether a cell is a number (Python alone would also take ``1_000``); an empty ``decimal`` takes either."""
    if decimal != ".":
        text = "" if decimal and "." in text else text.replace(",", ".")
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text and text.isascii()


def has_thousands(text: str, decimal: str = ".") -> bool:
    """Tell whether a cell is a number in which signs part the thousands; where commas are decimal, points may."""
    pattern = _THOUSANDS_BY_POINTS if decimal == "," else _THOUSANDS
    return pattern.fullmatch(text.strip('"')) is not None


def require_columns(line: str, separator: str | None, where: str) -> None:
    """Refuse a row of more columns than any recording has, before it is split."""
    n_columns = len(line.split(separator)) if separator is None else line.count(separator) + 1
    if n_columns > MAX_COLUMNS:
        raise RecordingFormatError(f"{where}: expected at most {MAX_COLUMNS} columns; got {n_columns}")


@dataclass(frozen=True, slots=True)
class TableForm:
    """How the rows of a table are written."""

    names: tuple[str, ...]
    separator: str | None  # None: any number of blanks
    decimal: str = "."  # "," or "."; "" for either, but not both in one file
    texts: frozenset[int] = frozenset()  # which columns are of texts
    quotes: bool = False  # cells may stand in quotes
    blanks: bool = False  # cells may be blank, and the last ones missing: no sample there
    gaps: bool = False  # cells may be blank: NaN stands there
    trailing: bool = False  # a separator ends each row
    comment: str | None = None  # rows that begin so are left out
    marks: bool = False  # rows without a number may stand among the numbers, and part them


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of numbers and of texts, by their number."""

    numbers: dict[int, FloatArray]  # shape (n_rows,), write-protected
    texts: dict[int, tuple[str, ...]]
    blank: dict[int, BoolArray]  # columns in which cells were blank, and where
    n_rows: int
    breaks: tuple[tuple[int, str], ...] = ()  # rows of numbers in front of a row without one, and what stands there


class Watch(Protocol):
    """Sees the columns of numbers of a table while it is read."""

    def begin(self, n_columns: int) -> None:
        """Begin with a table of so many columns of numbers; what was seen of another one is forgotten."""

    def add(self, number: int, piece: FloatArray) -> None:
        """Take the numbers that come next in a column, counted from 0 among those of numbers."""


def read_table(
    blocks: Iterable[tuple[int, list[str]]], form: TableForm, where: str, watch: Watch | None = None
) -> Table:
    """Read rows to the end.

    Parameters
    ----------
    blocks : iterable of (int, list of str)
        Number of the first row of a block, counted from 1, and the rows.
    form : TableForm
        How they are written.
    where : str
        File and the word "row", for messages.
    watch : Watch or None
        Sees all numbers; of a long table the beginning alone is kept then.

    Returns
    -------
    Table
        The columns.

    Raises
    ------
    RecordingFormatError
        At the first row that does not fit the form.

    """
    reader = _TableReader(form, where, watch)
    for first_row, lines in blocks:
        reader.add(first_row, lines)
    return reader.table()


@dataclass(frozen=True, slots=True)
class _Mark:
    """A row without a number: words, a comment, or nothing."""

    row: int
    line: str
    is_comment: bool = False


#: Numbers of columns, and which cells were blank.
_Numbers = dict[int, tuple[FloatArray, BoolArray | None]]


class _TableReader:
    """Columns that grow block by block. Where a block does not fit, its first row that does not is looked for."""

    def __init__(self, form: TableForm, where: str, watch: Watch | None) -> None:
        self._form = form
        self._where = where
        self._numbers: dict[int, list[FloatArray]] = {i: [] for i in range(len(form.names)) if i not in form.texts}
        self._blank: dict[int, list[BoolArray]] = {i: [] for i in self._numbers}
        self._texts: dict[int, list[str]] = {i: [] for i in sorted(form.texts)}
        self._at_once = True
        self._watch = watch
        if watch is not None:
            watch.begin(len(self._numbers))
        self._n_rows = 0
        self._mark: _Mark | None = None  # that no row of numbers follows yet
        self._breaks: list[tuple[int, str]] = []
        self._commas = form.decimal != "." and (form.separator != "," or form.quotes)  # in numbers
        self._decimal = form.decimal  # "" until a number with a comma or a point shows it

    def add(self, first_row: int, lines: list[str]) -> None:
        """Take a block."""
        comment, begin = self._form.comment, 0
        if comment is not None and any(line.startswith(comment) for line in lines):
            for i in (i for i, line in enumerate(lines) if line.startswith(comment)):
                self._take_filled(range(first_row + begin, first_row + i), lines[begin:i])
                self._set_mark(_Mark(first_row + i, lines[i], is_comment=True))
                begin = i + 1
        self._take_filled(range(first_row + begin, first_row + len(lines)), lines[begin:])

    def _take_filled(self, rows: Sequence[int], lines: list[str]) -> None:
        n_filled = len(lines)
        while n_filled and not lines[n_filled - 1].strip():
            n_filled -= 1
        if n_filled:
            self._take(rows[:n_filled], lines[:n_filled])
        if n_filled < len(lines):
            self._set_mark(_Mark(rows[n_filled], ""))

    def _set_mark(self, mark: "_Mark") -> None:
        """Remember a row without a number; of several, the first that holds words."""
        if self._mark is None or not self._mark.line:
            self._mark = mark

    def _end_mark(self) -> None:
        """Part the rows at a row without a number, now that one of numbers follows."""
        mark, self._mark = self._mark, None
        if mark is None or (mark.is_comment and not self._form.marks):
            return
        if not mark.line and (self._n_rows == 0 or not self._form.marks):
            self._refuse(mark.row, "expected numbers", f"got a blank row; remove row {mark.row}")
        if self._n_rows:
            words = f" {shown(mark.line.strip())}" if mark.line else ", which is blank"
            self._breaks.append((self._n_rows, f"row {mark.row}{words}"))
        elif not mark.is_comment:
            self._refuse_row(mark.row, mark.line)

    def table(self) -> Table:
        """Return the columns that have been read."""
        if self._mark is not None and self._mark.line and not self._mark.is_comment:
            self._refuse_row(self._mark.row, self._mark.line)
        numbers, blank = dict[int, FloatArray](), dict[int, BoolArray]()
        for i, blocks in self._numbers.items():
            numbers[i] = np.concatenate(blocks) if blocks else np.empty(0)
            numbers[i].setflags(write=False)
            blocks.clear()  # so that only one column stands in memory twice
            if any(block.any() for block in self._blank[i]):
                blank[i] = np.concatenate(self._blank[i])
        return Table(
            numbers, {i: tuple(texts) for i, texts in self._texts.items()}, blank, self._n_rows, tuple(self._breaks)
        )

    def _take(self, rows: Sequence[int], lines: list[str]) -> None:
        """Take rows, all at once if all of them fit; else the first that does not is found by halves, and refused."""
        decimal = self._decimal
        columns: Sequence[Sequence[str]] = ()
        try:
            numbers = self._numbers_at_once(lines)
            if numbers is None:
                columns = self._columns(lines)
                numbers = {i: self._numbers_in(columns[i]) for i in self._numbers}
        except ValueError:
            self._decimal = decimal
            if len(lines) == 1 and self._form.marks and self._holds_no_number(lines[0]):
                self._set_mark(_Mark(rows[0], lines[0].strip()))
                return
            if len(lines) == 1:
                self._refuse_row(rows[0], lines[0])
                raise
            half = len(lines) // 2
            self._take(rows[:half], lines[:half])
            self._take(rows[half:], lines[half:])
            return
        self._end_mark()
        is_kept = self._watch is None or self._n_rows < HEAD
        self._n_rows += len(lines)
        if self._n_rows > MAX_SAMPLES or self._n_rows * len(self._form.names) > MAX_NUMBERS:
            most = f"{MAX_SAMPLES} rows and {MAX_NUMBERS} numbers"
            raise RecordingFormatError(f"{self._where} {self._n_rows}: expected at most {most}; got more")
        for number, (i, (values, blank)) in enumerate(numbers.items()):
            if self._watch is not None:
                self._watch.add(number, values)
            if not is_kept:
                continue
            self._numbers[i].append(values)
            if self._form.blanks:
                self._blank[i].append(np.zeros(values.size, dtype=np.bool_) if blank is None else blank)
        for i, texts in self._texts.items() if is_kept else ():
            texts.extend(_shared([text.strip() for text in columns[i]], texts))

    def _numbers_at_once(self, lines: list[str]) -> _Numbers | None:
        """Return the numbers of a block of a long table by pyarrow, in a quarter of the time; None where it does not.

        It converts as Python does. What it does not take, signs that Python alone would refuse, texts and blank cells
        among them, is left to the slow way, which knows them and says where they are.
        """
        form, separator, decimal = self._form, self._form.separator, self._decimal
        if not self._at_once or not self._n_rows or separator is None or not decimal or separator == decimal:
            return None
        text, csv_of_arrow, numbers = "\n".join(lines), _csv_of_arrow(), None
        if csv_of_arrow is not None and not form.texts and text.isascii() and "(" not in text:  # nan(0x1)
            numbers = csv_of_arrow(text, len(form.names), separator, decimal)
        self._at_once = numbers is not None  # of a table with one gap, more are to be expected
        return numbers

    def _holds_no_number(self, line: str) -> bool:
        """Tell whether a row is none of the table: words of another number of cells, or the header again."""
        cells = split_cells(line[: BLOCK // 16], self._form.separator, quotes=self._form.quotes)
        is_header = tuple(cells) == self._form.names
        is_word = not line.strip() or line.lstrip()[0].isalnum()  # other signs begin a comment, which a layout states
        fits = len(cells) == len(self._form.names) and not is_header
        return is_word and not fits and not any(is_number(cell, "") for cell in cells)

    def _columns(self, lines: list[str]) -> Sequence[Sequence[str]]:
        """Return the cells of rows, column by column; ``ValueError`` if a row has too few or too many."""
        form, n_columns = self._form, len(self._form.names)
        separator, quoted = form.separator, form.quotes and any('"' in line for line in lines)
        if separator is not None and not quoted and all(line.count(separator) == n_columns - 1 for line in lines):
            joined = separator.join(lines).split(separator)  # a third of the time that row by row takes
            return [joined[i::n_columns] for i in range(n_columns)]
        rows = _quoted_rows(lines, separator) if quoted else [line.split(separator) for line in lines]
        for cells in rows:
            if len(cells) != n_columns:
                self._complete(cells)
        return list(zip(*rows, strict=True))

    def _complete(self, cells: list[str]) -> None:
        """Take off the blank cell behind the last separator, and add the blank ones that were left out."""
        n_columns = len(self._form.names)
        if self._form.trailing and len(cells) == n_columns + 1 and not cells[-1].strip():
            cells.pop()
        if self._form.blanks:
            cells += [""] * (n_columns - len(cells))
        if len(cells) != n_columns:
            raise ValueError

    def _numbers_in(self, cells: Sequence[str]) -> tuple[FloatArray, BoolArray | None]:
        """Return the numbers of a column, and which cells were blank; ``ValueError`` if one does not fit."""
        try:
            return self._parsed(cells), None
        except ValueError:
            stripped = [cell.strip() for cell in cells]
            filled = [cell or "nan" for cell in stripped] if self._form.gaps or self._form.blanks else stripped
            return self._parsed(filled), np.array([not cell for cell in stripped])

    def _parsed(self, cells: Sequence[str]) -> FloatArray:
        joined = "".join(cells)
        if "_" in joined or not joined.isascii():
            raise ValueError
        self._show_decimal(joined)
        if self._decimal == "," and "." in joined:
            raise ValueError
        if self._decimal == "," and "," in joined:
            cells = [cell.replace(",", ".") for cell in cells]
        return np.fromiter(map(float, cells), np.float64, len(cells))

    def _show_decimal(self, text: str) -> None:
        self._decimal = self._decimal or ("," if "," in text else "." if "." in text else "")

    def _refuse_row(self, row: int, line: str) -> None:
        form, n_columns = self._form, len(self._form.names)
        if len(line) > n_columns:  # a row of separators is not split into a million cells
            require_columns(line, form.separator, f"{self._where} {row}")
        cells = split_cells(line, form.separator, quotes=form.quotes)
        try:
            self._complete(cells)
        except ValueError:
            word, sign = "cells" if form.texts else "numbers", SEPARATOR_NAMES.get(form.separator, "colon")
            step = _step(cells, row, f"complete row {row} or remove it")
            self._refuse(row, f"expected {n_columns} {word} separated by {sign}", f"got {len(cells)}; {step}")
        for column in self._numbers:
            self._require_number(cells, row, column)

    def _require_number(self, cells: list[str], row: int, column: int) -> None:
        cell = cells[column]
        self._show_decimal(cell)
        if is_number(cell, self._decimal or ".") or (not cell and (self._form.gaps or self._form.blanks)):
            return
        expected = f"expected a number with a decimal {_DECIMAL_NAMES.get(self._decimal, 'point')}"
        if has_thousands(cell, self._decimal):
            self._refuse(row, expected, f"got {cell[:40]!r}: export without thousands separators", column)
        of_gap = f"write nan for the missing number of row {row}" if not any(map(str.isdigit, cell)) else ""
        numbers = [cells[i] for i in self._numbers]
        step = of_gap if len(numbers) == 1 else _step(numbers, row, of_gap)
        self._refuse(row, expected, f"got {cell[:40]!r}{step and f'; {step}'}", column)

    def _refuse(self, row: int, expected: str, got: str, column: int | None = None) -> NoReturn:
        of_column = "" if column is None else f", column {shown(self._form.names[column])}"
        raise RecordingFormatError(f"{self._where} {row}{of_column}: {expected}; {got}")


@lru_cache(maxsize=1)
def _csv_of_arrow() -> "Callable[[str, int, str, str], _Numbers | None] | None":
    """Return what reads a block of columns of numbers by pyarrow, where it is installed; None elsewhere."""
    try:
        import pyarrow as pa  # noqa: PLC0415
        import pyarrow.csv as arrow_csv  # noqa: PLC0415
    except ModuleNotFoundError:
        return None

    def read(text: str, n_columns: int, separator: str, decimal: str) -> _Numbers | None:
        names = [str(i) for i in range(n_columns)]
        content = text.encode("ascii")
        try:
            table = arrow_csv.read_csv(
                pa.BufferReader(content),
                read_options=arrow_csv.ReadOptions(use_threads=False, column_names=names, block_size=len(content) + 1),
                parse_options=arrow_csv.ParseOptions(delimiter=separator, quote_char=False, ignore_empty_lines=False),
                convert_options=arrow_csv.ConvertOptions(
                    check_utf8=False, column_types=dict.fromkeys(names, pa.float64()), null_values=[],
                    decimal_point=decimal,
                ),
            )  # fmt: skip
        except pa.ArrowInvalid:
            return None
        if table.num_rows != text.count("\n") + 1:  # a blank text has no rows
            return None
        return {i: (column.to_numpy(), None) for i, column in enumerate(table.columns)}

    return read


def _quoted_rows(lines: list[str], separator: str | None) -> list[list[str]]:
    """Return the cells of rows, all at once where no quote is left open."""
    if separator is not None:
        try:
            rows = list(csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True))
        except csv.Error:
            rows = []
        if len(rows) == len(lines):
            return rows
    return [split_cells(line, separator) for line in lines]


def _step(cells: list[str], row: int, otherwise: str) -> str:
    """Say what is to be done with a row that does not fit, by whether there are numbers in it."""
    has_numbers = any(is_number(cell, "") for cell in cells[:MAX_COLUMNS] if cell)
    return otherwise if has_numbers else f"remove row {row}, which holds no numbers"


def _shared(texts: list[str], earlier: list[str]) -> list[str]:
    """Return the texts, with one object for those that follow each other and are equal, as dates are."""
    last = earlier[-1] if earlier else ""
    for i, text in enumerate(texts):
        if text == last:
            texts[i] = last
        else:
            last = text
    return texts
