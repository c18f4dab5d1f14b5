"""A nut whose rigidity follows the preload with another power."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, preload_exponent_change=axis.added.preload_exponent_change + values["exponent_change"])


def _applies(axis: AxisPhysics) -> bool:
    return axis.joints.dynamic_load_rating is not None


PRELOAD_EXPONENT = Effect(
    key="preload-exponent",
    name="Exponent of the preload",
    physics=(
        "The rigidity of the nut grows as preload^(1/3 + change), which Hertz's contact alone would make the "
        "cube root; at 10 % of the dynamic load rating it is unchanged."
    ),
    source="Nguyen et al. (2018), Eq. (1)",
    parameters=(EffectParameter("exponent_change", "-", lower=-1.0 / 3.0, upper=2.0 / 3.0, scale=0.1),),
    add=_add,
    needs=frozenset({ConditionAxis.PRELOAD}),
    applies=_applies,
)
