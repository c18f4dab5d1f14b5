r"""Differentiate the logarithms of responses as an axis moves: all derivatives for the price of a few evaluations.

An axis is a list of numbers. By each of them the drive's answer is differentiated backwards (:mod:`.traced`); how far
each number goes with a move, as a difference quotient of the axes ahead and behind, then gives

.. math:: \frac{d \ln H}{d u} = \frac1H \sum_k \frac{\partial H}{\partial x_k} \frac{d x_k}{d u}

What a channel adds, a second mode or a delay, costs little and is a difference quotient itself. Where a number acts
through the amplitude of the motion, every line depends on all others, and there is no answer here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, logarithm
from monitor_core.models.extended.closed_form import entire_parts, path_of
from monitor_core.models.extended.conditions import ConditionArrays, axis_states
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics, AxisSetting, Move
from monitor_core.models.extended.responses import motions, observed, with_second_mode
from monitor_core.models.extended.settings import (
    NUMBERS,
    RECORDS,
    alike_in_terms,
    axis_at,
    numbers_of,
    side_by_side,
    with_values,
)
from monitor_core.models.extended.traced import Traced, derivatives, value_of

_NAMES = [name for _, name in NUMBERS]
#: Numbers that act through the amplitude of the motion, and those that act on what channels record besides the drive.
_OF_LEVEL = np.array([name in ("guide_friction", "cubic_nut_stiffness") for name in _NAMES])
_OF_CHANNELS = np.array(
    [
        name == "lead" or name.startswith(("second_mode_", "mounting_")) or name.endswith(("_delay", "_ln_factor"))
        for name in _NAMES
    ]
)


def log_response_slopes(
    physics: AxisPhysics, lines: PreparedLines, moves: Sequence[Move[AxisPhysics]]
) -> list[ComplexArray | None]:
    """Return the derivative of ln H by each move, shape (n_lines,); None of a move that has no answer here.

    It acts through the amplitude of the motion, brings in what was infinite, or the axis has other terms at some
    settings than at others. ``OutsideValidityError`` if the axis or one of the others has no answer at a setting.
    """
    of_cases = _OfCases.of(lines.conditions)
    axes = of_cases.axes(physics)
    here = numbers_of(axes)
    has_level = lines.excitations.size > 0
    if (has_level and np.any(here[:, _OF_LEVEL])) or len(alike_in_terms(axes)) > 1:
        return [None] * len(moves)
    rates = [of_cases.rate(move, physics, here) for move in moves]
    answered = [bool(np.all(np.isfinite(rate))) and not (has_level and np.any(rate[:, _OF_LEVEL])) for rate in rates]
    moving = np.zeros(len(NUMBERS), dtype=np.bool_)
    for rate, is_answered in zip(rates, answered, strict=True):
        moving |= np.any(rate, axis=0) & is_answered
    drive = _Drive.of(of_cases.side_by_side(axes), lines, moving)
    per_displacement = 1.0 / with_second_mode(drive.values, physics, lines)
    slopes: list[ComplexArray | None] = []
    for move, rate, is_answered in zip(moves, rates, answered, strict=True):
        if not is_answered:
            slopes.append(None)
            continue
        slope = drive.slope(of_cases.at_lines(rate, lines)) * per_displacement
        if np.any(rate[:, _OF_CHANNELS]):
            ends = (of_cases.side_by_side(of_cases.axes(axis)) for axis in (move.ahead, move.behind))
            ahead, behind = (observed(drive.values, axis, lines) for axis in ends)
            slope += logarithm(ahead / behind) / move.distance
        slopes.append(slope)
    return slopes


@dataclass(frozen=True, slots=True, eq=False)
class _OfCases:
    """The settings that the axis has to be known at, and which of them each case has."""

    settings: tuple[AxisSetting, ...]
    of_case: npt.NDArray[np.intp]

    @classmethod
    def of(cls, conditions: ConditionArrays) -> "_OfCases":
        numbers: dict[AxisSetting, int] = {}
        each = [conditions.setting(case) for case in range(conditions.position.size)]
        of_case = np.array([numbers.setdefault(setting, len(numbers)) for setting in each])
        return cls(tuple(numbers), of_case)

    def axes(self, physics: AxisPhysics) -> list[AxisPhysics]:
        """Return the axis at each setting, or the one that it is at all of them."""
        return [axis_at(physics, setting) for setting in self.settings] if physics.by_setting else [physics]

    def rate(self, move: Move[AxisPhysics], physics: AxisPhysics, here: FloatArray) -> FloatArray:
        """Return how fast each number goes along a move, a row for each setting or one for all; infinite from there."""
        ahead, behind = (here if axis is physics else numbers_of(self.axes(axis)) for axis in (move.ahead, move.behind))
        same = (ahead == behind) | np.isnan(ahead)
        with np.errstate(invalid="ignore"):
            return np.where(same, 0.0, (ahead - behind) / move.distance)

    def side_by_side(self, axes: Sequence[AxisPhysics]) -> AxisPhysics:
        """Return the axes for each case."""
        return axes[0] if len(axes) == 1 else side_by_side([axes[number] for number in self.of_case.tolist()])

    def at_lines(self, rate: FloatArray, lines: PreparedLines) -> dict[int, FloatArray | float]:
        """Return the rates that are not null by number, a number for each line or one for all."""
        rates: dict[int, FloatArray | float] = {}
        for number in np.flatnonzero(np.any(rate, axis=0)).tolist():
            along = rate[:, number]
            alike = bool(np.all(along == along[0]))
            rates[number] = float(along[0]) if alike else along[self.of_case[lines.case]]
        return rates


@dataclass(frozen=True, slots=True, eq=False)
class _Drive:
    """Displacements and angles of all lines, and their derivatives by the numbers that move."""

    values: ComplexArray  # shape (n_lines,)
    by_number: dict[int, ComplexArray]  # shape (n_lines,) each

    @classmethod
    def of(cls, physics: AxisPhysics, lines: PreparedLines, moving: BoolArray) -> "_Drive":
        """Evaluate the drive without what acts through the amplitude of its motion, and differentiate it."""
        drive, on_drive = lines.drive, physics.at(lines.drive.case)
        traced: dict[int, Traced] = {}
        records = {name: getattr(on_drive, name) for name in RECORDS}
        for number in np.flatnonzero(moving).tolist():
            record, name = NUMBERS[number]
            traced[number] = Traced(getattr(records[record], name))
            records[record] = with_values(records[record], {name: traced[number]})
        axis = AxisPhysics(**records, second=on_drive.second)
        states = axis_states(axis, lines.conditions.at(drive.case))
        path = path_of(entire_parts(axis, drive.omega, states, drive.ends))
        values = np.empty(lines.omega.size, dtype=np.complex128)
        by_number = {number: np.zeros(lines.omega.size, dtype=np.complex128) for number in traced}
        for seeing, motion in motions(path, axis, lines):
            from_drive = lines.drive_line[seeing]
            values[seeing] = value_of(motion)[from_drive]
            if isinstance(motion, Traced):
                slopes = derivatives(motion, list(traced.values()))
                for number, slope in zip(traced, slopes, strict=True):
                    by_number[number][seeing] = slope[from_drive] if np.ndim(slope) else slope
        return cls(values, by_number)

    def slope(self, rates: dict[int, FloatArray | float]) -> ComplexArray:
        """Return the derivative of values along a move."""
        total = np.zeros_like(self.values)
        for number, rate in rates.items():
            if number in self.by_number:
                total += self.by_number[number] * rate
        return total
