"""Draw what leads to a calibration: the expected frequency over the travel, the settings measured, the residuals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from service.report.svg import (
    Axis,
    Frame,
    axis_over,
    element,
    image,
    joined,
    label,
    path_through,
    place_grid,
    value_grid,
)

_HALF_MARK: Final = 9.0


WIDE: Final = Frame(1180.0, 300.0, 70.0, 8, 5, below=46.0, beside=14.0, top=14.0)
NARROW: Final = Frame(372.0, 280.0, 60.0, 4, 5, below=46.0, beside=14.0, top=14.0)


@dataclass(frozen=True, slots=True)
class Curve:
    """A frequency over positions, with the band that it can be in."""

    position_mm: Sequence[float]
    frequency_hz: Sequence[float]
    lower_hz: Sequence[float]
    upper_hz: Sequence[float]
    search_band_hz: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Region:
    """Between which preloads one is read, over positions."""

    preload_n: float
    position_mm: Sequence[float]
    interval_95_n: Sequence[tuple[float, float]]  # an open end is infinite


@dataclass(frozen=True, slots=True)
class Spot:
    """One setting or reading: where, what, and how it is drawn."""

    position_mm: float
    value: float  # preload [N], or residual [Hz]
    kind: str  # measured | waiting | refused | hole | next
    words: str


def expected_chart(curve: Curve, size: Frame, title: str, write: Callable[[str], str]) -> Markup:
    """Draw the expected frequency over the travel, its band, and the search band as a frame."""
    low, high = curve.search_band_hz
    x, y = _places(curve.position_mm, size), axis_over(np.array([low, high]), size.bottom, size.top)
    places = x(np.asarray(curve.position_mm))
    upper, lower = (y(np.asarray(values)) for values in (curve.upper_hz, curve.lower_hz))
    frame = [
        element("line", x1=size.left, y1=float(y(edge)), x2=size.right, y2=float(y(edge)), class_="through")
        for edge in (low, high)
    ]
    return image(
        size.width, size.height, title, _frame(x, y, size, write, "Hz"),
        _band(places, lower, upper), *frame,
        element("path", d=path_through(places, y(np.asarray(curve.frequency_hz))), class_="curve"),
    )  # fmt: skip


def settings_chart(spots: Sequence[Spot], size: Frame, title: str, write: Callable[[str], str]) -> Markup:
    """Draw a map of settings: full where it was measured, half where windows are awaited, empty where a hole is."""
    x = _places([spot.position_mm for spot in spots], size)
    y = axis_over(np.array([0.0, *(1.08 * spot.value for spot in spots)]), size.bottom, size.top)
    order = ("hole", "refused", "waiting", "measured", "next")
    marks = [_spot(spot, float(x(spot.position_mm)), float(y(spot.value))) for spot in sorted(
        spots, key=lambda spot: order.index(spot.kind))]  # fmt: skip
    return image(size.width, size.height, title, _frame(x, y, size, write, "N"), *marks)


def residual_chart(spots: Sequence[Spot], size: Frame, title: str, write: Callable[[str], str]) -> Markup:
    """Draw what is left of each reading about the fit, over the travel."""
    x = _places([spot.position_mm for spot in spots], size)
    reach = max((abs(spot.value) for spot in spots), default=0.0) or 1.0
    y = axis_over(np.array([-reach, reach]), size.bottom, size.top)
    zero = element("line", x1=size.left, y1=float(y(0.0)), x2=size.right, y2=float(y(0.0)), class_="level")
    marks = [_spot(spot, float(x(spot.position_mm)), float(y(spot.value)), 5.0) for spot in spots]
    return image(size.width, size.height, title, _frame(x, y, size, write, "Hz"), zero, *marks)


def region_chart(regions: Sequence[Region], size: Frame, title: str, write: Callable[[str], str]) -> Markup:
    """Draw the regions of preload levels over the travel; none reaches above twice the highest level."""
    x = _places(regions[0].position_mm, size)
    ends = np.minimum([region.interval_95_n for region in regions], 2.0 * max(region.preload_n for region in regions))
    y = axis_over(np.append(ends, 0.0), size.bottom, size.top)
    places = x(np.asarray(regions[0].position_mm))
    bands = [_band(places, *y(of_level).T) for of_level in ends]
    lines = [
        element("line", x1=size.left, y1=at, x2=size.right, y2=at, class_="level")
        for at in (float(y(region.preload_n)) for region in regions)
    ]
    return image(size.width, size.height, title, _frame(x, y, size, write, "N"), *bands, *lines)


def _band(x: FloatArray, lower: FloatArray, upper: FloatArray) -> Markup:
    outline = path_through(np.append(x, x[::-1]), np.append(upper, lower[::-1])) + "Z"
    return element("path", d=outline, class_="band")


def _places(positions: Sequence[float], size: Frame) -> Axis:
    return axis_over(np.asarray(positions, dtype=np.float64), size.left + 4.0, size.right)


def _spot(spot: Spot, x: float, y: float, half: float = _HALF_MARK) -> Markup:
    """Draw a mark whose shape says what its colour says."""
    said = element("title", spot.words)
    match spot.kind:
        case "measured":
            return element("circle", said, cx=x, cy=y, r=half, class_="spot measured")
        case "waiting":
            half_disc = f"M{x:.1f} {y - half:.1f}A{half} {half} 0 0 0 {x:.1f} {y + half:.1f}Z"
            ring = element("circle", said, cx=x, cy=y, r=half, class_="spot hole")
            return joined([ring, element("path", d=half_disc, class_="spot measured")])
        case "refused":
            cross = f"M{x - half:.1f} {y - half:.1f}l{2 * half} {2 * half}m0 {-2 * half}l{-2 * half} {2 * half}"
            return element("path", said, d=cross, class_="spot refused")
        case "next":
            reach = 1.6 * half
            diamond = f"M{x:.1f} {y - reach:.1f}l{reach} {reach} {-reach} {reach} {-reach} {-reach}Z"
            return element("path", said, d=diamond, class_="spot next")
    return element("circle", said, cx=x, cy=y, r=half, class_="spot hole")


def _frame(x: Axis, y: Axis, size: Frame, write: Callable[[str], str], unit: str) -> Markup:
    return joined([
        value_grid(y, size.left, size.right, size.values, write),
        place_grid(x, x.ticks(size.places), (size.bottom, size.bottom + 5.0), 16.0, write),
        label("mm", size.right, size.height - 6.0, text_anchor="end", class_="quiet"),
        label(unit, size.left - 6.0, size.bottom + 21.0, text_anchor="end", class_="quiet"),
    ])  # fmt: skip
