"""A preload that temperature changes."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, thermal_preload=axis.added.thermal_preload + values["preload_n_per_k"])


def _applies(axis: AxisPhysics) -> bool:
    return axis.joints.dynamic_load_rating is not None


THERMAL_PRELOAD = Effect(
    key="thermal-preload",
    name="Preload that follows temperature",
    physics=(
        "Nut and screw expand differently, and the preload rises or falls in proportion to the deviation from "
        "the reference temperature."
    ),
    source="no source: linear thermal expansion",
    parameters=(EffectParameter("preload_n_per_k", "N/K", lower=-10.0, upper=10.0, scale=1.0),),
    add=_add,
    needs=frozenset({ConditionAxis.TEMPERATURE}),
    applies=_applies,
)
