"""An accelerometer that resonates on its mounting."""

import math
from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    r"""Multiply the acceleration by :math:`(1 + j \omega q b) / (1 - q (\omega^2 - j \omega b))`, b in rad/s.

    It is smooth in q, so that a search can start where the effect is absent: with a damping ratio, ζ = b√q/2, in place
    of the bandwidth b the slope there would be infinite.
    """
    inverse_square = values["inverse_square_s2"]
    ratio = math.pi * values["bandwidth_hz"] * math.sqrt(max(inverse_square, 0.0))  # a negative one is refused below
    return changed_added(axis, mounting_inverse_square=inverse_square, mounting_damping_ratio=ratio)


def _applies(axis: AxisPhysics) -> bool:
    return not axis.added.mounting_inverse_square


SENSOR_MOUNTING_RESONANCE = Effect(
    key="sensor-mounting-resonance",
    name="Resonance of the accelerometer on its mounting",
    physics=(
        "The accelerometer is a mass on its magnet, wax or stud and reads too much towards its resonance f, by "
        "1/(1 − ω² q) with q = 1/(2πf)²; the bandwidth is 2ζf. The angle of the motor is read right."
    ),
    source="ISO 5348; transmissibility of a mass on a spring",
    parameters=(
        EffectParameter("inverse_square_s2", "s²", lower=0.0, upper=2.5e-7, scale=6e-9),  # 318 Hz at most, 2055 Hz
        EffectParameter("bandwidth_hz", "Hz", lower=0.0, upper=1000.0, scale=100.0, null=200.0),
    ),
    add=_add,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=_applies,
)
