"""Put axes side by side, one for each condition, so that they are evaluated at once: arrays of what differs.

The closed form does with an array what it does with a number, as long as the axes have the same terms: what is null, or
infinite, is so in all of them. Each of the axes has been checked by itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from operator import attrgetter
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.models.extended.physics import (
    AddedPhysics,
    AxisPhysics,
    BodyPhysics,
    JointPhysics,
    ScrewBending,
    ScrewPhysics,
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
        return _assembled({name: _repeated(getattr(self, name), index) for name in RECORDS})


def alike_in_terms(axes: Sequence[AxisPhysics]) -> list[_Index]:
    """Return which axes have the same terms, by their numbers."""
    marks = np.hstack([_marks(_table(axes, name), name) for name in RECORDS])
    if np.all(marks == marks[0]):
        return [np.arange(len(axes))]
    which = np.unique(marks, axis=0, return_inverse=True)[1].reshape(-1)
    return [np.flatnonzero(which == number) for number in range(int(np.max(which)) + 1)]


def side_by_side(axes: Sequence[AxisPhysics]) -> AxisPhysics:
    """Return axes of the same terms side by side; the axis itself where all are the same."""
    records: dict[str, object] = {}
    for name, names in _NAMES.items():
        table, first = _table(axes, name), getattr(axes[0], name)
        differing = np.flatnonzero(np.any((table != table[0]) & ~np.isnan(table), axis=0)).tolist()
        records[name] = (
            with_values(first, {names[column]: table[:, column] for column in differing}) if differing else first
        )
    if all(records[name] is getattr(axes[0], name) for name in records):
        return axes[0]
    return _assembled(records)


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
    found = object.__new__(type(record))
    for item in fields(record):  # type: ignore[arg-type]
        object.__setattr__(found, item.name, values[item.name] if item.name in values else getattr(record, item.name))
    return found


def _assembled(records: Mapping[str, object]) -> AxesSideBySide:
    """Return axes of these records, which depend on settings no more."""
    axes = object.__new__(AxesSideBySide)
    for name, record in (*records.items(), ("by_setting", ())):
        object.__setattr__(axes, name, record)
    return axes
