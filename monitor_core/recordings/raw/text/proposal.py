"""Propose how a text file of columns is written, for a person to confirm; and say why the plain reader refuses it."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_file, utf16_codec
from monitor_core.recordings.elements.units import canonical_unit
from monitor_core.recordings.raw.text import csv_samples, lvm, siemens_trace, twincat
from monitor_core.recordings.raw.text.layout import SEPARATORS, TextLayout
from monitor_core.recordings.raw.text.rows import Rows, shown, split_cells
from monitor_core.recordings.raw.text.table import MAX_COLUMNS, is_number

_HEAD = 2**18
_TAIL = 2**12
_MOST_ROWS = 400
_MOST_CELLS = 20_000  # looked at for each way to write a table
_FEWEST_ROWS = 2
_BOM_8 = b"\xef\xbb\xbf"
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
_NAMES_OF_SEPARATORS = {"tab": "tab", "semicolon": "semicolon", "comma": "comma", "blank": "blanks"}


@dataclass(frozen=True, slots=True)
class Proposal:
    """How a file seems to be written, and in what that is not plain."""

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


def propose(path: Path) -> Proposal | None:
    """Propose a layout; ``None`` where the reader takes the file without one."""
    found = _proposal(path)
    return found if found is not None and found.reasons else None


def propose_for_blanks(path: Path) -> TextLayout | None:
    """Propose a layout for a file that is plain but for blank cells, which are NaN; ``None`` if that does not help."""
    found = _proposal(path)
    if found is None:
        return None
    try:
        csv_samples.read_channels(path, found.layout)
    except RecordingFormatError:
        return None
    return found.layout


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
    if reading is None:
        return None
    header, units = _heads(lines, reading)
    return TextLayout(
        header_row=0 if header is None else header + 1,
        unit_row=None if units is None else units + 1,
        first_row=reading.begin + 1,
    )


def _proposal(path: Path) -> Proposal | None:
    """Return a layout and in what it is not plain, which may be nothing; ``None`` for exports of known programs."""
    head = _head(path)
    if lvm.is_lvm(head) or twincat.is_twincat(head):
        return None
    encoding = _encoding(path, head)
    lines = _lines(path, encoding)
    readings = [
        reading for separator, decimal in _ways(lines) if (reading := _reading(lines, separator, decimal)) is not None
    ]
    if not readings:
        raise RecordingFormatError(
            f"{path.name}: expected rows of numbers; found none in the first {len(lines)} rows: it is no text "
            "of columns, or of columns that no entry of [text] describes"
        )
    best, (header, units) = max(
        ((reading, _heads(lines, reading)) for reading in readings), key=lambda found: _rank(found[0], found[1][0])
    )
    comment = _comment(lines, best, header, path)
    layout = TextLayout(
        separator=best.separator,
        decimal=best.decimal,
        header_row=0 if header is None else header + 1,
        unit_row=None if units is None else units + 1,
        first_row=best.begin + 1,
        comment=comment,
        encoding=encoding,
    )
    return Proposal(layout, _reasons(lines, best, layout))


def _rank(reading: _Reading, header: int | None) -> tuple[int, ...]:
    """Return what to compare: long tables first, then such with few texts, with names, and with many numbers."""
    single_blank = reading.n_cells == 1 and reading.separator == "blank"
    return reading.end - reading.begin, -reading.n_texts, header is not None, reading.n_numbers, int(single_blank)


def refusal(path: Path, plain: str) -> str:
    """Return why a file is refused and the step that goes on; ``plain``: what the reader without a layout says.

    The command that writes a map is named only where the layout that it proposes reads the file: else the refusal is
    that of the layout, which says what is to be done in the file.
    """
    try:
        found = _proposal(path)
    except RecordingFormatError:
        return plain
    if found is None:
        return plain
    command = f"`preload check {path.name} --write-map MAP`"
    try:
        csv_samples.read_channels(path, found.layout)
    except RecordingFormatError as error:
        if found.layout.encoding != "utf-8":
            return f"{plain}; in {found.reasons[0].removeprefix('letters in ')}: {error}"
        return str(error) if found.reasons else plain
    reasons = found.reasons or ("cells without a number",)
    return f"{plain}; the file has {_listed(reasons)}: {command} writes a channel map with a table [text] that says so"


def _listed(reasons: Sequence[str]) -> str:
    return reasons[0] if len(reasons) == 1 else f"{', '.join(reasons[:-1])} and {reasons[-1]}"


def _head(path: Path) -> bytes:
    with require_file(path).open("rb") as stream:
        return stream.read(_HEAD)


def _encoding(path: Path, head: bytes) -> str:
    if utf16_codec(head) is not None:
        return "utf-16"
    if head.count(0):
        raise RecordingFormatError(f"{path.name}: expected text; byte {head.index(0)} is 0x00")
    try:
        for _ in Rows(path).blocks():
            pass
    except RecordingFormatError:
        strange = sum(byte < 9 or 13 < byte < 32 or 127 <= byte < 160 for byte in head)
        if strange > len(head) // 100:
            raise
        return "latin-1"
    return "utf-8"


def _lines(path: Path, encoding: str) -> list[str]:
    rows = Rows(path, encoding)
    lines = rows.ahead(_MOST_ROWS)
    while len(lines) > 1 and not lines[-1].strip():
        lines = lines[:-1]
    return lines


def _ways(lines: list[str]) -> list[tuple[str, str]]:
    """Return the ways in which the rows may be written: words for separator and decimal sign."""
    some = "\n".join(lines)
    ways = [
        (word, decimal)
        for word, sign in SEPARATORS.items()
        for decimal in ("point", "comma")
        if (sign is None or sign in some) and (decimal == "point" or "," in some)
    ]
    return [way for way in ways if way != ("comma", "comma") or '"' in some]


def _kinds(line: str, separator: str | None, decimal: str) -> str:
    """Return a letter for each cell: number, text, or blank."""
    kinds = []
    for cell in split_cells(line, separator):
        number = cell if decimal == "point" else "x" if "." in cell else cell.replace(",", ".")
        kinds.append("B" if not cell else "N" if is_number(number) else "T")
    return "".join(kinds)


def _reading(lines: list[str], separator: str, decimal: str) -> _Reading | None:
    sign, n_cells_seen = SEPARATORS[separator], 0
    best: _Reading | None = None
    begin, merged, n_rows = 0, "", 0
    last = 0
    for i, line in enumerate(lines):
        n_cells = len(line.split()) if sign is None else line.count(sign) + 1
        n_cells_seen += min(n_cells, MAX_COLUMNS)
        if n_cells_seen > _MOST_CELLS and i > _FEWEST_ROWS:
            break
        if _comment_sign(line, sign) and n_rows:  # comments may stand between the rows
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
        last = i
        cells = merged[:-1].upper() if len(merged) > 1 and merged[-1] == "B" else merged.upper()
        n_texts, n_numbers = cells.count("T"), cells.count("N")
        if n_texts and n_rows < _FEWEST_ROWS:  # prose has numbers, too
            continue
        found = _Reading(separator, decimal, begin, last + 1, len(cells), n_texts, n_numbers)
        if best is None or found.end - found.begin >= best.end - best.begin:
            best = found
    return best


def _goes_on(before: str, line: str, sign: str | None, decimal: str) -> bool:
    """Tell whether a row is of the table of rows before it."""
    n_cells = len(line.split()) if sign is None else line.count(sign) + 1
    return n_cells <= len(before) + 1 and _merged(before, _kinds(line, sign, decimal)) is not None


def _merged(before: str, kinds: str) -> str | None:
    """Return what the cells of two rows are together; ``None`` if the rows are of different tables.

    A small letter says that some cells of the column are blank.
    """
    if len(before) != len(kinds):
        longer, shorter = (before, kinds) if len(before) > len(kinds) else (kinds, before)
        if len(longer) - len(shorter) > 1 or longer[-1] != "B":
            return None
        before, kinds = longer, f"{shorter}B"
    merged = []
    for a, b in zip(before, kinds, strict=True):
        if a == "B" or b == "B":
            merged.append("B" if a == b else (a if b == "B" else b).lower())
        elif a.upper() == b:
            merged.append(a)
        else:
            return None
    return "".join(merged)


def _heads(lines: list[str], reading: _Reading) -> tuple[int | None, int | None]:
    """Return where the names and the units stand above the numbers."""
    sign = SEPARATORS[reading.separator]
    candidates: list[tuple[int, list[str]]] = []
    for i in range(reading.begin - 1, max(reading.begin - 8, -1), -1):
        line = _without_comment(lines[i], sign)
        if not line.strip():
            continue
        cells = split_cells(line, sign)
        if len(cells) == reading.n_cells + 1 and not cells[-1]:
            cells.pop()
        if len(cells) != reading.n_cells:
            if candidates:
                break
            continue
        if any(is_number(cell.replace(",", ".")) for cell in cells):  # a table above this one
            break
        if any(_LETTER.search(cell) for cell in cells):
            candidates.append((i, cells))
    for number, (i, cells) in enumerate(candidates):
        above = candidates[number + 1 :]
        if _are_units(cells) and above and _are_names(above[0][1]):
            return above[0][0], i
        if _are_names(cells) or siemens_trace.time_columns(cells):
            if above and _repeat(cells) and _are_names(above[0][1]):
                return above[0][0], i
            return i, None
        if above and _repeat(cells) and _are_names(above[0][1]):
            return above[0][0], i
    return None, None


def _comment_sign(line: str, separator: str | None) -> str:
    """Return the sign of a comment that a line begins with, "" for none; a separator is no such sign."""
    found = _COMMENT.match(line)
    return "" if found is None or found.group() == separator else found.group()


def _without_comment(line: str, separator: str | None) -> str:
    return line.removeprefix(_comment_sign(line, separator))


def _are_names(cells: list[str]) -> bool:
    named = [cell for cell in cells if cell]
    times = siemens_trace.time_columns(cells) is not None
    return (
        bool(named)
        and (len(set(named)) == len(named) or times)
        and all(_LETTER.search(cell) and not is_number(cell.replace(",", ".")) for cell in named)
    )


def _are_units(cells: list[str]) -> bool:
    named = [cell for cell in cells if cell]
    return bool(named) and all(
        siemens_trace.is_bracketed(cell) or canonical_unit(cell) is not None or cell.lower() in _UNITS for cell in named
    )


def _repeat(cells: list[str]) -> bool:
    named = [cell for cell in cells if cell]
    return len(named) > 1 and len(set(named)) < len(named)


def _comment(lines: list[str], reading: _Reading, header: int | None, path: Path) -> str | None:
    """Return how the lines begin that are to be left out among or below the numbers, or ahead of the names."""
    for i in range(reading.begin, len(lines)):
        if sign := _comment_sign(lines[i], SEPARATORS[reading.separator]):
            return sign
    if header is not None and (sign := _comment_sign(lines[header], SEPARATORS[reading.separator])):
        return sign
    below = lines[reading.end :] if reading.end < len(lines) else _tail(path)
    for line in below:
        if found := _WORD.match(line.strip().strip('"')):
            return line[: line.index(found.group()) + len(found.group())]
    return None


def _tail(path: Path) -> list[str]:
    """Return the last row of a file, if it is ASCII and one that begins with a letter."""
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - _TAIL, 0))
        rows = stream.read(_TAIL).rstrip().splitlines()
    if len(rows) < _FEWEST_ROWS or not rows[-1].isascii() or not re.match(rb"[A-Za-z#]", rows[-1]):
        return []
    text = rows[-1].decode("ascii")
    return [text] if "," not in text and ";" not in text and "\t" not in text else []


def _reasons(lines: list[str], reading: _Reading, layout: TextLayout) -> tuple[str, ...]:
    """Return in what a file is not plain; nothing where the plain reader takes it."""
    header_row = layout.header_row or 0
    reasons = [*_reasons_above(lines, reading, layout), *_reasons_in_table(lines, reading, layout)]
    if len(reasons) == 1 and header_row == 1 and layout.comment is not None and not _has_comments(lines[1:], layout):
        return ()  # the names begin with the sign, and nothing else does: "# t"
    if not reasons and header_row and _repeated_times(lines[header_row - 1], SEPARATORS[reading.separator]):
        return ()
    return tuple(reasons)


def _reasons_above(lines: list[str], reading: _Reading, layout: TextLayout) -> Iterator[str]:
    header_row, n_numbers = layout.header_row or 0, reading.n_numbers
    n_above = (header_row or reading.begin + 1) - 1
    if layout.encoding != "utf-8":
        yield "the encoding UTF-16" if layout.encoding == "utf-16" else "letters in Latin-1"
    if n_above:
        yield f"{n_above} row{'s' if n_above > 1 else ''} above its {'names' if header_row else 'numbers'}"
    elif not header_row and _kinds(lines[0], SEPARATORS[reading.separator], reading.decimal).count("N") < n_numbers:
        yield "no names of its columns"
    if layout.unit_row is not None:
        yield "a row of units"
    if header_row and reading.begin > max(header_row, layout.unit_row or 0):
        yield "rows between names and numbers"


def _reasons_in_table(lines: list[str], reading: _Reading, layout: TextLayout) -> Iterator[str]:
    sign, table = SEPARATORS[reading.separator], lines[reading.begin : reading.end]
    plain = next((word for word in ("tab", "semicolon", "comma") if (SEPARATORS[word] or "") in lines[0]), "blank")
    if layout.decimal == "comma":
        yield "decimal commas"
    at_top = (layout.header_row or reading.begin + 1) == 1
    if plain != reading.separator and at_top and reading.n_cells > 1:
        yield f"the separator {_NAMES_OF_SEPARATORS[reading.separator]}"
    if any('"' in line for line in table):
        yield "cells in quotes"
    if sign is not None and reading.n_cells < table[0].count(sign) + 1 and table[0].rstrip(" ").endswith(sign):
        yield f"a {_NAMES_OF_SEPARATORS[reading.separator]} at the end of each row"
    if reading.n_texts:
        yield _texts(lines, reading, layout)
    if layout.comment is not None:
        yield f"rows that begin with {layout.comment!r}"


def _has_comments(lines: list[str], layout: TextLayout) -> bool:
    return any(line.startswith(layout.comment or "#") for line in lines)


def _texts(lines: list[str], reading: _Reading, layout: TextLayout) -> str:
    """Say which columns hold texts, and whether these are dates and times."""
    sign, header_row = SEPARATORS[reading.separator], layout.header_row or 0
    names = split_cells(_without_comment(lines[header_row - 1], sign), sign) if header_row else []
    cells = split_cells(lines[reading.begin], sign)
    kinds = _kinds(lines[reading.begin], sign, reading.decimal)
    texts = [i for i, kind in enumerate(kinds) if kind == "T"]
    moments = all(_MOMENT.match(cells[i]) for i in texts)
    named = [shown(names[i] if i < len(names) else str(i + 1)) for i in texts[:3]]
    word = "dates and times" if moments else "texts"
    return (
        f"{word} in column{'s' if len(texts) > 1 else ''} {', '.join(named)}{', …' if len(texts) > len(named) else ''}"
    )


def _repeated_times(header: str, sign: str | None) -> bool:
    cells = split_cells(header, sign)
    return siemens_trace.time_columns(cells) is not None and any(a == b for a, b in pairwise(cells[0::2]))
