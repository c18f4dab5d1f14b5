"""Draw measurement against models: a small picture of many alike."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from monitor_core.fitting.comparison import Panel
from service.report.rounding import tick
from service.report.svg import (
    Axis,
    axis_over,
    decimated,
    element,
    joined,
    label,
    path_through,
    picture,
    shortened,
)

POINTS: Final = 400  # of a line
_FEW: Final = 60  # up to so many measured points are drawn one by one
#: A logarithmic picture reaches so much beyond the measurement: a zero of a model would squeeze everything else.
_BEYOND: Final = 10.0
_STYLES: Final[Mapping[str, str]] = {"before": "model before", "after": "model after"}
_WIDTH, _HEIGHT = 380.0, 236.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 370.0, 8.0, 194.0


def panel_chart(name: str, panel: Panel) -> Markup:
    """Draw a panel; ``name`` is unique on the page."""
    x_axis = axis_over(panel.x, 0.0, _RIGHT - _LEFT)
    y_axis = _y_axis(panel)
    curves = [_measured(panel, x_axis, y_axis)]
    curves += [_line(panel.x, y, x_axis, y_axis, style_of(model)) for model, y in panel.models.items()]
    inside = element("svg", *curves, x=_LEFT, y=_TOP, width=_RIGHT - _LEFT, height=_BOTTOM - _TOP, overflow="hidden")
    frame = element("rect", x=_LEFT, y=_TOP, width=_RIGHT - _LEFT, height=_BOTTOM - _TOP, class_="frame")
    description = (
        f"{panel.y_name} over {panel.x_name}: measured, and the models {', '.join(panel.models)}"
        f"{'; logarithmic' if panel.logarithmic else ''}{'; not used in the fit' if panel.held_out else ''}."
    )
    return picture(
        _WIDTH, _HEIGHT, name, panel.title, description,
        _ticks(x_axis, y_axis), frame, inside,
        label(shortened(panel.x_name, 48), (_LEFT + _RIGHT) / 2.0, _HEIGHT - 8.0, text_anchor="middle", class_="quiet"),
        _y_name(panel.y_name),
    )  # fmt: skip


def style_of(model: str) -> str:
    """Return the class of the style sheet for a model."""
    return _STYLES.get(model, "model other")


def _y_axis(panel: Panel) -> Axis:
    values = np.concatenate([panel.measured, *panel.models.values()])
    if panel.logarithmic:
        seen = panel.measured[np.isfinite(panel.measured) & (panel.measured > 0.0)]
        if seen.size:
            values = np.clip(values, seen.min() / _BEYOND, seen.max() * _BEYOND)
    return axis_over(values, _BOTTOM - _TOP, 0.0, logarithmic=panel.logarithmic)


def _measured(panel: Panel, x_axis: Axis, y_axis: Axis) -> Markup:
    if panel.x.size > _FEW:
        return _line(panel.x, panel.measured, x_axis, y_axis, "measured")
    places = zip(x_axis(panel.x).tolist(), y_axis(panel.measured).tolist(), strict=True)
    return joined([
        element("circle", cx=x, cy=y, r=3.5, class_="measured") for x, y in places if np.isfinite(x) and np.isfinite(y)
    ])  # fmt: skip


def _line(x: FloatArray, y: FloatArray, x_axis: Axis, y_axis: Axis, style: str) -> Markup:
    kept = decimated(y, POINTS)
    return element("path", d=path_through(x_axis(x[kept]), y_axis(y[kept])), class_=style)


def _ticks(x_axis: Axis, y_axis: Axis) -> Markup:
    drawn = []
    for value in x_axis.ticks(5):
        x = _LEFT + float(x_axis(value))
        drawn.append(element("line", x1=x, y1=_TOP, x2=x, y2=_BOTTOM, class_="grid"))
        drawn.append(label(tick(value), x, _BOTTOM + 15.0, text_anchor="middle", class_="quiet"))
    for value in y_axis.ticks(4):
        y = _TOP + float(y_axis(value))
        drawn.append(element("line", x1=_LEFT, y1=y, x2=_RIGHT, y2=y, class_="grid"))
        drawn.append(label(tick(value), _LEFT - 5.0, y + 4.0, text_anchor="end", class_="quiet"))
    return joined(drawn)


def _y_name(words: str) -> Markup:
    middle = (_TOP + _BOTTOM) / 2.0
    return label(
        shortened(words, 34), 12.0, middle, text_anchor="middle", class_="quiet", transform=f"rotate(-90 12 {middle:g})"
    )
