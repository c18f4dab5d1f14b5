"""A mass on the table that the model does not count."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, table_mass=axis.added.table_mass + values["mass_kg"])


ADDED_MASS = Effect(
    key="added-mass",
    name="Added mass on the table",
    physics=(
        "A fixture, cover or cable carrier moves with the table. All frequencies fall, most where the table "
        "carries the mode; a known payload tells it from a softer path."
    ),
    source="no source: a rigid body in translation",
    parameters=(EffectParameter("mass_kg", "kg", lower=0.0, upper=200.0, scale=0.5),),
    add=_add,
)
