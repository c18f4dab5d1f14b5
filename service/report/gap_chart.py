"""Draw sizes as bars: the gap after each step, and the pulls of what was set and declared."""

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from monitor_core.discrepancy import GapPair
from service.report.rounding import quantity, rounded
from service.report.svg import CHARACTER, Axis, element, joined, label, picture, shortened

_WIDTH = 760.0
_LONGEST = 46  # characters of a label: those of the longest key of the catalogue
_BAR = 16.0
_TOP = 26.0  # holds the name of the reference line


def gap_chart(name: str, title: str, rows: Sequence[tuple[str, GapPair]], noise_floor: float, unit: str) -> Markup:
    """Draw two bars a row, fitted and held out, or one where nothing was held out, and the noise floor.

    A row is what the model then is, and its gap; ``name`` is unique on the page.
    """
    left = _label_width([words for words, _ in rows])
    sizes = [size for _, pair in rows for size in (pair.fit, pair.held_out)]
    axis = Axis(0.0, _largest([*sizes, noise_floor]), left, _WIDTH - 150.0)
    height, bars, texts, described = _TOP, [], [], []
    for words, pair in rows:
        sizes_of = {"fitted": pair.fit, "held out": pair.held_out}
        shown = {kind: quantity(size, unit) for kind, size in sizes_of.items() if not math.isnan(size)}
        described.append(f"{words}: {', '.join(f'{size} {kind}' for kind, size in shown.items())}")
        texts.append(_row_label(words, left, height + 0.5 * len(shown) * _BAR + 5.0))
        for kind, size in shown.items():
            bars.append(_bar(axis, height, sizes_of[kind], f"bar {kind.replace(' ', '-')}"))
            beside = _end(axis, sizes_of[kind]) + 6.0
            texts.append(label(f"{size} {kind}", beside, height + 12.5, class_="beside"))
            height += _BAR + 2.0
        height += 10.0
    floor = f"noise floor {quantity(noise_floor, unit)}"
    reference = _reference(axis, noise_floor, height, floor)
    return picture(_WIDTH, height, name, title, "; ".join([*described, floor]), *bars, reference, *texts)


def pull_chart(name: str, pulls: Mapping[str, float]) -> Markup:
    """Draw a bar for each kind of error, and a line at 1, up to which what was stated holds."""
    left = _label_width(list(pulls))
    axis = Axis(0.0, _largest([1.5, *map(abs, pulls.values())]), left, _WIDTH - 150.0)
    height, bars, texts = _TOP, [], []
    for words, pull in pulls.items():
        bars.append(_bar(axis, height, abs(pull), "bar fitted"))
        texts.append(_row_label(words, left, height + 12.5))
        texts.append(label(rounded(pull, 2), _end(axis, abs(pull)) + 6.0, height + 12.5, class_="beside"))
        height += _BAR + 6.0
    description = "; ".join(f"{words}: {rounded(pull, 2)}" for words, pull in pulls.items())
    return picture(
        _WIDTH, height, name, "Pulls", description, *bars, _reference(axis, 1.0, height, "as stated"), *texts
    )


def _label_width(labels: Sequence[str]) -> float:
    return 14.0 + CHARACTER * min(_LONGEST, max(len(words) for words in labels))


def _largest(sizes: Sequence[float]) -> float:
    return max((size for size in sizes if math.isfinite(size)), default=0.0) or 1.0


def _end(axis: Axis, size: float) -> float:
    return float(axis(size)) if math.isfinite(size) else axis.start


def _row_label(words: str, left: float, y: float) -> Markup:
    shown = label(shortened(words, _LONGEST), left - 10.0, y, text_anchor="end")
    return element("g", element("title", words), shown)


def _bar(axis: Axis, top: float, size: float, kind: str) -> Markup:
    width = max(_end(axis, size) - axis.start, 0.0)
    return element("rect", x=axis.start, y=top, width=width, height=_BAR, class_=kind)


def _reference(axis: Axis, value: float, bottom: float, words: str) -> Markup:
    if not math.isfinite(value):
        return Markup()
    place = float(axis(value))
    line = element("line", x1=place, y1=_TOP - 6.0, x2=place, y2=bottom - 4.0, class_="reference")
    return joined([line, label(words, place, _TOP - 11.0, class_="quiet")])
