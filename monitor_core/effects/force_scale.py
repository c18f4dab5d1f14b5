"""A recorded force with a wrong scale."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
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
    parameters=(EffectParameter("gain_error", "-", lower=-0.5, upper=1.0, scale=0.02),),
    add=_add,
)
