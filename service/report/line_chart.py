"""Draw curves over one quantity: a response over frequency, with one for reference; samples over time.

One drawing for wide pages and for phones: what differs is the frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from service.report.rounding import tick
from service.report.svg import (
    Axis,
    Frame,
    axis_over,
    decimated,
    element,
    image,
    joined,
    label,
    path_through,
    value_grid,
)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Values over the places of a picture."""

    x: FloatArray
    y: FloatArray
    style: str  # class of the style sheet: measured, reference


WIDE: Final = Frame(1180.0, 230.0, 84.0, 8, 4, below=28.0, top=10.0, points=300)
NARROW: Final = Frame(388.0, 190.0, 70.0, 4, 3, below=28.0, top=10.0, points=120)
LOW_WIDE: Final = Frame(1180.0, 130.0, 84.0, 8, 4, below=28.0, top=10.0, points=220)
LOW_NARROW: Final = Frame(388.0, 130.0, 70.0, 4, 4, below=28.0, top=10.0, points=110)

#: Of a file of its own, which no page styles.
_STYLE = (
    ".curve{fill:none;stroke:#0a6ebd;stroke-width:2}.curve.reference{stroke:#888;stroke-dasharray:6 4}"
    ".grid{stroke:#ddd}.quiet{fill:#555}text{font:13px sans-serif}svg{background:#fff}"
)


@dataclass(frozen=True, slots=True, eq=False)
class LinePicture:
    """All that a picture of curves shows."""

    title: str
    x_unit: str
    y_unit: str
    curves: Sequence[Curve]
    band: tuple[float, float] | None = None  # that is shaded
    picked: float | None = None  # place that is marked
    logarithmic: bool = False
    limits: tuple[float, float] | None = None  # of the values, where they are known beforehand


def line_chart(shown: LinePicture, frame: Frame, write: Callable[[str], str]) -> Markup:
    """Draw curves; ``write`` puts a number into the language of the page."""
    x_axis = Axis(
        min(float(curve.x.min()) for curve in shown.curves),
        max(float(curve.x.max()) for curve in shown.curves),
        frame.left,
        frame.right,
    )
    y_axis = (
        axis_over(np.concatenate([c.y for c in shown.curves]), frame.bottom, frame.top, logarithmic=shown.logarithmic)
        if shown.limits is None
        else Axis(*shown.limits, frame.bottom, frame.top)
    )
    parts = [_band(shown.band, x_axis, frame), _grid(shown, x_axis, y_axis, frame, write)]
    parts += [_curve(curve, x_axis, y_axis, frame.points) for curve in shown.curves]
    if shown.picked is not None:
        x = float(x_axis(shown.picked))
        parts.append(element("line", x1=x, y1=frame.top, x2=x, y2=frame.bottom, class_="picked"))
    return image(frame.width, frame.height, shown.title, *parts)


def stacked(pictures: Sequence[tuple[LinePicture, str]]) -> str:
    """Return pictures under each other, each with words over its right end, as a file of their own."""
    panels = []
    for row, (picture, words) in enumerate(pictures):
        title = label(words, WIDE.right, 24.0, text_anchor="end")
        chart = line_chart(picture, WIDE, str)
        panels.append(element("g", chart, title, transform=f"translate(0 {row * WIDE.height:g})"))
    box = f"0 0 {WIDE.width:g} {len(panels) * WIDE.height:g}"
    return element("svg", element("style", _STYLE), *panels, xmlns="http://www.w3.org/2000/svg", viewBox=box)


def _curve(curve: Curve, x_axis: Axis, y_axis: Axis, points: int) -> Markup:
    kept = decimated(curve.y, points)
    y = np.clip(y_axis(curve.y[kept]), min(y_axis.start, y_axis.end), max(y_axis.start, y_axis.end))
    return element("path", d=path_through(x_axis(curve.x[kept]), y), class_=f"curve {curve.style}")


def _band(band: tuple[float, float] | None, x_axis: Axis, frame: Frame) -> Markup:
    if band is None:
        return Markup()
    low, high = (min(max(float(x_axis(end)), x_axis.start), x_axis.end) for end in band)
    return element(
        "rect", x=low, y=frame.top, width=max(high - low, 0.0), height=frame.bottom - frame.top, class_="band"
    )


def _grid(shown: LinePicture, x_axis: Axis, y_axis: Axis, frame: Frame, write: Callable[[str], str]) -> Markup:
    drawn = [value_grid(y_axis, frame.left, x_axis.end, frame.values, write)]
    for value in x_axis.ticks(frame.places):
        x = float(x_axis(value))
        drawn.append(element("line", x1=x, y1=frame.bottom, x2=x, y2=frame.bottom + 5.0, class_="grid"))
        if x < x_axis.end - 50.0:
            drawn.append(label(write(tick(value)), x, frame.height - 6.0, text_anchor="middle", class_="quiet"))
    drawn.append(element("line", x1=frame.left, y1=frame.bottom, x2=x_axis.end, y2=frame.bottom, class_="grid"))
    drawn.append(label(shown.x_unit, x_axis.end, frame.height - 6.0, text_anchor="end", class_="quiet"))
    return joined(drawn)
