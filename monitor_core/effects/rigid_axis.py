"""Friction, delays and scales of a rigid axis in motion."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, increasing_force
from monitor_core.effects.sizes import Reference
from monitor_core.models.motion import MotionPhysics

COULOMB_FRICTION = Effect(
    key="coulomb-friction",
    name="Coulomb friction",
    physics=(
        "A force of constant size opposes the motion, whatever its speed. It shows as a jump at every reversal; in one "
        "direction alone it looks like an offset of the recorded force."
    ),
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(
        EffectParameter("friction_n", "N", lower=0.0, upper=20.0, scale=0.1, reference=Reference.FORCE_CHANGE),
    ),
    add=increasing_force("coulomb_friction", by="friction_n"),
    needs=frozenset({ConditionAxis.DIRECTION}),
)

FORCE_OFFSET = Effect(
    key="force-offset",
    name="Offset of the recorded force",
    physics=(
        "The drive records a force where there is none, or a constant force acts, as a weight on an inclined axis. "
        "It is the same at every speed, and so is a difference of Coulomb friction between the directions."
    ),
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(EffectParameter("force_n", "N", lower=-4.0, upper=4.0, scale=0.04, reference=Reference.MOTOR_FORCE),),
    add=increasing_force("force_offset", by="force_n"),
    needs=frozenset({ConditionAxis.DIRECTION}),
)

DIRECTION_DEPENDENT_FRICTION = Effect(
    key="direction-dependent-friction",
    name="Friction that depends on the direction",
    physics=(
        "Viscous friction is larger one way than the other, as where a nut or its wipers are loaded from one side. "
        "Unlike an offset of the recorded force it grows with the speed. The parameter is the friction towards higher "
        "positions less that towards lower ones."
    ),
    source="Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994)",
    parameters=(
        EffectParameter(
            "viscous_difference_ns_per_m",
            "N·s/m",
            lower=-3.3,
            upper=3.3,
            scale=0.033,
            reference=Reference.VISCOUS_FRICTION,
        ),
    ),
    add=increasing_force("viscous_difference", by="viscous_difference_ns_per_m"),
    needs=frozenset({ConditionAxis.DIRECTION}),
)


def _add_stribeck_friction(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, stribeck_friction=values["friction_n"], stribeck_velocity=values["velocity_m_per_s"])


def _may_have_stribeck_friction(axis: MotionPhysics) -> bool:
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
        EffectParameter("friction_n", "N", lower=-4.0, upper=10.0, scale=0.06, reference=Reference.FORCE_CHANGE),
        # a slower decay than that would be Coulomb and viscous friction by another name
        EffectParameter(
            "velocity_m_per_s",
            "m/s",
            lower=0.001,
            upper=0.35,
            scale=0.11,
            null=0.11,
            reference=Reference.VELOCITY,
        ),
    ),
    add=_add_stribeck_friction,
    applies=_may_have_stribeck_friction,
)

FORCE_DELAY = Effect(
    key="force-delay",
    name="Delay from the recorded force to the motion",
    physics=(
        "A commanded force is held for a sample, so that it acts half a sample late on average, and the current loop "
        "adds its own delay. Negative: the recorded force is filtered, or read after the position."
    ),
    source="Åström & Wittenmark, Computer-Controlled Systems: the zero-order hold",
    parameters=(EffectParameter("delay_s", "s", lower=-1.0, upper=1.0, scale=0.02, reference=Reference.CUTOFF_PERIOD),),
    add=increasing_force("force_delay", by="delay_s"),
)


def _add_force_scale(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    gain = (1.0 + axis.force_gain_error) * (1.0 + values["gain_error"])
    return replace(axis, force_gain_error=gain - 1.0)


FORCE_SCALE = Effect(
    key="force-scale",
    name="Wrong scale of the recorded force",
    physics=(
        "Recorded is the motor current times a force constant that is not that of the motor. All forces are wrong by "
        "one factor, which only a mass that is well known can tell from a heavier axis with more friction."
    ),
    source="Janot, Gautier & Brunot (2019): the gain from voltage to force is a stated constant",
    parameters=(EffectParameter("gain_error", "-", lower=-0.5, upper=1.0, scale=0.02, beyond=False),),
    add=_add_force_scale,
)


def _add_viscous_friction(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, viscous_friction=values["friction_ns_per_m"])


def _may_have_viscous_friction(axis: MotionPhysics) -> bool:
    return not axis.viscous_friction


VISCOUS_FRICTION = Effect(
    key="viscous-friction",
    name="Viscous friction",
    physics="A force in proportion to the speed opposes the motion: the drag of grease in guides, nut and bearings.",
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(
        EffectParameter(
            "friction_ns_per_m", "N·s/m", lower=0.0, upper=33.0, scale=0.08, reference=Reference.VISCOUS_FRICTION
        ),
    ),
    add=_add_viscous_friction,
    applies=_may_have_viscous_friction,  # one that is stated can only be wrong
)
