"""Springs that soften as they warm."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, thermal_stiffness=axis.added.thermal_stiffness + values["relative_change_per_k"])


THERMAL_STIFFNESS = Effect(
    key="thermal-stiffness",
    name="Springs that soften as they warm",
    physics=(
        "Steel loses stiffness as it warms, some 0.3 ‰ a kelvin, and with it the screw and every joint by the same "
        "share of the deviation from the reference temperature: all frequencies fall alike, at every position."
    ),
    source="Young's modulus of steels against temperature, ASME B31.3, Table C-6",
    parameters=(EffectParameter("relative_change_per_k", "1/K", lower=-1e-3, upper=1e-3, scale=-3e-4),),
    add=_add,
    needs=frozenset({ConditionAxis.TEMPERATURE}),
)
