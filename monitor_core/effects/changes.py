"""How an effect changes the description of an axis: one of its records, the others as they are."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from monitor_core.models.extended import AxisPhysics
from monitor_core.models.motion import MotionPhysics


def changed_screw(axis: AxisPhysics, **changes: float) -> AxisPhysics:
    """Return the axis with another screw."""
    return replace(axis, screw=replace(axis.screw, **changes))


def changed_joints(axis: AxisPhysics, **changes: float) -> AxisPhysics:
    """Return the axis with other joints."""
    return replace(axis, joints=replace(axis.joints, **changes))


def changed_added(axis: AxisPhysics, **changes: float) -> AxisPhysics:
    """Return the axis with something else added."""
    return replace(axis, added=replace(axis.added, **changes))


def increasing(record: str, quantity: str, *, by: str) -> Callable[[AxisPhysics, Mapping[str, float]], AxisPhysics]:
    """Return the change of a drive that adds a value to one quantity of one of its records.

    Parameters
    ----------
    record, quantity : str
        Fields of ``AxisPhysics`` and of that record.
    by : str
        Name of the value that is added.
    """
    return partial(_increased, record, quantity, by)


def increasing_force(quantity: str, *, by: str) -> Callable[[MotionPhysics, Mapping[str, float]], MotionPhysics]:
    """Return the change of a rigid axis that adds a value to one of its quantities."""
    return partial(_increased_force, quantity, by)


def _increased(record: str, quantity: str, by: str, axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    part = getattr(axis, record)
    return replace(axis, **{record: replace(part, **{quantity: getattr(part, quantity) + values[by]})})


def _increased_force(quantity: str, by: str, axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, **{quantity: getattr(axis, quantity) + values[by]})
