"""Draw the one picture that a report begins with: measured, before and after, where the gap is largest.

Under it is what both models leave, over the same frequencies, positions or times. It is drawn once for wide pages and
once for phones, so that its words can be read on both.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from monitor_core.shown import Panel
from service.report.charts import FEW, axis_of_values, curve, measured_curve, style_of
from service.report.rounding import tick
from service.report.svg import Axis, Frame, axis_over, element, joined, label, picture, shortened

_BEYOND: Final = 3.0  # a logarithmic picture reaches so much beyond the measurement
_LOGARITHMIC_FROM: Final = 5.0  # ratio of the last to the first frequency
#: A band reaches from its middle over this to its middle times this, and holds so much of what differs, in squares.
_ZOOM: Final = 1.8
_IN_THE_BAND: Final = 0.8
_FEWEST_LINES: Final = 20
#: Where a ratio is marked: the largest of these that the picture reaches, and its reciprocal.
_MARKS: Final = (10.0, 5.0, 2.0, 1.5, 1.2, 1.1, 1.05, 1.02, 1.01)
_SHARE_OF_PICTURE: Final = 0.62  # the rest is what is left


WIDE: Final = Frame(700.0, 400.0, 62.0, below=38.0, top=30.0)
NARROW: Final = Frame(360.0, 360.0, 54.0, below=38.0, top=46.0)


def largest_gap(panels: Sequence[Panel]) -> Panel | None:
    """Return the panel that the model before misses most, of those held out if there are any; None without any."""
    held_out = [panel for panel in panels if panel.held_out]
    return max(held_out or panels, key=miss, default=None)


def miss(panel: Panel) -> float:
    """Return the rms by which the first model misses a panel, relative to the measurement; 0 where none has an answer.

    Of a logarithmic panel it is that of ln(model/measured).
    """
    model = next(iter(panel.models.values()), panel.measured)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.log(model / panel.measured) if panel.logarithmic else (model - panel.measured)
    size = 1.0 if panel.logarithmic else math.sqrt(float(np.nanmean(panel.measured**2))) or 1.0
    relative = apart[np.isfinite(apart)] / size
    return float(np.sqrt(np.mean(relative**2))) if relative.size else 0.0


def zoomed(panel: Panel) -> Panel:
    """Return a response about the frequencies at which the models differ, if that is one band; else all of it."""
    if not panel.logarithmic or len(panel.models) < 2:
        return panel
    first, *_, last = panel.models.values()
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.nan_to_num(np.log(first / last) ** 2, posinf=0.0, neginf=0.0)
    center = float(panel.x[int(np.argmax(squares))])
    shown = (panel.x >= center / _ZOOM) & (panel.x <= center * _ZOOM)
    if np.count_nonzero(shown) < _FEWEST_LINES or np.sum(squares[shown]) < _IN_THE_BAND * np.sum(squares):
        return panel
    models = {name: y[shown] for name, y in panel.models.items()}
    return replace(panel, x=panel.x[shown], measured=panel.measured[shown], models=models)


def hero_chart(name: str, panel: Panel, frame: Frame, names: Mapping[str, str]) -> Markup:
    """Draw a panel over its residuals; ``name`` is unique on the page.

    ``said`` is what the models to be drawn are called in the picture, by their names in the panel.
    """
    models = {model: y for model, y in panel.models.items() if model in names}
    x_axis = _x_axis(panel, frame)
    split = frame.top + _SHARE_OF_PICTURE * (frame.bottom - frame.top)
    upper, lower = (frame.top, split - 8.0), (split + 8.0, frame.bottom)
    y_axis = axis_of_values(panel, models, upper[1], upper[0], _BEYOND)
    left_over = {model: _left(panel, y) for model, y in models.items()}
    r_axis = _axis_of_rest(panel, left_over, lower)
    description = (
        f"{panel.y_name} over {panel.x_name}, measured and {' and '.join(models)}; below, what the models leave."
    )
    return picture(
        frame.width, frame.height, name, panel.title, description,
        _legend(names, frame, points=panel.x.size <= FEW),
        _grid(x_axis, y_axis, frame, upper), _grid(x_axis, r_axis, frame, lower, with_x=True),
        _clipped(measured_curve(panel, x_axis, y_axis), upper, frame),
        *(_clipped(curve(panel.x, y, x_axis, y_axis, style_of(model)), upper, frame) for model, y in models.items()),
        _zero(panel, r_axis, frame),
        *(
            _clipped(_rest(panel, rest, x_axis, r_axis, style_of(model)), lower, frame)
            for model, rest in left_over.items()
        ),
        label(panel.x_name, 0.5 * (frame.left + frame.right), frame.height - 6.0, text_anchor="middle", class_="quiet"),
        _upright(panel.y_name, upper), _upright("model/measured" if panel.logarithmic else "difference", lower),
    )  # fmt: skip


def _left(panel: Panel, model: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(model / panel.measured if panel.logarithmic else model - panel.measured)


def _x_axis(panel: Panel, frame: Frame) -> Axis:
    finite = panel.x[np.isfinite(panel.x)]
    spread = finite.size and np.min(finite) > 0.0 and np.max(finite) > _LOGARITHMIC_FROM * np.min(finite)
    return axis_over(panel.x, frame.left, frame.right, logarithmic=bool(spread and panel.logarithmic))


def _axis_of_rest(panel: Panel, rest: Mapping[str, FloatArray], between: tuple[float, float]) -> Axis:
    null = 1.0 if panel.logarithmic else 0.0
    values = np.concatenate([np.array([null]), *rest.values()])
    if panel.logarithmic:  # as much up as down, a hundredfold at the most
        logarithms = np.abs(np.log(values[np.isfinite(values) & (values > 0.0)]))
        reach = math.exp(min(float(np.max(logarithms)), math.log(100.0)))
        values = np.array([1.0 / max(reach, 1.02), max(reach, 1.02)])
    else:
        reach = float(np.max(np.abs(values[np.isfinite(values)])))
        values = np.array([-reach, reach])
    return axis_over(values, between[1], between[0], logarithmic=panel.logarithmic)


def _legend(names: Mapping[str, str], frame: Frame, *, points: bool) -> Markup:
    """Say beside a piece of each line what it is; on a phone in two rows."""
    x, y, drawn = frame.left, 14.0, []
    for style, words in [("measured", "measured"), *((style_of(model), words) for model, words in names.items())]:
        room = 34.0 + 6.6 * len(words)
        if x + room > frame.width:
            x, y = frame.left, y + 17.0
        if points and style == "measured":
            drawn.append(element("circle", cx=x + 11.0, cy=y - 4.0, r=3.5, class_=style))
        else:
            drawn.append(element("path", d=f"M{x:.1f} {y - 4.0:.1f}h22", class_=style))
        drawn.append(label(words, x + 27.0, y))
        x += room + 8.0
    return joined(drawn)


def _rest(panel: Panel, rest: FloatArray, x_axis: Axis, r_axis: Axis, style: str) -> Markup:
    line = curve(panel.x, rest, x_axis, r_axis, style)
    if panel.x.size > FEW:
        return line
    kind = style.removeprefix("model ")
    places = zip(x_axis(panel.x).tolist(), r_axis(rest).tolist(), strict=True)
    points = [
        element("circle", cx=x, cy=y, r=3.0, class_=f"point {kind}")
        for x, y in places
        if np.isfinite(x) and np.isfinite(y)
    ]
    return joined([line, *points])


def _clipped(drawn: Markup, between: tuple[float, float], frame: Frame) -> Markup:
    """Cut what is beyond the frame, in the same coordinates."""
    top, bottom = between
    width, height = frame.right - frame.left, bottom - top
    box = f"{frame.left:g} {top:g} {width:g} {height:g}"
    return element("svg", drawn, x=frame.left, y=top, width=width, height=height, viewBox=box, overflow="hidden")


def _zero(panel: Panel, r_axis: Axis, frame: Frame) -> Markup:
    y = float(r_axis(1.0 if panel.logarithmic else 0.0))
    return element("line", x1=frame.left, y1=y, x2=frame.right, y2=y, class_="reference")


def _grid(
    x_axis: Axis, y_axis: Axis, frame: Frame, between: tuple[float, float], *, with_x: bool = False
) -> Markup:  # fmt: skip
    top, bottom = between
    drawn = []
    for value in _frequencies(x_axis) if x_axis.logarithmic else x_axis.ticks(6 if frame.width > NARROW.width else 4):
        x = float(x_axis(value))
        drawn.append(element("line", x1=x, y1=top, x2=x, y2=bottom, class_="grid"))
        if with_x:
            drawn.append(label(tick(value), x, bottom + 15.0, text_anchor="middle", class_="quiet"))
    of_ratio = with_x and y_axis.logarithmic
    for value in _ratios(y_axis) if of_ratio else y_axis.ticks(4):
        y = float(y_axis(value))
        words = f"{value:.2g}" if of_ratio else tick(value)
        drawn.append(element("line", x1=frame.left, y1=y, x2=frame.right, y2=y, class_="grid"))
        drawn.append(label(words, frame.left - 5.0, y + 4.0, text_anchor="end", class_="quiet"))
    box = element("rect", x=frame.left, y=top, width=frame.right - frame.left, height=bottom - top, class_="frame")
    return joined([*drawn, box])


def _frequencies(axis: Axis) -> list[float]:
    """Return 1, 2 and 5 of each decade within an axis."""
    decades = range(math.floor(math.log10(axis.lower)), math.ceil(math.log10(axis.upper)) + 1)
    values = (factor * 10.0**decade for decade in decades for factor in (1.0, 2.0, 5.0))
    return [value for value in values if axis.lower <= value <= axis.upper]


def _ratios(axis: Axis) -> list[float]:
    mark = next((mark for mark in _MARKS if mark <= axis.upper), 1.0)
    return [1.0 / mark, 1.0, mark]


def _upright(words: str, between: tuple[float, float]) -> Markup:
    middle = 0.5 * (between[0] + between[1])
    room = int((between[1] - between[0]) / 6.2)
    return label(
        shortened(words, max(room, 6)), 11.0, middle, text_anchor="middle", class_="quiet",
        transform=f"rotate(-90 11 {middle:g})",
    )  # fmt: skip
