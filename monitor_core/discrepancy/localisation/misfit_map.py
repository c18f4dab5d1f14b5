"""Draw up maps of the misfit: its rms by the values of a condition and by frequency band."""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import CONDITIONS, by_condition, by_frequency, by_stretch


def varied_conditions_of_maps(layout: Layout) -> tuple[ConditionAxis, ...]:
    """Return what a picture of the misfit may go over: every condition of which there is more than one value."""
    groupings = {axis: by_condition(layout, axis) for axis in CONDITIONS}
    return tuple(axis for axis, grouping in groupings.items() if grouping is not None and grouping.n_groups > 1)


def misfit_map(
    layout: Layout, standardised: FloatArray, over: ConditionAxis | None, bands: int = 8
) -> tuple[tuple[str, ...], tuple[str, ...], FloatArray]:
    """Return the names of rows and columns, and the rms of the standardised misfit, shape (n_rows, n_columns).

    The rows are the values of a condition, or one row of everything. The columns are bands of frequency, modes, or
    stretches of settings one after the other, at most ``bands`` of them. The rms is NaN where there is no value.
    """
    rows = (None if over is None else by_condition(layout, over)) or by_stretch(layout, 1)
    columns = by_frequency(layout, bands) or by_stretch(layout, bands)
    both = (rows.group >= 0) & (columns.group >= 0)
    cell = rows.group[both] * columns.n_groups + columns.group[both]
    n_cells = rows.n_groups * columns.n_groups
    n = np.bincount(cell, minlength=n_cells)
    squares = np.bincount(cell, weights=standardised[both] ** 2, minlength=n_cells)
    mean = np.divide(squares, n, out=np.full(n_cells, np.nan), where=n > 0)
    return rows.names, columns.names, np.sqrt(mean).reshape(rows.n_groups, columns.n_groups)
