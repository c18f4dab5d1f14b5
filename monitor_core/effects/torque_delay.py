"""A torque that acts later than it is recorded."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, torque_delay=axis.added.torque_delay + values["delay_s"])


TORQUE_DELAY = Effect(
    key="torque-delay",
    name="Delay between torque and motion",
    physics=(
        "Channels are sampled or filtered at different times, or the drive reports its torque early: the phase "
        "falls in proportion to the frequency, the magnitude stays."
    ),
    source="no source: a shift in time, exp(−jωτ)",
    parameters=(EffectParameter("delay_s", "s", lower=-5e-3, upper=5e-3, scale=1e-4),),
    add=_add,
    needs=frozenset({ConditionAxis.FREQUENCY}),
)
