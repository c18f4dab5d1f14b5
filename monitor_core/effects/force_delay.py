"""A recorded force that acts later."""

from collections.abc import Mapping
from dataclasses import replace

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.motion import MotionPhysics


def _add(axis: MotionPhysics, values: Mapping[str, float]) -> MotionPhysics:
    return replace(axis, force_delay=axis.force_delay + values["delay_s"])


FORCE_DELAY = Effect(
    key="force-delay",
    name="Delay from the recorded force to the motion",
    physics=(
        "A commanded force is held for a sample, so that it acts half a sample late on average, and the current loop "
        "adds its own delay. Negative: the recorded force is filtered, or read after the position."
    ),
    source="Åström & Wittenmark, Computer-Controlled Systems: the zero-order hold",
    parameters=(EffectParameter("delay_s", "s", lower=-0.01, upper=0.01, scale=2e-4),),
    add=_add,
)
