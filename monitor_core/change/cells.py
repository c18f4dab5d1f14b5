"""Sort responses of one time into cells, a position by a band as narrow as the line spacing, with their errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.effects.drive_effects import MODULUS_PER_KELVIN
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.lines import case_of, clear_lines, with_phase_within_half_a_turn
from monitor_core.models.extended import AxisPhysics, PreparedLines, prepare_lines, responses

#: A line whose amplitude is not this many times its noise says nothing that a logarithm could hold.
_LEAST_SIGNAL_TO_NOISE = 5.0
#: Positions nearer than this count as the same. [m]
_SAME_POSITION = 0.010
#: A response may be so far from the position that it counts for. [m]
_REACH = 0.030


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """All responses of one time; a cell has the mean of its lines, weighted by their noise."""

    lines: PreparedLines
    measured: ComplexArray  # ln Y, shape (n_lines,)
    variance_of_line: FloatArray  # of real and of imaginary part, shape (n_lines,)
    position_of_case: Indices  # shape (n_cases,)
    band: Indices  # of each line: its frequency over the width of the bands, rounded, shape (n_lines,)

    @property
    def position_of_line(self) -> Indices:
        """Which position each line belongs to, shape (n_lines,)."""
        return self.position_of_case[self.lines.case]

    def misfit(self, axis: AxisPhysics) -> ComplexArray:
        """Return ln H − ln Y of every line, phases within ±π, shape (n_lines,)."""
        return with_phase_within_half_a_turn(np.log(responses(axis, self.lines)) - self.measured)


@dataclass(frozen=True, slots=True, eq=False)
class CellMeans:
    """Means over cells, of values of the lines of one side."""

    cell: Indices  # of each line, −1 for none, shape (n_lines,)
    weight: FloatArray  # of each line in its cell, summing to one, shape (n_lines,)
    variance: FloatArray  # of the means, shape (n_cells,)

    def __call__(self, of_lines: ComplexArray) -> ComplexArray:
        """Return the mean of each cell, shape (n_cells,)."""
        used, n_cells = self.cell >= 0, self.variance.size
        cell, weighted = self.cell[used], (self.weight * of_lines)[used]
        real = np.bincount(cell, weights=weighted.real, minlength=n_cells)
        return np.asarray(real + 1j * np.bincount(cell, weights=weighted.imag, minlength=n_cells))


@dataclass(frozen=True, slots=True, eq=False)
class SideInCells:
    """All responses of one time, as means over cells."""

    side: Side
    means: CellMeans

    @property
    def measured(self) -> ComplexArray:
        """Mean of ln Y of each cell, shape (n_cells,)."""
        return self.means(self.side.measured)

    def misfit(self, axis: AxisPhysics) -> ComplexArray:
        """Return the mean of ln H − ln Y of each cell, shape (n_cells,)."""
        return self.means(self.side.misfit(axis))

    def measurements_per_position(self, n_positions: int) -> FloatArray:
        """Return how many measurements each position has, at least 1."""
        return np.maximum(np.bincount(self.side.position_of_case, minlength=n_positions), 1.0)


def positions_of(positions: FloatArray) -> FloatArray:
    """Return the mean of each group of positions that are the same but for scatter, rising. [m]."""
    rising = np.sort(positions)
    starts = np.flatnonzero(np.r_[True, np.diff(rising) > _SAME_POSITION])
    return np.array([np.mean(rising[low:high]) for low, high in pairwise([*starts, rising.size])])


def spacings(observations: Sequence[FrequencyResponseObservation]) -> tuple[float, float]:
    """Return the closest and the widest spacing of the lines of responses, in hertz."""
    widths = [
        float(np.median(np.diff(observation.frequency)))
        for observation in observations
        if observation.frequency.size > 1
    ]
    if not widths:
        raise NotIdentifiableError("expected responses of several lines; got single ones only")
    return min(widths), max(widths)


def side_of(observations: Sequence[FrequencyResponseObservation], positions: FloatArray, width: float) -> Side:
    """Put the responses of one time side by side; those near none of the positions are left out.

    Raises NotIdentifiableError if all are left out, or no line stands above its noise.
    """
    kept = []
    for observation in observations:
        distance = np.abs(positions - observation.conditions.position)
        nearest = int(np.argmin(distance))
        clear = clear_lines(observation, _LEAST_SIGNAL_TO_NOISE)
        if distance[nearest] <= _REACH and np.any(clear):
            kept.append((observation, nearest, clear))
    if not kept:
        raise NotIdentifiableError(
            f"expected responses within {1e3 * _REACH:g} mm of the positions compared, with lines that stand "
            f"{_LEAST_SIGNAL_TO_NOISE:g} times above their noise; got none"
        )
    lines = prepare_lines([case_of(observation, clear) for observation, _, clear in kept])
    response = np.concatenate([observation.response[clear] for observation, _, clear in kept])
    deviation = np.concatenate([observation.standard_deviation[clear] for observation, _, clear in kept])
    return Side(
        lines,
        np.asarray(np.log(response)),
        (deviation / np.abs(response)) ** 2,
        np.array([nearest for _, nearest, _ in kept]),
        np.round(lines.omega / (2.0 * np.pi * width)).astype(np.intp),
    )


def cells_of(side: Side) -> Indices:
    """Return the cells with lines, as (position, band) in rising order, shape (n_cells, 2)."""
    return np.unique(np.column_stack([side.position_of_line, side.band]), axis=0)


def common_cells(side: Side, other: Side) -> Indices:
    """Return the cells with lines on both sides."""
    in_other = {tuple(cell) for cell in cells_of(other).tolist()}
    both = [cell for cell in cells_of(side).tolist() if tuple(cell) in in_other]
    return np.array(both, dtype=np.intp).reshape(-1, 2)


def in_cells(side: Side, cells: Indices) -> SideInCells:
    """Prepare the means of one side over cells."""
    index = {tuple(key): number for number, key in enumerate(cells.tolist())}
    keys = np.column_stack([side.position_of_line, side.band]).tolist()
    cell = np.array([index.get(tuple(key), -1) for key in keys], dtype=np.intp)
    used = cell >= 0
    precision = 1.0 / side.variance_of_line
    total = np.bincount(cell[used], weights=precision[used], minlength=len(index))
    weight = np.where(used, precision / total[np.maximum(cell, 0)], 0.0)
    return SideInCells(side, CellMeans(cell, weight, 1.0 / total))


#: Errors that the cells of a position share, in the order of their columns.
CELL_ERRORS = ("position", "preload", "temperature", "gain", "delay")


@dataclass(frozen=True, slots=True)
class ChangeTolerances:
    """By how much two measurements of an unchanged axis differ, and what a model adds; standard deviations."""

    position: float = 0.2e-3  # homing, mounting of the encoder [m]
    preload_share: float = 0.005  # from day to day [-]
    temperature: float = 0.6  # sensor against screw, and what lubrication does to the stiffness alike [K]
    gain_share: float = 0.003  # [-]
    delay: float = 0.5e-6  # of one channel against the other, and what lubrication does to the phase alike [s]
    relative: float = 0.002  # σ_0: lubrication, leakage of the spectra [-]
    share_of_change: float = 0.05  # ε [-]
    form: float = 0.02  # of a model against one time alone, relative [-]


def moved(side: Side, errors: FloatArray, tolerances: ChangeTolerances) -> Side:
    r"""Return one time with its positions, preloads, temperatures, gains and delays moved by errors.

    ``errors`` are in standard deviations, shape (n_positions, n_errors). Where all stiffness softens by one share,
    accelerations are those of the cold axis at a higher frequency:

    .. math::

        A_{\vartheta}(\omega) = A\!\left( \omega / \sqrt{1 + \alpha \vartheta} \right), \qquad
        A(\omega) = -\omega^2 (K - \omega^2 M)^{-1}

    so that each position can have its own temperature, while an axis has a single one.
    """
    lines = side.lines
    position, preload, temperature, gain, delay = errors[side.position_of_case].T
    conditions = replace(
        lines.conditions,
        position=lines.conditions.position + tolerances.position * position,
        preload=lines.conditions.preload * (1.0 + tolerances.preload_share * preload),
    )
    raised = 1.0 / np.sqrt(1.0 + MODULUS_PER_KELVIN * tolerances.temperature * temperature)
    drive = replace(lines.drive, omega=lines.drive.omega * raised[lines.drive.case])
    of_channels = (tolerances.gain_share * gain)[lines.case] - 1j * lines.omega * (tolerances.delay * delay)[lines.case]
    return replace(
        side,
        lines=replace(lines, conditions=conditions, omega=lines.omega * raised[lines.case], drive=drive),
        measured=side.measured - of_channels,
    )
