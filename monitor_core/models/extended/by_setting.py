"""Let the physics of an axis depend on how it is set: a stiffness that follows the excitation, a drift of a preload.

An axis states such a dependence as functions that return it as it is at one setting. Settings at which it is the same,
as those of one excitation where a stiffness follows that, are evaluated together.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from monitor_core.models.extended.conditions import ConditionArrays
from monitor_core.models.extended.excitations import Excitations
from monitor_core.models.extended.lines import DriveLines, PreparedLines
from monitor_core.models.extended.memory import Memory
from monitor_core.models.extended.physics import AxisPhysics, AxisSetting

_Index = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class SettingLines:
    """The lines of some settings among those of all."""

    place: _Index  # of its lines among all, shape (n_lines_here,)
    cases: _Index  # its cases among all, shape (n_cases_here,)
    lines: PreparedLines  # under the conditions as stated

    def under(self, conditions: ConditionArrays) -> PreparedLines:
        """Return the lines under other conditions of all the cases."""
        return replace(self.lines, conditions=conditions.at(self.cases))


def axis_at(physics: AxisPhysics, setting: AxisSetting) -> AxisPhysics:
    """Return the axis as it is at one setting, which depends on settings no more.

    ``OutsideValidityError`` if there is no such axis.
    """
    axis = replace(physics, by_setting=())
    for change in physics.by_setting:
        axis = change(axis, setting)
    return axis


def axes_by_setting(physics: AxisPhysics, lines: PreparedLines) -> Iterator[tuple[AxisPhysics, SettingLines]]:
    """Yield the axes that it is at the settings, each with the lines of those at which it is that one.

    The same lines under other conditions share what is prepared.
    """
    alike: dict[AxisPhysics, list[int]] = {}
    split = _Split(lines)
    for number in _drive_cases(split):
        alike.setdefault(axis_at(physics, lines.conditions.setting(number)), []).append(number)
    for axis, numbers in alike.items():
        yield axis, _part(split, tuple(numbers))


class _Split:
    """Lines of all settings, equal to those that share their drive: only conditions are ever replaced."""

    def __init__(self, lines: PreparedLines) -> None:
        self._lines = lines

    def __hash__(self) -> int:
        return hash(id(self._lines.drive))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Split) and other._lines.drive is self._lines.drive

    def of(self, drive_cases: tuple[int, ...]) -> SettingLines:
        """Return the lines whose drive is evaluated under the conditions of some cases."""
        lines, drive = self._lines, self._lines.drive
        on_drive = np.flatnonzero(np.isin(drive.case, drive_cases))
        place = np.flatnonzero(np.isin(drive.case[lines.drive_line], drive_cases))
        cases = np.unique(lines.case[place])

        def among(chosen: _Index) -> _Index:
            return np.flatnonzero(np.isin(place, chosen))

        here = PreparedLines(
            conditions=lines.conditions.at(cases),
            case=np.searchsorted(cases, lines.case[place]),
            omega=lines.omega[place],
            drive=DriveLines(
                np.searchsorted(cases, drive.case[on_drive]),
                drive.omega[on_drive],
                drive.ends.at(on_drive),
                Memory(on_drive.size),
            ),
            drive_line=np.searchsorted(on_drive, lines.drive_line[place]),
            by_torque=lines.by_torque[place],
            table_per_force=among(lines.table_per_force),
            acceleration=among(lines.acceleration),
            at_nut=among(lines.at_nut),
            angle_per_torque=among(lines.angle_per_torque),
            beyond_screw=among(lines.beyond_screw),
            excitations=_excitations(lines.excitations, cases),
        )
        return SettingLines(place, cases, here)

    def numbers(self) -> tuple[int, ...]:
        """Return the cases under whose conditions the drive is evaluated."""
        return tuple(np.unique(self._lines.drive.case).tolist())


@lru_cache(maxsize=8)
def _drive_cases(split: _Split) -> tuple[int, ...]:
    return split.numbers()


@lru_cache(maxsize=256)
def _part(split: _Split, drive_cases: tuple[int, ...]) -> SettingLines:
    return split.of(drive_cases)


def _excitations(excitations: Excitations, cases: _Index) -> Excitations:
    """Return the excitations of some of the cases."""
    numbers, first = np.unique(excitations.of_case[cases], return_index=True)
    numbers, first = numbers[numbers >= 0], first[numbers >= 0]  # small signals have none
    of_case = np.where(excitations.of_case[cases] < 0, -1, np.searchsorted(numbers, excitations.of_case[cases]))
    knots = np.flatnonzero(np.isin(excitations.of_knot, numbers))
    points = np.flatnonzero(np.isin(excitations.of_point, numbers))
    of_point = np.searchsorted(numbers, excitations.of_point[points])
    return Excitations(
        of_case=of_case,
        case=first,
        of_knot=np.searchsorted(numbers, excitations.of_knot[knots]),
        omega=excitations.omega[knots],
        ends=excitations.ends.at(knots),
        by_torque=excitations.by_torque[knots],
        interpolation=excitations.interpolation[points][:, knots] if numbers.size else None,
        of_point=of_point,
        first_point=np.searchsorted(of_point, np.arange(numbers.size)),
        weight=excitations.weight[points],
    )
