"""Friction that is another at low speed."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, stribeck_friction=values["friction_n"], stribeck_velocity=values["velocity_m_per_s"])


def _applies(axis: MotionPhysics) -> bool:
    return not axis.stribeck_friction


STRIBECK_FRICTION = Effect(
    key="stribeck-friction",
    name="Stribeck friction: another friction at low speed",
    physics=(
        "Friction changes by an amount that dies away with the speed: it is more where slow motion squeezes the "
        "lubricant out, and less, a negative value, where rolling contacts have yet to build it up after a stop."
    ),
    source="Tustin's form in Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994)",
    parameters=(
        EffectParameter("friction_n", "N", lower=-200.0, upper=500.0, scale=3.0),
        # a slower decay than that would be Coulomb and viscous friction by another name
        EffectParameter("velocity_m_per_s", "m/s", lower=1e-4, upper=0.03, scale=0.01, null=0.01),
    ),
    add=_add,
    applies=_applies,
)
