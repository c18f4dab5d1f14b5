"""A zero of the position that is not where the model has it."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, position_offset=axis.added.position_offset + values["offset_m"])


POSITION_OFFSET = Effect(
    key="position-offset",
    name="Offset of the position",
    physics=(
        "The table is further from the fixed bearing than is stated, by the same distance everywhere: the screw "
        "is longer, and so softer, on one side."
    ),
    source="no source: kinematics",
    parameters=(EffectParameter("offset_m", "m", lower=-0.05, upper=0.05, scale=0.005),),
    add=_add,
    needs=frozenset({ConditionAxis.POSITION}),
)
