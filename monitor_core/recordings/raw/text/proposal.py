"""Propose how a text file of columns is written, for a person to confirm; and say in what it is not plain."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_file, utf16_codec
from monitor_core.recordings.elements.units import canonical_unit
from monitor_core.recordings.raw.text.layout import DECIMALS, SEPARATORS, TextLayout, is_bracketed, time_columns
from monitor_core.recordings.raw.text.table import (
    MAX_COLUMNS,
    Rows,
    has_thousands,
    is_number,
    require_utf8,
    shown,
    split_cells,
)

_HEAD = 2**18
_TAIL = 2**12
_MOST_ROWS = 400
_MOST_CELLS = 20_000  # looked at for each way to write a table
_FEWEST_ROWS = 2
#: The errors of a spreadsheet (#NV, #N/A, #DIV/0!, #WERT!) begin no comment: they stand for a missing number.
_COMMENT = re.compile(r"#+(?!N/?[AV]\b|(?:NUM|DIV/0|REF|VALUE|NAME|WERT|ZAHL|BEZUG)[!?])|%+|//|!|\*+|;(?=\s*\D)")
_WORD = re.compile(r"[^\W\d_][^\s;,\t]{0,19}")
_MOMENT = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}:\d\d", re.ASCII)
_LETTER = re.compile(r"[^\W\d_]|[µ°%]")
#: Spellings of units in rows of them, besides those that the product converts.
_UNITS = frozenset((
    "rpm", "1/min", "u/min", "min-1", "deg", "°", "°c", "c", "degc", "k", "%", "hz", "khz", "bar", "pa", "mpa",
    "w", "kw", "rad", "rad/s", "m/s", "mm/s", "mm/min", "m/min", "ns", "min", "h", "-", "1", "counts", "inc",
    "lsb", "nm", "a", "v", "arms", "vrms", "second", "seconds", "sec", "volt", "volts", "ampere", "newton",
    "mv", "lbf", "ft", "in", "kg",
))  # fmt: skip


@dataclass(frozen=True, slots=True)
class TextProposal:
    """How a file seems to be written, and in what that is not plain; without reasons the plain reader takes it."""

    layout: TextLayout
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Reading:
    """Rows that fit each other, if the file is written in one way."""

    separator: str  # word of the layout
    decimal: str  # word of the layout
    begin: int  # index of the first row of numbers
    end: int  # behind the last of them
    n_cells: int
    n_texts: int
    n_numbers: int

    @property
    def sign(self) -> str | None:
        """The separator itself."""
        return SEPARATORS[self.separator]

    def layout(self, heads: tuple[int | None, int | None]) -> TextLayout:
        """Return the rows as a layout names them; ``heads``: where names and units stand."""
        header, units = heads
        return TextLayout(
            header_row=0 if header is None else header + 1,
            unit_row=None if units is None else units + 1,
            first_row=self.begin + 1,
        )


def plain_separator(line: str) -> str | None:
    """Return the first of tab, semicolon and comma that a line contains; ``None`` for blanks."""
    return next((sign for sign in SEPARATORS.values() if sign is not None and sign in line), None)


def propose_for_cells(rows: Sequence[Sequence[str]]) -> TextLayout | None:
    """Propose where names, units and numbers stand in rows of cells, as of a sheet; ``None`` where none are numbers.

    A row that fills less than half of the columns is a title.
    """
    width = max((len(row) for row in rows), default=0)
    lines = [
        "\t".join([*row, *[""] * (width - len(row))] if 2 * sum(map(bool, row)) >= width else [" ".join(row)])
        for row in rows
    ]
    reading = _reading(lines, "tab", "point")
    return None if reading is None else reading.layout(_heads(lines, reading))


def propose(path: Path) -> TextProposal:
    """Propose a layout, and say in what the text is not plain.

    The first 256 KiB and the end of the file are looked at. It is a proposal, for a person to confirm in a channel map;
    no reader applies it by itself. ``RecordingFormatError`` if no rows of numbers are found.
    """
    encoding = _encoding(path)
    lines = Rows(path, encoding).ahead(_MOST_ROWS)
    while len(lines) > 1 and not lines[-1].strip():
        lines.pop()
    readings = [reading for way in _ways(lines) if (reading := _reading(lines, *way)) is not None]
    if not readings:
        raise RecordingFormatError(
            f"{path.name}: expected rows of numbers; found none in the first {len(lines)} rows: it is no text "
            "of columns, or of columns that no entry of [text] describes"
        )
    heads_of = [(reading, _heads(lines, reading)) for reading in readings]
    best, heads = max(heads_of, key=lambda way: _rank(way[0], has_names=way[1][0] is not None))
    layout = replace(
        best.layout(heads), separator=best.separator, decimal=best.decimal, encoding=encoding,
        comment=_comment(lines, best, heads[0], path),
    )  # fmt: skip
    return TextProposal(layout, _reasons(lines, best, layout))


def _rank(reading: _Reading, *, has_names: bool) -> tuple[int, ...]:
    """Return what to compare: long tables first, then such with few texts, with names, and with many numbers."""
    single_blank = reading.n_cells == 1 and reading.separator == "blank"
    return reading.end - reading.begin, -reading.n_texts, has_names, reading.n_numbers, single_blank


def _encoding(path: Path) -> str:
    with require_file(path).open("rb") as stream:
        head = stream.read(_HEAD)
    if utf16_codec(head) is not None:
        return "utf-16"
    if head.count(0):
        raise RecordingFormatError(f"{path.name}: expected text; byte {head.index(0)} is 0x00")
    try:
        require_utf8(path)
    except RecordingFormatError:
        strange = sum(byte < 9 or 13 < byte < 32 or 127 <= byte < 160 for byte in head)
        if strange > len(head) // 100:
            raise
        return "latin-1"
    return "utf-8"


def _ways(lines: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the ways in which the rows may be written: words for separator and decimal sign."""
    some = "\n".join(lines)
    for word, sign in SEPARATORS.items():
        if sign is None or sign in some:
            yield word, "point"
            if "," in some and (word != "comma" or '"' in some):
                yield word, "comma"


def _kinds(line: str, separator: str | None, decimal: str) -> str:
    """Return a letter for each cell: number, text, or blank."""
    cells = split_cells(line, separator)
    sign = DECIMALS[decimal]
    return "".join(
        "B" if not cell else "N" if is_number(cell, sign) or has_thousands(cell, sign) else "T" for cell in cells
    )


def _n_cells(line: str, separator: str | None) -> int:
    return len(line.split()) if separator is None else line.count(separator) + 1


def _reading(lines: Sequence[str], separator: str, decimal: str) -> _Reading | None:
    """Return the longest table, of several the last, if the file is written in one way; None if there is none."""
    sign, n_cells_seen = SEPARATORS[separator], 0
    best: _Reading | None = None
    begin, merged, n_rows = 0, "", 0  # of the table that is being read: merged kinds of its cells
    for i, line in enumerate(lines):
        n_cells = _n_cells(line, sign)
        n_cells_seen += min(n_cells, MAX_COLUMNS)
        if n_cells_seen > _MOST_CELLS and i > _FEWEST_ROWS:
            break
        if n_rows and _comment_sign(line, sign):  # comments may stand between the rows
            continue
        kinds = _kinds(line, sign, decimal) if 0 < n_cells <= MAX_COLUMNS + 1 else ""
        fit = _merged(merged, kinds) if n_rows else None
        if fit is not None:
            merged, n_rows = fit, n_rows + 1
        elif n_rows >= _FEWEST_ROWS and i + 1 < len(lines) and _goes_on(merged, lines[i + 1], sign, decimal):
            continue  # one row that does not fit, which the reader refuses by its number
        elif "N" in kinds:
            begin, merged, n_rows = i, kinds, 1
        else:
            n_rows = 0
            continue
        cells = merged[:-1].upper() if len(merged) > 1 and merged[-1] == "B" else merged.upper()
        n_texts = cells.count("T")
        if n_texts and n_rows < _FEWEST_ROWS:  # prose has numbers, too
            continue
        if best is None or i + 1 - begin >= best.end - best.begin:
            best = _Reading(separator, decimal, begin, i + 1, len(cells), n_texts, cells.count("N"))
    return best


def _goes_on(merged: str, line: str, sign: str | None, decimal: str) -> bool:
    """Tell whether a row is of the table of the rows above it."""
    return _n_cells(line, sign) <= len(merged) + 1 and _merged(merged, _kinds(line, sign, decimal)) is not None


def _merged(kinds: str, others: str) -> str | None:
    """Return what the cells of two rows are together; ``None`` if the rows are of different tables.

    A small letter says that some cells of the column are blank.
    """
    if len(kinds) != len(others):
        longer, shorter = (kinds, others) if len(kinds) > len(others) else (others, kinds)
        if len(longer) - len(shorter) > 1 or longer[-1] != "B":
            return None
        kinds, others = longer, f"{shorter}B"
    merged = []
    for a, b in zip(kinds, others, strict=True):
        if a == "B" or b == "B":
            merged.append("B" if a == b else (a if b == "B" else b).lower())
        elif a.upper() == b:
            merged.append(a)
        else:
            return None
    return "".join(merged)


def _heads(lines: Sequence[str], reading: _Reading) -> tuple[int | None, int | None]:
    """Return where the names and the units stand above the numbers."""
    candidates = list(_rows_above(lines, reading))
    for number, (i, cells) in enumerate(candidates):
        above = next((row for row, names in candidates[number + 1 : number + 2] if _are_names(names)), None)
        if above is not None and (_are_units(cells) or _repeat(cells)):
            return above, i
        if _are_names(cells) or time_columns(cells):
            return i, None
    return None, None


def _rows_above(lines: Sequence[str], reading: _Reading) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of words above the numbers that have as many cells, from the lowest on."""
    has_row = False
    for i in range(reading.begin - 1, max(reading.begin - 8, -1), -1):
        line = _without_comment(lines[i], reading.sign)
        if not line.strip():
            continue
        cells = split_cells(line, reading.sign)
        if len(cells) == reading.n_cells + 1 and not cells[-1]:
            cells.pop()
        if len(cells) != reading.n_cells:
            if has_row:
                return
            continue
        if any(is_number(cell, "") for cell in cells):  # a table above this one
            return
        if any(_LETTER.search(cell) for cell in cells):
            has_row = True
            yield i, cells


def _comment_sign(line: str, separator: str | None) -> str:
    """Return the sign of a comment that a line begins with, "" for none; a separator is no such sign."""
    match = _COMMENT.match(line)
    return "" if match is None or match.group() == separator else match.group()


def _without_comment(line: str, separator: str | None) -> str:
    return line.removeprefix(_comment_sign(line, separator))


def _are_names(cells: Sequence[str]) -> bool:
    named = [cell for cell in cells if cell]
    differ = len(set(named)) == len(named) or time_columns(cells) is not None
    return bool(named) and differ and all(_LETTER.search(cell) and not is_number(cell, "") for cell in named)


def _are_units(cells: Sequence[str]) -> bool:
    named = [cell for cell in cells if cell]
    return bool(named) and all(
        is_bracketed(cell) or canonical_unit(cell) is not None or cell.lower() in _UNITS for cell in named
    )


def _repeat(cells: Sequence[str]) -> bool:
    named = [cell for cell in cells if cell]
    return len(set(named)) < len(named)


def _comment(lines: Sequence[str], reading: _Reading, header: int | None, path: Path) -> str | None:
    """Return how the lines begin that are to be left out among or below the numbers, or ahead of the names."""
    may_be_comments = [*lines[reading.begin :], *([] if header is None else [lines[header]])]
    signs = (_comment_sign(line, reading.sign) for line in may_be_comments)
    if sign := next(filter(None, signs), None):
        return sign
    for line in lines[reading.end :] if reading.end < len(lines) else _last_row(path):
        if word := _WORD.match(line.strip().strip('"')):
            return line[: line.index(word.group()) + len(word.group())]
    return None


def _last_row(path: Path) -> list[str]:
    """Return the last row of a file, if it is a single ASCII cell that begins with a letter."""
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - _TAIL, 0))
        rows = stream.read(_TAIL).rstrip().splitlines()
    is_one = len(rows) >= _FEWEST_ROWS and rows[-1].isascii() and re.match(rb"[A-Za-z#][^,;\t]*\Z", rows[-1])
    return [rows[-1].decode("ascii")] if is_one else []


def _reasons(lines: Sequence[str], reading: _Reading, layout: TextLayout) -> tuple[str, ...]:
    """Return in what a file is not plain; nothing where the plain reader takes it."""
    header_row = layout.header_row or 0
    reasons = (*_reasons_above(lines, reading, layout), *_reasons_in_table(lines, reading, layout))
    comment = layout.comment
    if len(reasons) == 1 and header_row == 1 and comment and not any(line.startswith(comment) for line in lines[1:]):
        return ()  # the names begin with the sign, and nothing else does: "# t"
    return reasons


def _reasons_above(lines: Sequence[str], reading: _Reading, layout: TextLayout) -> Iterator[str]:
    header_row = layout.header_row or 0
    n_above = (header_row or reading.begin + 1) - 1
    if layout.encoding != "utf-8":
        yield "the encoding UTF-16" if layout.encoding == "utf-16" else "letters in Latin-1"
    if n_above:
        yield f"{n_above} row{'s' if n_above > 1 else ''} above its {'names' if header_row else 'numbers'}"
    elif not header_row and _kinds(lines[0], reading.sign, reading.decimal).count("N") < reading.n_numbers:
        yield "no names of its columns"
    if layout.unit_row is not None:
        yield "a row of units"
    if header_row and reading.begin > max(header_row, layout.unit_row or 0):
        yield "rows between names and numbers"


def _reasons_in_table(lines: Sequence[str], reading: _Reading, layout: TextLayout) -> Iterator[str]:
    sign, table = reading.sign, lines[reading.begin : reading.end]
    name = "blanks" if sign is None else reading.separator
    at_top = (layout.header_row or reading.begin + 1) == 1
    if layout.decimal == "comma":
        yield "decimal commas"
    if plain_separator(lines[0]) != sign and at_top and reading.n_cells > 1:
        yield f"the separator {name}"
    if any('"' in line for line in table):
        yield "cells in quotes"
    if sign is not None and reading.n_cells < table[0].count(sign) + 1 and table[0].rstrip(" ").endswith(sign):
        yield f"a {name} at the end of each row"
    if reading.n_texts:
        yield _texts(lines, reading, layout)
    if layout.comment is not None:
        yield f"rows that begin with {layout.comment!r}"


def _texts(lines: Sequence[str], reading: _Reading, layout: TextLayout) -> str:
    """Say which columns hold texts, and whether these are dates and times."""
    header = lines[layout.header_row - 1] if layout.header_row else ""
    names = dict(enumerate(split_cells(_without_comment(header, reading.sign), reading.sign) if header else []))
    row = lines[reading.begin]
    cells = dict(enumerate(split_cells(row, reading.sign)))
    texts = [i for i, kind in enumerate(_kinds(row, reading.sign, reading.decimal)) if kind == "T"]
    word = "dates and times" if all(_MOMENT.match(cells[i]) for i in texts) else "texts"
    named = [shown(names.get(i, str(i + 1))) for i in texts[:3]] + (["…"] if len(texts) > 3 else [])
    return f"{word} in column{'s' if len(texts) > 1 else ''} {', '.join(named)}"
