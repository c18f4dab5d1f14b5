"""Let the physics of an axis depend on how it is set: a stiffness that follows the excitation, a drift of a preload.

An axis states such a dependence as functions that return it as it is at one setting; each setting is then a drive of
its own, evaluated by itself.
"""

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
    """The lines of one setting and one excitation among those of all."""

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


def lines_by_setting(lines: PreparedLines) -> tuple[SettingLines, ...]:
    """Return the lines of each setting by themselves; the same lines under other conditions share what is prepared."""
    return _Split(lines).parts


class _Split:
    """Lines of all settings, equal to those that share their drive: only conditions are ever replaced."""

    def __init__(self, lines: PreparedLines) -> None:
        self._lines = lines

    def __hash__(self) -> int:
        return hash(id(self._lines.drive))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Split) and other._lines.drive is self._lines.drive

    @property
    def parts(self) -> tuple[SettingLines, ...]:
        """The lines of each setting."""
        return _parts(self)

    def of(self, drive_case: int) -> SettingLines:
        """Return the lines whose drive is evaluated under the conditions of one case."""
        lines, drive = self._lines, self._lines.drive
        on_drive = np.flatnonzero(drive.case == drive_case)
        place = np.flatnonzero(drive.case[lines.drive_line] == drive_case)
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
            excitations=_excitation(lines.excitations, cases),
        )
        return SettingLines(place, cases, here)

    def numbers(self) -> list[int]:
        """Return the cases under whose conditions the drive is evaluated."""
        return [int(case) for case in np.unique(self._lines.drive.case)]


@lru_cache(maxsize=8)
def _parts(split: _Split) -> tuple[SettingLines, ...]:
    return tuple(split.of(number) for number in split.numbers())


def _excitation(excitations: Excitations, cases: _Index) -> Excitations:
    """Return the one excitation of cases that were taken together, none where they are of small signals."""
    number = int(excitations.of_case[cases[0]])
    knots, points = np.flatnonzero(excitations.of_knot == number), np.flatnonzero(excitations.of_point == number)
    stated = number >= 0
    return Excitations(
        of_case=np.full(cases.size, 0 if stated else -1),
        case=np.zeros(1 if stated else 0, dtype=np.intp),
        of_knot=np.zeros(knots.size, dtype=np.intp),
        omega=excitations.omega[knots],
        ends=excitations.ends.at(knots),
        by_torque=excitations.by_torque[knots],
        interpolation=excitations.interpolation[points][:, knots] if stated else None,
        of_point=np.zeros(points.size, dtype=np.intp),
        first_point=np.zeros(1 if stated else 0, dtype=np.intp),
        weight=excitations.weight[points],
    )
