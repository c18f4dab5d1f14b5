"""Draw the channels of a file: as a page of HTML that needs nothing else, or in the letters of a terminal."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.recordings.raw.channels import Channel
from monitor_core.recordings.raw.inspection import ChannelSummary
from service.documents.printable import printable
from service.report.svg import Axis, axis_over, element, joined, label, path_through, picture, place_grid, value_grid

_STYLE: Final = Path(__file__).parents[1] / "web" / "static" / "monitor.css"
#: More would be no picture: the table above them lists all.
MOST_PICTURES: Final = 64
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 900.0, 190.0, 80.0, 30.0, 8.0
_COLUMNS: Final = 800  # stretches of which the lowest and the highest value are drawn
_LETTERS, _ROWS = 100, 5  # of a picture in a terminal
_LARGEST: Final = 1e150  # larger values, and smaller ones than its reciprocal, are drawn as if they were of this size
_BRAILLE = 0x2800
#: Dots of a braille letter by row and column (Unicode, block 2800).
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_OWN_STYLE = """
figure { margin: 0 0 1rem; } figcaption { font-weight: 600; overflow-wrap: anywhere; }
svg { display: block; width: 100%; height: auto; }
svg text { font: 12px system-ui, sans-serif; fill: var(--ink); font-variant-numeric: tabular-nums; }
.frame { fill: none; stroke: var(--muted); } .grid { stroke: var(--line); }
.curve { fill: none; stroke: var(--accent); stroke-width: 1.2; stroke-linejoin: round; }
.faults { color: var(--alarm); margin: .2rem 0 0; } td { overflow-wrap: anywhere; }
"""


def channel_page(
    name: str, channels: Sequence[Channel], summaries: Sequence[ChannelSummary], facts: Sequence[str] = ()
) -> str:
    """Return the page of a file: what its channels are, and a picture of each.

    Every text of the file is shown and never obeyed: markup is escaped, and what is no visible letter stands as its
    code.
    """
    figures = [
        _figure(f"channel-{number}", channel, summary)
        for number, (channel, summary) in enumerate(zip(channels, summaries, strict=True))
        if number < MOST_PICTURES
    ]
    more = len(channels) - len(figures)
    body = element(
        "main",
        element("h1", printable(name)),
        *(element("p", printable(fact), class_="lead") for fact in facts),
        element("section", _table(summaries)),
        element("section", *figures) if figures else Markup(""),
        element("p", f"{more} more channels are not drawn.", class_="lead") if more else Markup(""),
    )
    head = element(
        "head",
        Markup('<meta charset="utf-8"><meta name="viewport" content="width=device-width">'),
        element("title", f"Channels of {printable(name)}"),
        element("style", Markup(_STYLE.read_text(encoding="utf-8") + _OWN_STYLE)),  # noqa: S704 - style sheets of ours
    )
    return f"<!doctype html>\n{element('html', head, element('body', body), lang='en')}\n"


def channel_letters(channel: Channel, summary: ChannelSummary) -> list[str]:
    """Return the lines of a picture in a terminal: the name, and the lowest and highest values along the record."""
    lows, highs = envelope(channel.samples, 2 * _LETTERS)
    lines = [printable(f"{summary.name} {_facts(summary)}")]
    known = np.isfinite(lows)
    if not known.any():
        return [*lines, "  no finite value"]
    axis = axis_over(np.concatenate([lows, highs]), 4.0 * _ROWS - 1.0, 0.0)
    cells = np.zeros((_ROWS, _LETTERS), dtype=int)
    for column in np.flatnonzero(known):
        first, last = int(axis(float(highs[column]))), int(axis(float(lows[column])))
        for row in range(first, last + 1):
            cells[row // 4, column // 2] |= _DOTS[row % 4][column % 2]
    width = -(-lows.size // 2)
    scale = [f"{np.nanmax(highs):.4g}", *([""] * (_ROWS - 2)), f"{np.nanmin(lows):.4g}"]
    rows = ["".join(chr(_BRAILLE + int(cell)) for cell in row[:width]) for row in cells]
    return [*lines, *(f"{number:>10} {row}" for number, row in zip(scale, rows, strict=True))]


def envelope(samples: SampleArray, n_columns: int) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest finite value of each of at most so many stretches; NaN where none is finite.

    No value lies outside, however long the record: a single wrong sample of millions shows.
    """
    flat = samples.reshape(-1)
    n = min(n_columns, flat.size)
    edges = np.linspace(0, flat.size, n + 1).astype(np.int64)
    lows, highs = np.full(n, np.nan), np.full(n, np.nan)
    for number in range(n):
        stretch = flat[edges[number] : edges[number + 1]]
        finite = stretch[np.isfinite(stretch)]
        if finite.size:
            lows[number], highs[number] = finite.min(), finite.max()
    return _drawable(lows), _drawable(highs)


def _drawable(values: FloatArray) -> FloatArray:
    """Return values whose differences are numbers, too."""
    clipped = np.clip(values, -_LARGEST, _LARGEST)
    return np.where(np.abs(clipped) < 1.0 / _LARGEST, clipped * 0.0, clipped)


def _facts(summary: ChannelSummary) -> str:
    facts = [f"{' × '.join(map(str, summary.shape))} values"]
    facts += [f"[{summary.unit}]"] if summary.unit else ["no unit"]
    facts += [f"{summary.sample_rate:g} Hz"] if summary.sample_rate is not None else []
    return ", ".join(facts)


def _table(summaries: Sequence[ChannelSummary]) -> Markup:
    names = ("channel", "shape", "unit", "sample rate", "start", "first values", "remarks")
    rows = [_row(summary) for summary in summaries]
    head = element("tr", *(element("th", name) for name in names))
    return element("table", element("thead", head), element("tbody", *rows))


def _row(summary: ChannelSummary) -> Markup:
    cells = (
        summary.name,
        " × ".join(map(str, summary.shape)),
        summary.unit or "—",
        "—" if summary.sample_rate is None else f"{summary.sample_rate:g} Hz",
        "—" if summary.started_at is None else summary.started_at.isoformat(),
        ", ".join(f"{value:g}" for value in summary.first_values),
        "; ".join([*summary.remarks, *summary.doubts]),
    )
    return element("tr", *(element("td", printable(cell)) for cell in cells))


def _figure(name: str, channel: Channel, summary: ChannelSummary) -> Markup:
    caption = printable(f"{summary.name}: {_facts(summary)}")
    faults = "; ".join([*summary.remarks, *summary.doubts])
    return element(
        "figure",
        element("figcaption", caption),
        _picture(name, caption, channel, summary),
        element("p", printable(faults), class_="faults") if faults else Markup(""),
    )


def _picture(name: str, title: str, channel: Channel, summary: ChannelSummary) -> Markup:
    lows, highs = envelope(channel.samples, _COLUMNS)
    n = channel.samples.size
    duration = n if summary.sample_rate is None else n / summary.sample_rate
    across = Axis(0.0, max(float(duration), 1e-300), _LEFT, _WIDTH - 10.0)
    up = axis_over(np.concatenate([lows, highs]), _HEIGHT - _BOTTOM, _TOP)
    places = np.repeat((np.arange(lows.size) + 0.5) * duration / max(lows.size, 1), 2)
    values = np.column_stack([lows, highs]).reshape(-1)  # down and up again in each stretch
    unit = "samples" if summary.sample_rate is None else "s"
    known = summary.minimum is not None
    described = f"from {summary.minimum:g} to {summary.maximum:g}" if known else "no finite value"
    description = f"{described}, over {duration:g} {unit}"
    return picture(
        _WIDTH, _HEIGHT, name, title, description, _frame(across, up, unit),
        element("path", d=path_through(across(places), up(values)), class_="curve"),
    )  # fmt: skip


def _frame(across: Axis, up: Axis, unit: str) -> Markup:
    bottom = _HEIGHT - _BOTTOM
    return joined([
        element("rect", x=_LEFT, y=_TOP, width=_WIDTH - 10.0 - _LEFT, height=bottom - _TOP, class_="frame"),
        label(unit, _LEFT - 6.0, bottom + 15.0, text_anchor="end"),
        value_grid(up, _LEFT, _WIDTH - 10.0, 4),
        place_grid(across, across.ticks(8), (bottom, bottom), 15.0),
    ])  # fmt: skip
