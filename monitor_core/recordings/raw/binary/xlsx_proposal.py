"""Propose where the columns of a workbook stand that has titles above them, units, or several sheets."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.binary import xlsx
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.proposal import propose_for_cells

if TYPE_CHECKING:
    from openpyxl.worksheet._read_only import ReadOnlyWorksheet as Sheet

_MOST_ROWS = 400


def propose_layout(path: Path) -> TextLayout | None:
    """Propose a layout that reads a workbook; ``None`` if there is none. It is for a person to confirm."""
    with xlsx.opened(path) as book:
        sheets = {sheet.title: _cells(sheet, path.name) for sheet in xlsx.sheets_of(book)}
    filled = {title: rows for title, rows in sheets.items() if rows}
    for title, rows in sorted(filled.items(), key=lambda sheet: -len(sheet[1])):
        layout = propose_for_cells(rows)
        if layout is None:
            continue
        proposed = replace(layout, sheet=title if len(filled) > 1 else None)
        try:
            xlsx.read_channels(path, proposed)
        except RecordingFormatError:
            continue
        return proposed
    return None


def _cells(sheet: "Sheet", where: str) -> Sequence[Sequence[str]]:
    """Return the first rows of a sheet as texts, those without a cell, too: rows are known by their numbers."""
    found: list[list[str]] = []
    for number, cells in islice(xlsx.rows_of(sheet, where), _MOST_ROWS):
        if number > _MOST_ROWS:
            break
        found += [[] for _ in range(number - 1 - len(found))]
        texts = ["" if cell is None else " ".join(str(cell).split()) for cell in cells]
        while texts and not texts[-1]:
            texts.pop()
        found.append(texts)
    return found
