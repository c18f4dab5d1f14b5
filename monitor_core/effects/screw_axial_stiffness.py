"""A screw that is stiffer or softer in tension than its data say."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_screw
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_screw(axis, axial_rigidity=axis.screw.axial_rigidity * (1.0 + values["relative_change"]))


SCREW_AXIAL_STIFFNESS = Effect(
    key="screw-axial-stiffness",
    name="Axial stiffness of the screw",
    physics=(
        "Thread, bore and true diameter make E S another one, by one ratio along the screw. The frequency "
        "changes the more, the further the table is from its bearings."
    ),
    source="Nguyen et al. (2018), Eq. (2)",
    parameters=(EffectParameter("relative_change", "-", lower=-0.5, upper=0.5, scale=0.05),),
    add=_add,
)
