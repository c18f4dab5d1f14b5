"""Coulomb friction of a rigid axis in motion."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, coulomb_friction=axis.coulomb_friction + values["friction_n"])


COULOMB_FRICTION = Effect(
    key="coulomb-friction",
    name="Coulomb friction",
    physics=(
        "A force of constant size opposes the motion, whatever its speed. It shows as a jump at every reversal; in one "
        "direction alone it looks like an offset of the recorded force."
    ),
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(EffectParameter("friction_n", "N", lower=0.0, upper=1000.0, scale=5.0),),
    add=_add,
    needs=frozenset({ConditionAxis.DIRECTION}),
)
