"""Let the physics of an axis depend on how it is set: a stiffness that follows the excitation, a drift of a preload.

An axis states such a dependence as functions that return it as it is at one setting. All settings are evaluated
together, with arrays of what differs; those apart at which it has other terms, as a spring that is absent at some.
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
from monitor_core.models.extended.side_by_side import alike_in_terms, side_by_side

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
    """Yield axes side by side, one for each case, with the lines of those cases; all that have the same terms at once.

    The same lines under other conditions share what is prepared.
    """
    split, known = _Split(lines), dict[AxisSetting, AxisPhysics]()
    of_case = [lines.conditions.setting(number) for number in range(lines.conditions.position.size)]
    for setting in of_case:
        if setting not in known:
            known[setting] = axis_at(physics, setting)
    on_drive = np.array(_drive_cases(split))
    for group in alike_in_terms([known[of_case[number]] for number in on_drive]):
        part = _part(split, tuple(on_drive[group].tolist()))
        yield side_by_side([known[of_case[number]] for number in part.cases.tolist()]), part


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
        weight=excitations.weight[points],
        memory=Memory(knots.size),
    )
