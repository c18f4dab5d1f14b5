"""Viscous friction of a rigid axis in motion, where its model has none."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, viscous_friction=values["friction_ns_per_m"])


def _applies(axis: MotionPhysics) -> bool:
    return not axis.viscous_friction


VISCOUS_FRICTION = Effect(
    key="viscous-friction",
    name="Viscous friction",
    physics="A force in proportion to the speed opposes the motion: the drag of grease in guides, nut and bearings.",
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(EffectParameter("friction_ns_per_m", "N·s/m", lower=0.0, upper=20000.0, scale=50.0),),
    add=_add,
    applies=_applies,  # one that is stated can only be wrong
)
