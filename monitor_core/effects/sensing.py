"""What positions, torques and accelerations are recorded wrongly by."""

import math
from collections.abc import Mapping

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, changed, increasing, lacking
from monitor_core.effects.sizes import Reference
from monitor_core.models.extended import AxisPhysics

POSITION_OFFSET = Effect(
    key="position-offset",
    name="Offset of the position",
    physics=(
        "The table is further from the fixed bearing than is stated, by the same distance everywhere: the screw "
        "is longer, and so softer, on one side."
    ),
    source="no source: kinematics",
    parameters=(
        EffectParameter("offset_m", "m", lower=-0.0515, upper=0.0515, scale=0.00515, reference=Reference.LENGTH),
    ),
    add=increasing("added", position_offset="offset_m"),
    needs=frozenset({ConditionAxis.POSITION}),
)

TORQUE_DELAY = Effect(
    key="torque-delay",
    name="Delay between torque and motion",
    physics=(
        "Channels are sampled or filtered at different times, or the drive reports its torque early: the phase "
        "falls in proportion to the frequency, the magnitude stays."
    ),
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(EffectParameter("delay_s", "s", lower=-1.0, upper=1.0, scale=0.02, reference=Reference.PERIOD),),
    add=increasing("added", torque_delay="delay_s"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)

RESPONSE_DELAY = Effect(
    key="response-delay",
    name="Delay of the response at the table",
    physics=(
        "What is measured at table or nut is recorded late, by a filter or another clock, and the angle of the motor "
        "is not: the phase of the one falls in proportion to the frequency, against that of the other."
    ),
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(EffectParameter("delay_s", "s", lower=-1.0, upper=1.0, scale=0.02, reference=Reference.PERIOD),),
    add=increasing("added", response_delay="delay_s"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)

ANGLE_DELAY = Effect(
    key="angle-delay",
    name="Delay of the angle of the motor",
    physics=(
        "The angle of the motor comes late, as over a fieldbus, and what is measured at table or nut does not: the "
        "phase of the one falls in proportion to the frequency, against that of the other."
    ),
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(EffectParameter("delay_s", "s", lower=-1.0, upper=1.0, scale=0.02, reference=Reference.PERIOD),),
    add=increasing("added", angle_delay="delay_s"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)


def _add_sensor_mounting_resonance(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    r"""Multiply the acceleration by :math:`(1 + j \omega q b) / (1 - q (\omega^2 - j \omega b))`, b in rad/s.

    It is smooth in q, so that a search can start where the effect is absent: with a damping ratio, ζ = b√q/2, in place
    of the bandwidth b the slope there would be infinite.
    """
    inverse_square = values["inverse_square_s2"]
    ratio = math.pi * values["bandwidth_hz"] * math.sqrt(max(inverse_square, 0.0))  # a negative one is refused below
    return changed(axis, "added", mounting_inverse_square=inverse_square, mounting_damping_ratio=ratio)


SENSOR_MOUNTING_RESONANCE = Effect(
    key="sensor-mounting-resonance",
    name="Resonance of the accelerometer on its mounting",
    physics=(
        "The accelerometer is a mass on its magnet, wax or stud and reads too much towards its resonance f, by "
        "1/(1 − ω² q) with q = 1/(2πf)²; the bandwidth is 2ζf. The angle of the motor is read right."
    ),
    source="ISO 5348; transmissibility of a mass on a spring",
    parameters=(
        # a resonance at 1.5 times the first of the drive at least; where a search looks first, at 10 times
        EffectParameter(
            "inverse_square_s2", "s²", lower=0.0, upper=0.43, scale=0.01, reference=Reference.INVERSE_SQUARE
        ),
        EffectParameter("bandwidth_hz", "Hz", lower=0.0, upper=5.0, scale=0.5, null=1.0, reference=Reference.FREQUENCY),
    ),
    add=_add_sensor_mounting_resonance,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=lacking("added", "mounting_inverse_square"),
)
