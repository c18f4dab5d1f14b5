"""Losses of the drive: damping of the joints, friction of the guides."""

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, increasing
from monitor_core.effects.sizes import Reference

LOSS_FACTOR = Effect(
    key="loss-factor",
    name="Loss factor of the joints",
    physics=(
        "Every spring of a joint loses a share of its energy in each cycle, at any frequency. Peaks become lower "
        "and wider; natural frequencies hardly move. Springs stiffen a little with frequency."
    ),
    source="Sun et al. (2022), section 3: k (1 + jη); Kjartansson (1979) for what causality adds",
    parameters=(EffectParameter("loss_factor", "-", lower=0.0, upper=0.5, scale=0.02),),
    add=increasing("joints", causal_loss_factor="loss_factor"),
    form_share=0.05,
)

CONSTANT_LOSS_FACTOR = Effect(
    key="constant-loss-factor",
    name="Loss factor of the joints, stiffness the same at all frequencies",
    physics=(
        "Every spring of a joint loses a share of its energy in each cycle, at any frequency, and is as stiff at all: "
        "the law of the papers and of most programs. What loses so in the world stiffens with frequency: loss-factor."
    ),
    source="Sun et al. (2022), section 3: k (1 + jη)",
    parameters=(EffectParameter("loss_factor", "-", lower=0.0, upper=0.5, scale=0.02),),
    add=increasing("joints", loss_factor="loss_factor"),
    form_share=0.05,
)

SCREW_LOSS = Effect(
    key="screw-loss",
    name="Loss factor of the screw",
    physics=(
        "The steel of the screw, or what fills or lines it, loses a share of its energy in each cycle, in tension and "
        "in torsion. Modes that strain the screw are damped the more, the further the table is from the bearing."
    ),
    source="Kjartansson (1979); Cremer, Heckl & Petersson, Structure-Borne Sound, section 3.3, for the size in steel",
    parameters=(EffectParameter("loss_factor", "-", lower=0.0, upper=0.2, scale=0.01),),
    add=increasing("screw", causal_loss_factor="loss_factor"),
    ordinary=0.005,  # steel has 0.0002 to 0.002, and a thread with its grease a little more
    form_share=0.05,
)

MOTOR_DAMPING = Effect(
    key="motor-damping",
    name="Damping of the motor",
    physics=(
        "Bearings and seals of the motor, eddy currents or the velocity loop of its drive hold the rotor back in "
        "proportion to its speed. Modes in which the rotor turns against the table are damped."
    ),
    source="no source: a damper to ground",
    # with one of the reference what turns would swing no more
    parameters=(
        EffectParameter(
            "damping_nms_per_rad", "N·m·s/rad", lower=0.0, upper=1.0, scale=0.01, reference=Reference.ROTOR_DAMPING
        ),
    ),
    add=increasing("bodies", motor_damping="damping_nms_per_rad"),
)

GUIDE_FRICTION = Effect(
    key="guide-friction",
    name="Coulomb friction of the guides",
    physics=(
        "A force of constant size opposes the motion of the table. It damps weak excitation more than strong "
        "excitation; the response depends on the level."
    ),
    source="Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5",
    parameters=(
        EffectParameter("friction_n", "N", lower=0.0, upper=3.2, scale=0.032, reference=Reference.EXCITATION_FORCE),
    ),
    add=increasing("added", guide_friction="friction_n"),
    form_share=0.03,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)
