"""A spring between table and ground."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, guide_stiffness=axis.added.guide_stiffness + values["stiffness_n_per_m"])


GUIDE_STIFFNESS = Effect(
    key="guide-stiffness",
    name="Stiffness of the guides",
    physics=(
        "Guides in presliding, bellows or cables hold the table to ground, beside the drive: frequencies rise, "
        "and the drive no longer moves freely as a whole."
    ),
    source="no source: a spring in parallel with the path of the force",
    parameters=(EffectParameter("stiffness_n_per_m", "N/m", lower=0.0, upper=1e9, scale=1e6),),
    add=_add,
)
