"""How an effect changes the description of an axis: one of its records, the others as they are."""

from dataclasses import replace

from monitor_core.models.extended import AxisPhysics


def changed_screw(axis: AxisPhysics, **changes: float) -> AxisPhysics:
    """Return the axis with another screw."""
    return replace(axis, screw=replace(axis.screw, **changes))


def changed_joints(axis: AxisPhysics, **changes: float) -> AxisPhysics:
    """Return the axis with other joints."""
    return replace(axis, joints=replace(axis.joints, **changes))


def changed_added(axis: AxisPhysics, **changes: float) -> AxisPhysics:
    """Return the axis with something else added."""
    return replace(axis, added=replace(axis.added, **changes))
