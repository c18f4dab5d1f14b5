"""Show a record to a person: its panels drawn by matplotlib, its columns as a table of pandas, when they are asked for.

Reports and pages draw SVG in the words and styles of the service, which the core may not know; what a picture of models
and a measurement shows is said once for both: :class:`Panel`.
"""

import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from monitor_core.errors import MissingReaderError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Up to so many measured points are drawn one by one.
_FEW = 60
_COLUMNS, _WIDTH, _HEIGHT = 3, 5.0, 3.4  # pictures side by side, and the size of each [inch]
_Values: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One picture of measurement and models: a response, a frequency over positions, a force over time."""

    title: str
    x_name: str  # with unit, as "frequency [Hz]"
    y_name: str
    x: _Values
    measured: _Values  # NaN where there are models alone
    models: Mapping[str, _Values] = field(default_factory=dict)  # by name: "before", "after"
    logarithmic: bool = False  # y axis
    held_out: bool = False
    interval: tuple[_Values, _Values] | None = None  # around what was measured; an end that is open is infinite


def plot(panels: Sequence[Panel], figure: "Figure | None" = None) -> "Figure":
    """Draw panels into a figure, of pyplot if none is given. Raises MissingReaderError without matplotlib."""
    if figure is None:
        try:
            from matplotlib import pyplot  # noqa: PLC0415  # an extra, and slow to import
        except ImportError as error:
            raise MissingReaderError("a picture needs matplotlib; pip install matplotlib") from error
        figure = pyplot.figure(figsize=_size_of(panels), layout="constrained")
    n_across, n_down = _grid_of(panels)
    for number, panel in enumerate(panels):
        _draw(panel, figure.add_subplot(n_down, n_across, number + 1))
    return figure


def _grid_of(panels: Sequence[Panel]) -> tuple[int, int]:
    n_across = max(1, min(len(panels), _COLUMNS))
    return n_across, max(1, -(-len(panels) // n_across))


def _size_of(panels: Sequence[Panel]) -> tuple[float, float]:
    n_across, n_down = _grid_of(panels)
    return n_across * _WIDTH, n_down * _HEIGHT


def _draw(panel: Panel, axes: "Axes") -> None:
    title = f"{panel.title} (held out)" if panel.held_out else panel.title
    axes.set(title=title, xlabel=panel.x_name, ylabel=panel.y_name, yscale="log" if panel.logarithmic else "linear")
    if panel.interval is not None:
        lower, upper = (np.where(np.isfinite(end), end, panel.measured) for end in panel.interval)
        axes.vlines(panel.x, lower, upper, color="0.6")
    if np.isfinite(panel.measured).any():
        style = "o" if panel.x.size <= _FEW else "-"
        axes.plot(panel.x, panel.measured, style, color="0.3", markersize=3.0, label="measured")
    for name, values in panel.models.items():
        axes.plot(panel.x, values, label=name)
    if panel.models:
        axes.legend(frameon=False)


def to_frame(columns: Mapping[str, Sequence[Any] | _Values]) -> Any:  # noqa: ANN401 - pandas has no types
    """Return columns as a ``pandas.DataFrame``. Raises MissingReaderError without pandas."""
    try:
        import pandas as pd  # noqa: PLC0415  # an extra, and slow to import
    except ImportError as error:
        raise MissingReaderError("a table needs pandas; pip install pandas") from error
    return pd.DataFrame(columns)


def as_html(words: str, panels: Sequence[Panel]) -> str:
    """Return what a notebook shows of a record: its words, and its panels where matplotlib is installed."""
    said = f"<pre>{html.escape(words)}</pre>"
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415  # as above
    except ImportError:
        return said
    if not panels:
        return said
    drawn = io.StringIO()
    plot(panels, Figure(figsize=_size_of(panels), layout="constrained")).savefig(drawn, format="svg")
    svg = drawn.getvalue()
    return said + svg[svg.index("<svg") :]
