"""A payload that weighs something else than was stated."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, payload_error=axis.added.payload_error + values["mass_kg"])


PAYLOAD_MASS = Effect(
    key="payload-mass",
    name="Wrong payload mass",
    physics=(
        "Wherever a payload is stated, the true one weighs more or less by one amount. Frequencies differ with "
        "the payload on the table and agree without it."
    ),
    source="no source: a rigid body in translation",
    parameters=(EffectParameter("mass_kg", "kg", lower=-5.0, upper=50.0, scale=0.5),),
    add=_add,
    needs=frozenset({ConditionAxis.PAYLOAD}),
)
