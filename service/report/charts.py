"""Draw the pictures of a report: measurement against models, sizes as bars, and where the misfit lies.

Measurement against models is a small picture of many alike; bars show the gap after each step, and the pulls of what
was set and declared; the map shows the misfit by setting and frequency band.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy import GapPair
from monitor_core.shown import Panel
from service.report.rounding import quantity, rounded
from service.report.svg import (
    CHARACTER,
    Axis,
    axis_over,
    decimated,
    element,
    joined,
    label,
    path_through,
    picture,
    place_grid,
    shortened,
    value_grid,
)

#: Where the shade changes, in standard deviations; the style sheet holds one shade more.
LEVELS: Final = (1.25, 2.0, 3.0, 5.0, 10.0, 20.0)

_MAP_WIDTH = 380.0  # of a phone
_LONGEST_ROW = 16  # characters
_LONGEST_COLUMN = 18
_MAP_ROW = 22.0
_NARROWEST_WITH_NUMBER = 27.0
_NARROWEST_WITH_NAME = 17.0  # of a slanted one; in narrower columns some are left to pointing at a cell


def misfit_map_chart(name: str, title: str, rows: Sequence[str], columns: Sequence[str], misfit: FloatArray) -> Markup:
    """Draw a map; each cell says its misfit in a number where there is room, and always when it is pointed at.

    ``misfit`` has the shape (n_rows, n_columns); ``name`` is unique on the page.
    """
    left = 12.0 + CHARACTER * min(_LONGEST_ROW, max(map(len, rows), default=0))
    cell = min((_MAP_WIDTH - left - 30.0) / max(len(columns), 1), 60.0)
    longest = min(_LONGEST_COLUMN, max(map(len, columns), default=0))
    slanted = longest * CHARACTER > cell - 4.0
    top = 12.0 + (0.7 * CHARACTER * longest if slanted else 12.0)
    every = math.ceil(_NARROWEST_WITH_NAME / cell)
    drawn = [
        _column_label(words, left + (i + 0.5) * cell, top - 6.0, slanted)
        for i, words in enumerate(columns)
        if i % every == 0
    ]
    for i, words in enumerate(rows):
        y = top + i * _MAP_ROW
        drawn.append(_titled(words, label(shortened(words, _LONGEST_ROW), left - 8.0, y + 15.0, text_anchor="end")))
        for j, column in enumerate(columns):
            drawn.append(_cell(f"{words}, {column}", float(misfit[i, j]), left + j * cell, y, cell))
    overhang = 0.7 * CHARACTER * longest if slanted else 0.0
    width, height = left + len(columns) * cell + overhang, top + len(rows) * _MAP_ROW + 2.0
    return picture(width, height, name, title, _description(rows, columns, misfit), *drawn)


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
    parts = [element("rect", x=x + 1.0, y=y + 1.0, width=width - 2.0, height=_MAP_ROW - 2.0, class_=shade(misfit))]
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


def _description(rows: Sequence[str], columns: Sequence[str], misfit: FloatArray) -> str:
    known = [
        (float(misfit[i, j]), f"{row}, {column}")
        for i, row in enumerate(rows)
        for j, column in enumerate(columns)
        if not math.isnan(misfit[i, j])
    ]
    if not known:
        return "No data."
    worst, place = max(known)
    return f"Root-mean-square misfit in standard deviations. The largest is {rounded(worst)}, at {place}."


#: Bars are as wide as a phone, and their labels stand above them: nothing scrolls, nothing shrinks.
_BARS_WIDTH = 380.0
_LONGEST_LABEL = 50  # characters of a label, 370 units wide
_BESIDE = 112.0  # room for the number beside the longest bar
_BAR = 16.0
_LABEL = 18.0
_BARS_TOP = 26.0  # holds the name of the reference line


def gap_chart(name: str, title: str, rows: Sequence[tuple[str, GapPair]], noise_floor: float, unit: str) -> Markup:
    """Draw two bars a row, fitted and held out, or one where nothing was held out, and the noise floor.

    A row is what the model then is, and its gap; ``name`` is unique on the page.
    """
    sizes = [size for _, pair in rows for size in (pair.fit, pair.held_out)]
    axis = Axis(0.0, _largest([*sizes, noise_floor]), 2.0, _BARS_WIDTH - _BESIDE)
    height, bars, texts, described = _BARS_TOP, [], [], []
    for words, pair in rows:
        sizes_of = {"fitted": pair.fit, "held out": pair.held_out}
        shown = {kind: quantity(size, unit) for kind, size in sizes_of.items() if not math.isnan(size)}
        described.append(f"{words}: {', '.join(f'{size} {kind}' for kind, size in shown.items())}")
        texts.append(_row_label(words, height + 13.0))
        height += _LABEL
        for kind, size in shown.items():
            bars.append(_bar(axis, height, sizes_of[kind], f"bar {kind.replace(' ', '-')}"))
            beside = _end(axis, sizes_of[kind]) + 6.0
            texts.append(label(f"{size} {kind}", beside, height + 12.5, class_="beside"))
            height += _BAR + 2.0
        height += 8.0
    floor = f"noise floor {quantity(noise_floor, unit)}"
    reference = _reference(axis, noise_floor, height, floor)
    return picture(_BARS_WIDTH, height, name, title, "; ".join([*described, floor]), *bars, reference, *texts)


def pull_chart(name: str, pulls: Mapping[str, float]) -> Markup:
    """Draw a bar for each kind of error, and a line at 1, up to which what was stated holds."""
    axis = Axis(0.0, _largest([1.5, *map(abs, pulls.values())]), 2.0, _BARS_WIDTH - _BESIDE)
    height, bars, texts = _BARS_TOP, [], []
    for words, pull in pulls.items():
        texts.append(_row_label(words, height + 13.0))
        bars.append(_bar(axis, height + _LABEL, abs(pull), "bar fitted"))
        texts.append(label(rounded(pull, 2), _end(axis, abs(pull)) + 6.0, height + _LABEL + 12.5, class_="beside"))
        height += _LABEL + _BAR + 6.0
    description = "; ".join(f"{words}: {rounded(pull, 2)}" for words, pull in pulls.items())
    return picture(
        _BARS_WIDTH, height, name, "Pulls", description, *bars, _reference(axis, 1.0, height, "as stated"), *texts
    )


def _largest(sizes: Sequence[float]) -> float:
    return max((size for size in sizes if math.isfinite(size)), default=0.0) or 1.0


def _end(axis: Axis, size: float) -> float:
    return float(axis(size)) if math.isfinite(size) else axis.start


def _row_label(words: str, y: float) -> Markup:
    shown = label(shortened(words, _LONGEST_LABEL), 2.0, y, class_="beside")
    return element("g", element("title", words), shown)


def _bar(axis: Axis, top: float, size: float, kind: str) -> Markup:
    width = max(_end(axis, size) - axis.start, 0.0)
    return element("rect", x=axis.start, y=top, width=width, height=_BAR, class_=kind)


def _reference(axis: Axis, value: float, bottom: float, words: str) -> Markup:
    if not math.isfinite(value):
        return Markup()
    place = float(axis(value))
    line = element("line", x1=place, y1=_BARS_TOP - 6.0, x2=place, y2=bottom - 4.0, class_="reference")
    beyond = place + CHARACTER * len(words) > _BARS_WIDTH  # then it ends at the line
    anchor = "end" if beyond else "start"
    return joined([line, label(words, place, _BARS_TOP - 11.0, class_="quiet", text_anchor=anchor)])


POINTS: Final = 400  # of a line
FEW: Final = 60  # up to so many measured points are drawn one by one
#: A logarithmic picture reaches so much beyond the measurement: a zero of a model would squeeze everything else.
_BEYOND: Final = 10.0
_STYLES: Final[Mapping[str, str]] = {"before": "model before", "after": "model after"}
_PANEL_WIDTH, _PANEL_HEIGHT = 380.0, 236.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 370.0, 8.0, 194.0
_MIDDLE = (_LEFT + _RIGHT) / 2.0


def panel_chart(name: str, panel: Panel) -> Markup:
    """Draw a panel; ``name`` is unique on the page."""
    x_axis = axis_over(panel.x, 0.0, _RIGHT - _LEFT)
    y_axis = axis_of_values(panel, panel.models, _BOTTOM - _TOP, 0.0, _BEYOND)
    curves = [measured_curve(panel, x_axis, y_axis)]
    curves += [curve(panel.x, y, x_axis, y_axis, style_of(model)) for model, y in panel.models.items()]
    inside = element("svg", *curves, x=_LEFT, y=_TOP, width=_RIGHT - _LEFT, height=_BOTTOM - _TOP, overflow="hidden")
    frame = element("rect", x=_LEFT, y=_TOP, width=_RIGHT - _LEFT, height=_BOTTOM - _TOP, class_="frame")
    description = (
        f"{panel.y_name} over {panel.x_name}: measured, and the models {', '.join(panel.models)}"
        f"{'; logarithmic' if panel.logarithmic else ''}{'; not used in the fit' if panel.held_out else ''}."
    )
    return picture(
        _PANEL_WIDTH, _PANEL_HEIGHT, name, panel.title, description,
        _ticks(x_axis, y_axis), frame, inside,
        label(shortened(panel.x_name, 48), _MIDDLE, _PANEL_HEIGHT - 8.0, text_anchor="middle", class_="quiet"),
        _y_name(panel.y_name),
    )  # fmt: skip


def style_of(model: str) -> str:
    """Return the class of the style sheet for a model."""
    return _STYLES.get(model, "model other")


def axis_of_values(panel: Panel, models: Mapping[str, FloatArray], start: float, end: float, beyond: float) -> Axis:
    """Return an axis of what was measured and of models; a logarithmic one reaches so much beyond the measurement."""
    values = np.concatenate([panel.measured, *models.values()])
    if panel.logarithmic:
        seen = panel.measured[np.isfinite(panel.measured) & (panel.measured > 0.0)]
        if seen.size:
            values = np.clip(values, seen.min() / beyond, seen.max() * beyond)
    return axis_over(values, start, end, logarithmic=panel.logarithmic)


def measured_curve(panel: Panel, x_axis: Axis, y_axis: Axis) -> Markup:
    """Draw a measurement: as a line, or point by point where there are few."""
    if panel.x.size > FEW:
        return curve(panel.x, panel.measured, x_axis, y_axis, "measured")
    places = zip(x_axis(panel.x).tolist(), y_axis(panel.measured).tolist(), strict=True)
    return joined([
        element("circle", cx=x, cy=y, r=3.5, class_="measured") for x, y in places if np.isfinite(x) and np.isfinite(y)
    ])  # fmt: skip


def curve(x: FloatArray, y: FloatArray, x_axis: Axis, y_axis: Axis, style: str) -> Markup:
    """Draw a line of at most so many points that none is lost to the eye."""
    kept = decimated(y, POINTS)
    return element("path", d=path_through(x_axis(x[kept]), y_axis(y[kept])), class_=style)


def _ticks(x_axis: Axis, y_axis: Axis) -> Markup:
    """Draw the grid; the axes are those of the picture inside the frame."""
    across = replace(x_axis, start=x_axis.start + _LEFT, end=x_axis.end + _LEFT)
    upwards = replace(y_axis, start=y_axis.start + _TOP, end=y_axis.end + _TOP)
    return place_grid(across, across.ticks(5), (_TOP, _BOTTOM), 15.0) + value_grid(upwards, _LEFT, _RIGHT, 4)


def _y_name(words: str) -> Markup:
    middle = (_TOP + _BOTTOM) / 2.0
    return label(
        shortened(words, 34), 12.0, middle, text_anchor="middle", class_="quiet", transform=f"rotate(-90 12 {middle:g})"
    )
