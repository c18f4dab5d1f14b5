"""Read samples from text columns: ``*.csv``, ``*.txt``, ``*.tsv``.

The separator is the first of tab, semicolon and comma that the first line contains (blanks, if none). A first line of
numbers alone means a file without a header: the columns are then named "1", "2", …. Decimals carry a point: a decimal
comma is refused, never guessed. The text is UTF-8, with or without byte order mark, with any line end.
"""

from pathlib import Path

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import read_text, require_plausible_length
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples

_SEPARATORS = ("\t", ";", ",")
SEPARATOR_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma", None: "blank"}


def read_channels(path: Path) -> Channels:
    """Read columns of numbers; the file states neither units nor a time base (a column of times is a channel).

    Every row has as many numbers as the first line has names. ``RecordingFormatError`` if a cell is no number, if rows
    are of unequal length, or if two columns have one name.
    """
    lines = read_text(path).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise RecordingFormatError(f"{path.name}: expected columns of numbers; the file is blank")
    separator = next((s for s in _SEPARATORS if s in lines[0]), None)
    cells = [cell.strip() for cell in lines[0].split(separator)]
    has_header = not all(is_number(cell) for cell in cells)
    names = cells if has_header else [str(number) for number in range(1, len(cells) + 1)]
    _require_distinct(names, path.name)
    first_row = 1 if has_header else 0
    require_plausible_length((len(lines) - first_row) * len(names), path.name)
    table = _table(lines[first_row:], separator, names, f"{path.name}, row", first_row + 1)
    return Channels(path.name, tuple(Channel(n, native_samples(table[:, i])) for i, n in enumerate(names)))


def is_number(text: str) -> bool:
    """Tell whether a cell is a number with a decimal point (Python alone would also take ``1_000``)."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _require_distinct(names: list[str], where: str) -> None:
    for name in names:
        if not name:
            raise RecordingFormatError(f"{where}: expected a name for each column; got {', '.join(map(repr, names))}")
        if names.count(name) > 1:
            raise RecordingFormatError(f"{where}: expected columns of different names; got {name!r} twice")


def _table(lines: list[str], separator: str | None, names: list[str], where: str, first_row: int) -> FloatArray:
    if not lines:
        raise RecordingFormatError(f"{where} {first_row}: expected numbers under the header; got none")
    try:
        table = np.loadtxt(lines, delimiter=separator, ndmin=2, comments=None, dtype=np.float64)
    except ValueError:
        table = None
    # loadtxt skips blank lines in silence and names rows its own way: what does not fit is looked for line by line
    if table is None or table.shape != (len(lines), len(names)):
        raise RecordingFormatError(_first_misfit(lines, separator, names, where, first_row))
    return table


def _first_misfit(lines: list[str], separator: str | None, names: list[str], where: str, first_row: int) -> str:
    for row, line in enumerate(lines, start=first_row):
        cells = [cell.strip() for cell in line.split(separator)]
        if len(cells) != len(names):
            return (f"{where} {row}: expected {len(names)} numbers separated by {SEPARATOR_NAMES[separator]}; "
                    f"got {len(cells)}")  # fmt: skip
        for name, cell in zip(names, cells, strict=True):
            if not is_number(cell):
                return f"{where} {row}, column {name!r}: expected a number with a decimal point; got {cell[:40]!r}"
    return f"{where} {first_row}: expected a table of {len(names)} columns of numbers"
