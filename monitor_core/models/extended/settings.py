"""Let the physics of an axis depend on how it is set: a stiffness that follows the excitation, a drift of a preload.

An axis states such a dependence as functions that return it as it is at one setting. All settings are evaluated
together, as axes side by side: arrays of what differs, with which the closed form does what it does with a number, as
long as the axes have the same terms, so that what is null, or infinite, is so in all of them. Settings at which the
axis has other terms, as a spring that is absent at some, are evaluated apart.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from operator import attrgetter
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.models.extended.conditions import ConditionArrays
from monitor_core.models.extended.lines import DriveLines, Excitations, PreparedLines
from monitor_core.models.extended.memory import Memory
from monitor_core.models.extended.physics import (
    AddedPhysics,
    AxisPhysics,
    AxisSetting,
    BodyPhysics,
    JointPhysics,
    ScrewBending,
    ScrewPhysics,
    SecondAxis,
)

_Index = npt.NDArray[np.intp]
RECORDS = {
    "screw": ScrewPhysics,
    "joints": JointPhysics,
    "bodies": BodyPhysics,
    "added": AddedPhysics,
    "bending": ScrewBending,
}
_NAMES = {name: tuple(item.name for item in fields(record)) for name, record in RECORDS.items()}
#: What an iteration of its own, or a check, has to be told as one number.
_ONE_NUMBER = ("dynamic_load_rating", "guide_friction", "cubic_nut_stiffness")

#: Every number that an axis has, by its record and its name there.
NUMBERS = tuple((record, name) for record, names in _NAMES.items() for name in names)

Record = TypeVar("Record")


class AxesSideBySide(AxisPhysics):
    """An axis for each of many conditions: numbers that differ are arrays over them; without dependence on settings."""

    __slots__ = ()

    def at(self, index: _Index) -> "AxesSideBySide":
        """Return the axes repeated for lines that belong to the conditions of this index."""
        return _assembled({name: _repeated(getattr(self, name), index) for name in RECORDS}, self.second)


def alike_in_terms(axes: Sequence[AxisPhysics]) -> list[_Index]:
    """Return which axes have the same terms, by their numbers."""
    marks = np.hstack([_marks(_table(axes, name), name) for name in RECORDS])
    if np.all(marks == marks[0]):
        return [np.arange(len(axes))]
    which = np.unique(marks, axis=0, return_inverse=True)[1].reshape(-1)
    return [np.flatnonzero(which == number) for number in range(int(np.max(which)) + 1)]


def side_by_side(axes: Sequence[AxisPhysics]) -> AxisPhysics:
    """Return axes of the same terms side by side; the axis itself where all are the same."""
    if len(axes) == 1:
        return axes[0]
    records: dict[str, object] = {}
    for name, names in _NAMES.items():
        table, first = _table(axes, name), getattr(axes[0], name)
        differing = np.flatnonzero(np.any((table != table[0]) & ~np.isnan(table), axis=0)).tolist()
        records[name] = (
            with_values(first, {names[column]: table[:, column] for column in differing}) if differing else first
        )
    if all(records[name] is getattr(axes[0], name) for name in records):
        return axes[0]
    return _assembled(records, axes[0].second)


def numbers_of(axes: Sequence[AxisPhysics]) -> FloatArray:
    """Return all numbers of axes in the order of ``NUMBERS``, NaN for what is not stated, (n_axes, n_numbers)."""
    return np.hstack([_table(axes, name) for name in RECORDS])


def _table(axes: Sequence[AxisPhysics], name: str) -> FloatArray:
    """Return the numbers of one record of each axis, a row alone where it is one object; NaN for what is not stated."""
    records = [getattr(axis, name) for axis in axes]
    read = attrgetter(*_NAMES[name])
    if all(record is records[0] for record in records):
        records = records[:1]
    rows = np.array([read(record) for record in records], dtype=np.float64)
    return np.broadcast_to(rows, (len(axes), rows.shape[1]))


def _marks(table: FloatArray, name: str) -> FloatArray:
    """Return which terms a record has: 1 for what is there, and what is to be told as one number itself."""
    marks = np.where((table == 0.0) | np.isinf(table), table, 1.0)
    for column, quantity in enumerate(_NAMES[name]):
        if quantity in _ONE_NUMBER:
            marks[:, column] = np.nan_to_num(table[:, column], nan=-1.0)
    return marks


def _repeated(record: Record, index: _Index) -> Record:
    names = (item.name for item in fields(record))  # type: ignore[arg-type]
    arrays = {name: value[index] for name in names if isinstance(value := getattr(record, name), np.ndarray)}
    return with_values(record, arrays) if arrays else record


def with_values(record: Record, values: Mapping[str, object]) -> Record:
    """Return a record with others in the place of some numbers, as arrays, which its checks are not made for."""
    changed = object.__new__(type(record))
    for item in fields(record):  # type: ignore[arg-type]
        object.__setattr__(changed, item.name, values[item.name] if item.name in values else getattr(record, item.name))
    return changed


def _assembled(records: Mapping[str, object], second: SecondAxis | None) -> AxesSideBySide:
    """Return axes of these records, which depend on settings no more."""
    axes = object.__new__(AxesSideBySide)
    for name, record in (*records.items(), ("second", second), ("by_setting", ())):
        object.__setattr__(axes, name, record)
    return axes


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
    split, axis_of = _Split(lines), dict[AxisSetting, AxisPhysics]()
    of_case = [lines.conditions.setting(number) for number in range(lines.conditions.position.size)]
    for setting in of_case:
        if setting not in axis_of:
            axis_of[setting] = axis_at(physics, setting)
    on_drive = np.array(_drive_cases(split))
    for group in alike_in_terms([axis_of[of_case[number]] for number in on_drive]):
        part = _part(split, tuple(on_drive[group].tolist()))
        yield side_by_side([axis_of[of_case[number]] for number in part.cases.tolist()]), part


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
