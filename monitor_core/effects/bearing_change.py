"""A bearing that has become softer or stiffer than it was."""

import math
from collections.abc import Mapping

from monitor_core.effects.changes import changed_joints
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics

_SOURCE = "no source: the springs at the ends of the screw, Eqs. (9) and (10) of Tian et al."
_RATIO = EffectParameter("ln_ratio", "-", lower=-4.0, upper=2.0, scale=0.1)


def _add_near(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_joints(axis, bearing_stiffness=axis.joints.bearing_stiffness * math.exp(values["ln_ratio"]))


def _add_far(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_joints(axis, far_bearing_stiffness=axis.joints.far_bearing_stiffness * math.exp(values["ln_ratio"]))


def _has_far_bearing(axis: AxisPhysics) -> bool:
    return axis.joints.far_bearing_stiffness > 0.0


BEARING_CHANGE = Effect(
    key="bearing-change",
    name="Change of the fixed bearing",
    physics="The fixed bearing has come loose or lost its preload: frequencies fall, most with the table near to it.",
    source=_SOURCE,
    parameters=(_RATIO,),
    add=_add_near,
)

FAR_BEARING_CHANGE = Effect(
    key="far-bearing-change",
    name="Change of the far bearing",
    physics="The far bearing holds less than it did: frequencies fall, most with the table near to it.",
    source=_SOURCE,
    parameters=(_RATIO,),
    add=_add_far,
    applies=_has_far_bearing,
)
