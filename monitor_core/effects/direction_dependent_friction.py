"""Friction that depends on the direction of motion."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, viscous_difference=axis.viscous_difference + values["viscous_difference_ns_per_m"])


DIRECTION_DEPENDENT_FRICTION = Effect(
    key="direction-dependent-friction",
    name="Friction that depends on the direction",
    physics=(
        "Viscous friction is larger one way than the other, as where a nut or its wipers are loaded from one side. "
        "Unlike an offset of the recorded force it grows with the speed. The parameter is the friction towards higher "
        "positions less that towards lower ones."
    ),
    source="Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994)",
    parameters=(EffectParameter("viscous_difference_ns_per_m", "N·s/m", lower=-2000.0, upper=2000.0, scale=20.0),),
    add=_add,
    needs=frozenset({ConditionAxis.DIRECTION}),
)
