"""A recorded force with an offset."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, force_offset=axis.force_offset + values["force_n"])


FORCE_OFFSET = Effect(
    key="force-offset",
    name="Offset of the recorded force",
    physics=(
        "The drive records a force where there is none, or a constant force acts, as a weight on an inclined axis. "
        "It is the same at every speed, and so is a difference of Coulomb friction between the directions."
    ),
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(EffectParameter("force_n", "N", lower=-200.0, upper=200.0, scale=2.0),),
    add=_add,
    needs=frozenset({ConditionAxis.DIRECTION}),
)
