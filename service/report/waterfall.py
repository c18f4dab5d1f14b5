"""Draw responses over a long time as a map of colour: frequency across, time upwards, the newest at the top."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray
from service.report.rounding import tick
from service.report.svg import Axis, element, image, joined, label, path_through

#: Shades of a power of the size, from the least to the largest; cells of one shade in a row are one piece. With the
#: square the peak of a damped mode would be as wide as what it moves by.
N_SHADES: Final = 9
_POWER: Final = 6
#: Least part of the frequency that is shown on either side of the modes.
_REACH: Final = 0.02
N_COLUMNS: Final = 60
_ROW: Final = 13.0
_BOTTOM: Final = 46.0
_TOP: Final = 6.0
#: A label of time needs so much height.
_LABEL: Final = 26.0


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """The size of a response at one moment, and the natural frequency that was fitted to it [Hz]."""

    at: datetime
    frequency: FloatArray
    magnitude: FloatArray
    mode: float


def waterfall(
    title: str, responses: Sequence[Response], width: float, write: Callable[[str], str], *, axis_words: str
) -> Markup:
    """Draw responses, newest first, over one band; each row is relative to its own peak, a line joins the modes."""
    modes = np.array([response.mode for response in responses])
    left, right = 104.0, width - 12.0
    reach = max(0.5 * float(np.ptp(modes)), _REACH * float(np.median(modes)))
    # as far as every response goes, but no mode is cut off
    lowest = max(float(modes.min()) - reach, *(float(response.frequency[0]) for response in responses))
    highest = min(float(modes.max()) + reach, *(float(response.frequency[-1]) for response in responses))
    least = 0.25 * _REACH * float(np.median(modes))
    lowest, highest = min(lowest, float(modes.min()) - least), max(highest, float(modes.max()) + least)
    height = _TOP + _ROW * len(responses) + _BOTTOM
    across = Axis(lowest, highest, left, right)
    edges = np.linspace(lowest, highest, N_COLUMNS + 1)
    shades: list[list[str]] = [[] for _ in range(N_SHADES)]
    times, free_from = [], _TOP
    for number, response in enumerate(responses):
        y = _TOP + number * _ROW
        for first, last, shade in _runs(response, edges):
            x1, x2 = float(across(edges[first])), float(across(edges[last]))
            shades[shade].append(f"M{x1:.1f} {y:.0f}h{x2 - x1:.1f}v{_ROW:.0f}h{x1 - x2:.1f}z")
        if y >= free_from or number == 0:
            times.append(label(f"{response.at:%Y-%m-%d}", left - 8.0, y + 12.0, text_anchor="end", class_="quiet"))
            free_from = y + _LABEL
    foot, ridge = height - _BOTTOM, _TOP + _ROW * np.arange(0.5, len(responses))
    ticks = [
        label(write(tick(value)), float(across(value)), foot + 20.0, text_anchor="middle", class_="quiet")
        for value in across.ticks(5)
    ]
    return image(
        width,
        height,
        title,
        element("rect", x=left, y=_TOP, width=right - left, height=foot - _TOP, class_="cells"),
        *(
            element("path", d="".join(pieces), class_=f"shade s{shade}")
            for shade, pieces in enumerate(shades)
            if pieces
        ),
        element("path", d=path_through(across(modes), ridge), class_="mode halo"),
        element("path", d=path_through(across(modes), ridge), class_="mode"),
        joined(times),
        joined(ticks),
        label(axis_words, 0.5 * (left + right), foot + 42.0, text_anchor="middle", class_="quiet"),
    )


def _runs(response: Response, edges: FloatArray) -> list[tuple[int, int, int]]:
    """Return first and last edge and shade of each run of cells in one shade; cells without a response are left out."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    known = np.isfinite(response.magnitude)
    size = np.interp(middle, response.frequency[known], response.magnitude[known], left=np.nan, right=np.nan)
    largest = float(np.nanmax(size)) if np.isfinite(size).any() else 1.0
    shade = np.where(np.isfinite(size), np.clip(N_SHADES * (size / largest) ** _POWER, 0, N_SHADES - 1), -1).astype(int)
    begins = [0, *(np.flatnonzero(np.diff(shade)) + 1).tolist(), shade.size]
    return [(first, last, int(shade[first])) for first, last in itertools.pairwise(begins) if shade[first] >= 0]
