"""Measured responses of one axis, sorted into cells: a place on the axis by a band as narrow as the lines are apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.clear_lines import case_of, clear_lines, with_phase_within_half_a_turn
from monitor_core.models.extended import AxisPhysics, PreparedLines, prepare_lines, responses

ComplexValues = npt.NDArray[np.complex128]
Indices = npt.NDArray[np.intp]

#: A line whose amplitude is not this many times its noise says nothing that a logarithm could hold.
_LEAST_SIGNAL_TO_NOISE = 5.0
#: Positions nearer than this are one place. [m]
_ONE_PLACE = 0.010
#: A reference may be so far from the place that it is for. [m]
_REACH = 0.030


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """All responses of one time; a cell has the mean of its lines, weighted by their noise."""

    lines: PreparedLines
    measured: ComplexValues  # ln Y, shape (n_lines,)
    variance_of_line: FloatArray  # of real and of imaginary part, shape (n_lines,)
    place_of_case: Indices  # shape (n_cases,)
    band: Indices  # of each line: its frequency over the width of the bands, rounded, shape (n_lines,)

    @property
    def place(self) -> Indices:
        """Place of each line, shape (n_lines,)."""
        return self.place_of_case[self.lines.case]

    def misfit(self, axis: AxisPhysics) -> ComplexValues:
        """Return ln H − ln Y of every line, phases within ±π, shape (n_lines,)."""
        return with_phase_within_half_a_turn(np.log(responses(axis, self.lines)) - self.measured)


@dataclass(frozen=True, slots=True, eq=False)
class CellMeans:
    """Means over cells, of values of the lines of one side."""

    cell: Indices  # of each line, −1 for none, shape (n_lines,)
    weight: FloatArray  # of each line in its cell, summing to one, shape (n_lines,)
    variance: FloatArray  # of the means, shape (n_cells,)

    def __call__(self, of_lines: ComplexValues) -> ComplexValues:
        """Return the mean of each cell, shape (n_cells,)."""
        used, n_cells = self.cell >= 0, self.variance.size
        cell, weighted = self.cell[used], (self.weight * of_lines)[used]
        real = np.bincount(cell, weights=weighted.real, minlength=n_cells)
        return np.asarray(real + 1j * np.bincount(cell, weights=weighted.imag, minlength=n_cells))


def places_of(positions: FloatArray) -> FloatArray:
    """Return the mean position of each place: positions follow one another more closely there than between places."""
    rising = np.sort(positions)
    starts = np.flatnonzero(np.r_[True, np.diff(rising) > _ONE_PLACE])
    return np.array([np.mean(rising[low:high]) for low, high in pairwise([*starts, rising.size])])


def spacings(observations: Sequence[FrequencyResponseObservation]) -> tuple[float, float]:
    """Return how far the lines of a response are apart in hertz: where they are closest, and where they are widest."""
    widths = [float(np.median(np.diff(one.frequency))) for one in observations if one.frequency.size > 1]
    if not widths:
        raise NotIdentifiableError("expected responses of several lines; got single ones only")
    return min(widths), max(widths)


def side_of(observations: Sequence[FrequencyResponseObservation], places: FloatArray, width: float) -> Side:
    """Put the responses of one time side by side; those near no place are left out.

    Raises
    ------
    NotIdentifiableError
        If all are, or no line stands above its noise.
    """
    kept = []
    for one in observations:
        place = int(np.argmin(np.abs(places - one.conditions.position)))
        clear = clear_lines(one, _LEAST_SIGNAL_TO_NOISE)
        if abs(places[place] - one.conditions.position) <= _REACH and np.any(clear):
            kept.append((one, place, clear))
    if not kept:
        raise NotIdentifiableError(
            f"expected responses within {1e3 * _REACH:g} mm of the places compared, with lines that stand "
            f"{_LEAST_SIGNAL_TO_NOISE:g} times above their noise; got none"
        )
    lines = prepare_lines([case_of(one, clear) for one, _, clear in kept])
    response = np.concatenate([one.response[clear] for one, _, clear in kept])
    deviation = np.concatenate([one.standard_deviation[clear] for one, _, clear in kept])
    return Side(
        lines,
        np.asarray(np.log(response)),
        (deviation / np.abs(response)) ** 2,
        np.array([place for _, place, _ in kept]),
        np.round(lines.omega / (2.0 * np.pi * width)).astype(np.intp),
    )


def cells_of(side: Side) -> Indices:
    """Return the cells with lines, as (place, band) in rising order, shape (n_cells, 2)."""
    return np.unique(np.column_stack([side.place, side.band]), axis=0)


def common_cells(side: Side, other: Side) -> Indices:
    """Return the cells with lines on both sides."""
    in_other = {tuple(one) for one in cells_of(other).tolist()}
    return np.array([one for one in cells_of(side).tolist() if tuple(one) in in_other], dtype=np.intp).reshape(-1, 2)


def cell_means(side: Side, cells: Indices) -> CellMeans:
    """Prepare the means of one side over cells."""
    index = {tuple(one): number for number, one in enumerate(cells.tolist())}
    keys = np.column_stack([side.place, side.band]).tolist()
    cell = np.array([index.get(tuple(one), -1) for one in keys], dtype=np.intp)
    used = cell >= 0
    precision = 1.0 / side.variance_of_line
    total = np.bincount(cell[used], weights=precision[used], minlength=len(index))
    weight = np.where(used, precision / total[np.maximum(cell, 0)], 0.0)
    return CellMeans(cell, weight, 1.0 / total)


def measurements_per_place(side: Side, n_places: int) -> FloatArray:
    """Return how many measurements each place has."""
    return np.bincount(side.place_of_case, minlength=n_places).astype(np.float64)
