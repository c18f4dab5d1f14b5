"""Draw SVG without a script: elements that escape whatever is put into them, scales, ticks."""

import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup, escape

from monitor_core.arrays import FloatArray
from service.report.rounding import tick

#: Width of a character of the labels, which are 12 units high; on the wide side.
CHARACTER: Final = 7.4
#: Values that differ relatively by less are drawn as one: they differ by rounding alone.
_CONSTANT: Final = 1e-9


def element(tag: str, *children: str, **attributes: str | float) -> Markup:
    """Return an element; text is escaped, elements are kept as they are.

    An underscore in the name of an attribute stands for a dash and one at its end is left out, as in ``class_``.
    """
    written = [f' {_named(name)}="{_written(value)}"' for name, value in attributes.items()]
    inside = [child if isinstance(child, Markup) else escape(child) for child in children]
    return Markup("".join([f"<{tag}", *written, ">", *inside, f"</{tag}>"]))  # noqa: S704 - each part is escaped above


def joined(parts: Sequence[Markup]) -> Markup:
    """Return several elements as one text."""
    return Markup("").join(parts)


def picture(width: float, height: float, name: str, title: str, description: str, *content: Markup) -> Markup:
    """Return a whole picture that says to a screen reader what it shows; ``name`` is unique on the page."""
    return element(
        "svg",
        element("title", title, id=f"{name}-title"),
        element("desc", description, id=f"{name}-desc"),
        *content,
        viewBox=f"0 0 {width:g} {height:g}",
        style=f"max-width:{width:g}px;min-width:{0.7 * width:g}px",
        role="img",
        aria_labelledby=f"{name}-title {name}-desc",
    )


def image(width: float, height: float, title: str, *content: Markup) -> Markup:
    """Return a whole picture that a screen reader names by its title; a table by it says the same in numbers."""
    return element(
        "svg", *content, viewBox=f"0 0 {width:g} {height:g}", width=width, height=height, role="img", aria_label=title
    )


def label(text: str, x: float, y: float, **attributes: str | float) -> Markup:
    """Return a text."""
    return element("text", text, x=x, y=y, **attributes)


def shortened(text: str, characters: int) -> str:
    """Return a text cut to so many characters, with a mark where it was cut."""
    return text if len(text) <= characters else text[: characters - 1] + "…"


@dataclass(frozen=True, slots=True)
class Axis:
    """From values to places in a picture."""

    lower: float
    upper: float
    start: float
    end: float
    logarithmic: bool = False

    def __call__(self, values: FloatArray | float) -> FloatArray:
        """Return the places; NaN where a logarithmic axis has none."""
        lower, upper, inside = self.lower, self.upper, np.asarray(values, dtype=np.float64)
        if self.logarithmic:
            lower, upper = math.log10(lower), math.log10(upper)
            inside = np.log10(np.where(inside > 0.0, inside, np.nan))
        return np.asarray(self.start + (inside - lower) / (upper - lower) * (self.end - self.start))

    def ticks(self, count: int) -> list[float]:
        """Return about so many round values."""
        if self.logarithmic and self.upper / self.lower > 20.0:
            return self._decades(count)
        step = _round_step((self.upper - self.lower) / count)
        first, last = math.ceil(self.lower / step - 1e-9), math.floor(self.upper / step + 1e-9)
        return [number * step for number in range(first, last + 1)]

    def _decades(self, count: int) -> list[float]:
        first, last = math.floor(math.log10(self.lower)), math.ceil(math.log10(self.upper))
        factors = (1.0, 2.0, 5.0) if last - first <= 2 else (1.0,)
        every = max(1, round((last - first) / count))
        values = [factor * 10.0**decade for decade in range(first, last + 1, every) for factor in factors]
        return [value for value in values if self.lower <= value <= self.upper]


@dataclass(frozen=True, slots=True)
class Frame:
    """Size of a picture, where its plot lies in it, and how many labels it has room for; all lengths in pixels."""

    width: float
    height: float
    left: float
    places: int = 8  # labels across
    values: int = 4  # labels upwards
    below: float = 30.0  # room under the plot
    beside: float = 12.0  # and to the right of it
    top: float = 12.0
    points: int = 400  # of a curve: as many as the eye can use

    @property
    def bottom(self) -> float:
        """Where the plot ends."""
        return self.height - self.below

    @property
    def right(self) -> float:
        """Where it ends on the right."""
        return self.width - self.beside


def axis_over(values: FloatArray, start: float, end: float, *, logarithmic: bool = False) -> Axis:
    """Return an axis that holds all finite values, and is never without width."""
    usable = values[np.isfinite(values) & (values > 0.0 if logarithmic else True)]
    lower, upper = (float(usable.min()), float(usable.max())) if usable.size else (1.0, 10.0)
    if logarithmic:
        margin = max((upper / lower) ** 0.05, 1.01)
        return Axis(lower / margin, upper * margin, start, end, logarithmic=True)
    size = max(abs(lower), abs(upper))
    margin = 0.05 * (upper - lower) if upper - lower > _CONSTANT * size else 0.5 * size or 1.0
    return Axis(lower - margin, upper + margin, start, end)


def place_grid(
    scale: Axis, values: Sequence[float], between: tuple[float, float], below: float, write: Callable[[str], str] = str
) -> Markup:
    """Draw a line at each value from the first to the second height, and its number so far ``below``."""
    drawn = []
    for value in values:
        x = float(scale(value))
        drawn.append(element("line", x1=x, y1=between[0], x2=x, y2=between[1], class_="grid"))
        drawn.append(label(write(tick(value)), x, between[1] + below, text_anchor="middle", class_="quiet"))
    return joined(drawn)


def value_grid(scale: Axis, left: float, right: float, count: int, write: Callable[[str], str] = str) -> Markup:
    """Draw a line across at about so many round values, each with its number; ``write`` puts that into a language."""
    drawn, ticks = [], scale.ticks(count)
    for value, y in zip(ticks, scale(np.array(ticks)).tolist(), strict=True):
        drawn.append(element("line", x1=left, y1=y, x2=right, y2=y, class_="grid"))
        drawn.append(label(write(tick(value)), left - 6.0, y + 5.0, text_anchor="end", class_="quiet"))
    return joined(drawn)


def decimated(values: FloatArray, limit: int) -> npt.NDArray[np.intp]:
    """Return the indices of at most so many points that keep the outline of a curve.

    Of each stretch the lowest and the highest point are kept, so that no peak is lost, or its first point if all of it
    is unknown, so that the gap is not drawn over.
    """
    if values.size <= limit:
        return np.arange(values.size)
    kept: list[int] = []
    for stretch in np.array_split(np.arange(values.size), limit // 2):
        inside = values[stretch]
        if np.all(np.isnan(inside)):
            kept.append(int(stretch[0]))
        else:
            kept += sorted({int(stretch[np.nanargmin(inside)]), int(stretch[np.nanargmax(inside)])})
    return np.asarray(kept)


def path_through(x: FloatArray, y: FloatArray) -> str:
    """Return the path through points; it is broken where one is not finite."""
    known = np.isfinite(x) & np.isfinite(y)
    parts, drawing = [], False
    for is_known, place_x, place_y in zip(known.tolist(), x.tolist(), y.tolist(), strict=True):
        if is_known:
            parts.append(f"{'L' if drawing else 'M'}{place_x:.1f} {place_y:.1f}")
        drawing = is_known
    return "".join(parts)


@cache
def _named(name: str) -> str:
    return name.rstrip("_").replace("_", "-")


def _written(value: str | float) -> str:
    return html.escape(value) if isinstance(value, str) else f"{value:.1f}".removesuffix(".0")


def _round_step(rough: float) -> float:
    decade = 10.0 ** math.floor(math.log10(rough))
    return next(factor * decade for factor in (1.0, 2.0, 5.0, 10.0) if factor * decade >= rough * 0.999)
