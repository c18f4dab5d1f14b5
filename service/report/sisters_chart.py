"""Draw what axes of one type have left of their baselines, over time: one line each, the own one strong."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from markupsafe import Markup

from service.report.svg import axis_over, element, image, label, path_through, value_grid
from service.report.time_axis import time_ticks
from service.report.trend_chart import Frame

#: Lines look different without any colour.
DASHES = ("", "8 4", "2 4", "10 4 2 4", "4 3", "12 3")


@dataclass(frozen=True, slots=True)
class ShareLine:
    """An axis: when, and what share of its baseline; the own one is strong."""

    name: str
    at: Sequence[datetime]
    share: Sequence[float]
    is_own: bool = False


def sisters_chart(title: str, lines: Sequence[ShareLine], frame: Frame, write: Callable[[str], str]) -> Markup:
    """Draw all lines in one picture; each has a number at its end, as in the table by it."""
    moments = [moment for line in lines for moment in line.at]
    start, end = min(moments), max(moments)
    whole = (end - start).total_seconds() or 1.0
    scale = axis_over(100.0 * np.array([share for line in lines for share in line.share]), frame.bottom - 8.0, 12.0)
    first, last = frame.left + 8.0, frame.right - 28.0

    def place(moment: datetime) -> float:
        return first + (moment - start).total_seconds() / whole * (last - first)

    drawn = [value_grid(scale, frame.left, frame.right, frame.values, write)]
    drawn.append(label("%", frame.left - 6.0, frame.bottom + 4.0, text_anchor="end", class_="quiet"))
    for moment, words in time_ticks(start, end, frame.times):
        drawn.append(label(words, place(moment), frame.height - 8.0, text_anchor="middle", class_="quiet"))
    for number, line in enumerate(lines):
        x = np.array([place(moment) for moment in line.at])
        y = np.asarray(scale(100.0 * np.array(line.share)))
        dashes = "" if line.is_own else DASHES[1 + number % (len(DASHES) - 1)]
        drawn.append(
            element(
                "path", d=path_through(x, y), class_="sister own" if line.is_own else "sister", stroke_dasharray=dashes
            )
        )
        drawn.append(label(str(number + 1), float(x[-1]) + 6.0, float(y[-1]) + 5.0))
    return image(frame.width, frame.height, title, *drawn)
