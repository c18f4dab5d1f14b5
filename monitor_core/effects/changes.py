"""How an effect changes the description of an axis, and what an axis must have or lack for it.

A quantity stands with the name of the value that changes it: ``increasing("added", table_mass="mass_kg")``. What these
functions return can be pickled, as a search in several processes needs.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from monitor_core.models.extended import AxisPhysics
from monitor_core.models.motion import MotionPhysics


def changed(axis: AxisPhysics, record: str, **changes: float) -> AxisPhysics:
    """Return the axis with other values in one of its records."""
    return replace(axis, **{record: replace(getattr(axis, record), **changes)})


def increasing(record: str, **by: str) -> Callable[[AxisPhysics, Mapping[str, float]], AxisPhysics]:
    """Return the change of a drive that adds values to quantities of one of its records."""
    return partial(_increased, record, by)


def setting(record: str, **to: str) -> Callable[[AxisPhysics, Mapping[str, float]], AxisPhysics]:
    """Return the change of a drive that puts values in place of quantities of one of its records."""
    return partial(_set, record, to)


def scaling(record: str, **by: str) -> Callable[[AxisPhysics, Mapping[str, float]], AxisPhysics]:
    """Return the change of a drive that multiplies quantities of one of its records by e to the power of values."""
    return partial(_scaled, record, by)


def having(record: str, quantity: str) -> Callable[[AxisPhysics], bool]:
    """Return the condition that a drive states a quantity, and not as zero."""
    return partial(_has, record, quantity, True)


def lacking(record: str, quantity: str) -> Callable[[AxisPhysics], bool]:
    """Return the condition that a drive has nothing of a quantity yet."""
    return partial(_has, record, quantity, False)


def increasing_force(quantity: str, *, by: str) -> Callable[[MotionPhysics, Mapping[str, float]], MotionPhysics]:
    """Return the change of a rigid axis that adds a value to one of its quantities."""
    return partial(_increased_force, quantity, by)


def _increased(record: str, by: Mapping[str, str], axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    part = getattr(axis, record)
    return changed(axis, record, **{quantity: getattr(part, quantity) + values[name] for quantity, name in by.items()})


def _set(record: str, to: Mapping[str, str], axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed(axis, record, **{quantity: values[name] for quantity, name in to.items()})


def _scaled(record: str, by: Mapping[str, str], axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    part = getattr(axis, record)
    return changed(axis, record, **{item: getattr(part, item) * math.exp(values[name]) for item, name in by.items()})


def _has(record: str, quantity: str, wanted: bool, axis: AxisPhysics) -> bool:
    return bool(getattr(getattr(axis, record), quantity)) is wanted


def _increased_force(quantity: str, by: str, axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, **{quantity: getattr(axis, quantity) + values[by]})
