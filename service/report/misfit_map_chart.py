"""Draw where model and measurement differ: the misfit by setting and frequency band."""

import math
from itertools import pairwise
from typing import Final

from markupsafe import Markup

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy import MisfitMap
from service.report.rounding import rounded
from service.report.svg import CHARACTER, element, joined, label, picture, shortened

#: Where the shade changes, in standard deviations; the style sheet holds one shade more.
LEVELS: Final = (1.25, 2.0, 3.0, 5.0, 10.0, 20.0)

_WIDTH = 600.0
_LONGEST_ROW = 34  # characters
_LONGEST_COLUMN = 16
_ROW = 22.0
_NARROWEST_WITH_NUMBER = 27.0
_NARROWEST_WITH_NAME = 17.0  # of a slanted one; in narrower columns some are left to pointing at a cell


def misfit_map_chart(name: str, title: str, shown: MisfitMap, misfit: FloatArray) -> Markup:
    """Draw a map; each cell says its misfit in a number where there is room, and always when it is pointed at.

    ``misfit`` is what the map has ``before`` or ``after``, shape (n_rows, n_columns); ``name`` is unique on the page.
    """
    left = 12.0 + CHARACTER * min(_LONGEST_ROW, max((len(row) for row in shown.rows), default=0))
    cell = min((_WIDTH - left) / max(len(shown.columns), 1), 90.0)
    longest = min(_LONGEST_COLUMN, max((len(column) for column in shown.columns), default=0))
    slanted = longest * CHARACTER > cell - 4.0
    top = 12.0 + (0.7 * CHARACTER * longest if slanted else 12.0)
    every = math.ceil(_NARROWEST_WITH_NAME / cell)
    drawn = [
        _column_label(words, left + (i + 0.5) * cell, top - 6.0, slanted)
        for i, words in enumerate(shown.columns)
        if i % every == 0
    ]
    for i, words in enumerate(shown.rows):
        y = top + i * _ROW
        drawn.append(_titled(words, label(shortened(words, _LONGEST_ROW), left - 8.0, y + 15.0, text_anchor="end")))
        for j, column in enumerate(shown.columns):
            drawn.append(_cell(f"{words}, {column}", float(misfit[i, j]), left + j * cell, y, cell))
    overhang = 0.7 * CHARACTER * longest if slanted else 0.0
    width, height = left + len(shown.columns) * cell + overhang, top + len(shown.rows) * _ROW + 2.0
    return picture(width, height, name, title, _description(shown, misfit), *drawn)


def shade(misfit: float) -> str:
    """Return the class of the style sheet for a misfit."""
    return "nothing" if math.isnan(misfit) else f"shade{sum(misfit >= level for level in LEVELS)}"


def shade_names() -> list[tuple[str, str]]:
    """Return each shade with the misfits it stands for."""
    ends = [f"{level:g}" for level in LEVELS]
    between = [f"{lower} to {upper}" for lower, upper in pairwise(ends)]
    return [(f"shade{i}", words) for i, words in enumerate([f"below {ends[0]}", *between, f"{ends[-1]} and more"])]


def _cell(where: str, misfit: float, x: float, y: float, width: float) -> Markup:
    words = f"{where}: no data" if math.isnan(misfit) else f"{where}: {rounded(misfit)} σ"
    parts = [element("rect", x=x + 1.0, y=y + 1.0, width=width - 2.0, height=_ROW - 2.0, class_=shade(misfit))]
    if width >= _NARROWEST_WITH_NUMBER:
        parts.append(
            label(_short(misfit), x + width / 2.0, y + 15.0, text_anchor="middle", class_=f"on-{shade(misfit)}")
        )
    return _titled(words, *parts)


def _short(misfit: float) -> str:
    if math.isnan(misfit):
        return "–"
    return f"{misfit:.1f}" if misfit < 9.95 else f"{misfit:.0f}" if misfit < 9999.5 else f"{misfit:.0e}"


def _column_label(words: str, x: float, y: float, slanted: bool) -> Markup:
    text = shortened(words, _LONGEST_COLUMN)
    if not slanted:
        return _titled(words, label(text, x, y, text_anchor="middle"))
    return _titled(words, label(text, x, y, transform=f"rotate(-45 {x:.1f} {y:.1f})"))


def _titled(words: str, *parts: Markup) -> Markup:
    return element("g", element("title", words), joined(parts))


def _description(shown: MisfitMap, misfit: FloatArray) -> str:
    known = [
        (float(misfit[i, j]), f"{row}, {column}")
        for i, row in enumerate(shown.rows)
        for j, column in enumerate(shown.columns)
        if not math.isnan(misfit[i, j])
    ]
    if not known:
        return "No data."
    worst, where = max(known)
    return f"Root-mean-square misfit in standard deviations. The largest is {rounded(worst)}, at {where}."
