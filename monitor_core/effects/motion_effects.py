"""Effects that a model of a rigid axis in motion may lack: friction, delays and scales.

An effect is written here and gets a line in :data:`MOTION_EFFECTS` at the end (CONTRIBUTING.md).
"""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter as P, increasing, lacking, setting
from monitor_core.effects.sizes import Reference
from monitor_core.effects.units import MOTION_UNIT
from monitor_core.models.motion import MotionPhysics

COULOMB_FRICTION = Effect(
    "coulomb-friction",
    "Coulomb friction",
    "A force of constant size opposes the motion, whatever its speed. It shows as a jump at every reversal; in one "
    "direction alone it looks like an offset of the recorded force.",
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(P("friction_n", "N", 0.0, 20.0, 0.1, reference=Reference.FORCE_CHANGE),),
    add=increasing("", coulomb_friction="friction_n"),
    needs=frozenset({ConditionAxis.DIRECTION}),
)

FORCE_OFFSET = Effect(
    "force-offset",
    "Offset of the recorded force",
    "The drive records a force where there is none, or a constant force acts, as a weight on an inclined axis. It is "
    "the same at every speed, and so is a difference of Coulomb friction between the directions.",
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(P("force_n", "N", -4.0, 4.0, 0.04, reference=Reference.MOTOR_FORCE),),
    add=increasing("", force_offset="force_n"),
    needs=frozenset({ConditionAxis.DIRECTION}),
)

DIRECTION_DEPENDENT_FRICTION = Effect(
    "direction-dependent-friction",
    "Friction that depends on the direction",
    "Viscous friction is larger one way than the other, as where a nut or its wipers are loaded from one side. Unlike "
    "an offset of the recorded force it grows with the speed. The parameter is the friction towards higher positions "
    "less that towards lower ones.",
    source="Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994)",
    parameters=(P("viscous_difference_ns_per_m", "N·s/m", -3.3, 3.3, 0.033, reference=Reference.VISCOUS_FRICTION),),
    add=increasing("", viscous_difference="viscous_difference_ns_per_m"),
    needs=frozenset({ConditionAxis.DIRECTION}),
)

STRIBECK_FRICTION = Effect(
    "stribeck-friction",
    "Stribeck friction: another friction at low speed",
    "Friction changes by an amount that dies away with the speed: it is more where slow motion squeezes the lubricant "
    "out, and less, a negative value, where rolling contacts have yet to build it up after a stop.",
    source="Tustin's form in Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30 (1994)",
    parameters=(
        P("friction_n", "N", -4.0, 10.0, 0.06, reference=Reference.FORCE_CHANGE),
        # a slower decay than that would be Coulomb and viscous friction by another name
        P("velocity_m_per_s", "m/s", 0.001, 0.35, 0.11, null=0.11, reference=Reference.VELOCITY),
    ),
    add=setting("", stribeck_friction="friction_n", stribeck_velocity="velocity_m_per_s"),
    applies=lacking("", "stribeck_friction"),
)

FORCE_DELAY = Effect(
    "force-delay",
    "Delay from the recorded force to the motion",
    "A commanded force is held for a sample, so that it acts half a sample late on average, and the current loop adds "
    "its own delay. Negative: the recorded force is filtered, or read after the position.",
    source="Åström & Wittenmark, Computer-Controlled Systems: the zero-order hold",
    parameters=(P("delay_s", "s", -1.0, 1.0, 0.02, reference=Reference.CUTOFF_PERIOD),),
    add=increasing("", force_delay="delay_s"),
)


def _add_force_scale(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    gain = (1.0 + axis.force_gain_error) * (1.0 + values["gain_error"])
    return replace(axis, force_gain_error=gain - 1.0)


FORCE_SCALE = Effect(
    "force-scale",
    "Wrong scale of the recorded force",
    "Recorded is the motor current times a force constant that is not that of the motor. All forces are wrong by one "
    "factor, which only a mass that is well known can tell from a heavier axis with more friction.",
    source="Janot, Gautier & Brunot (2019): the gain from voltage to force is a stated constant",
    parameters=(P("gain_error", "-", -0.5, 1.0, 0.02, beyond=False),),
    add=_add_force_scale,
)

VISCOUS_FRICTION = Effect(
    "viscous-friction",
    "Viscous friction",
    "A force in proportion to the speed opposes the motion: the drag of grease in guides, nut and bearings.",
    source="Janot, Gautier & Brunot (2019), the reference model of the EMPS",
    parameters=(P("friction_ns_per_m", "N·s/m", 0.0, 33.0, 0.08, reference=Reference.VISCOUS_FRICTION),),
    add=setting("", viscous_friction="friction_ns_per_m"),
    applies=lacking("", "viscous_friction"),  # one that is stated can only be wrong
)

#: Keys are those of files, and viscous friction for models that state none.
MOTION_EFFECTS: tuple[Effect[MotionPhysics], ...] = (
    COULOMB_FRICTION,
    FORCE_OFFSET,
    DIRECTION_DEPENDENT_FRICTION,
    STRIBECK_FRICTION,
    FORCE_DELAY,
    FORCE_SCALE,
    VISCOUS_FRICTION,
    MOTION_UNIT,
)
