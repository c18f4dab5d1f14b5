"""A far bearing that carries axial load."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_joints
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_joints(axis, far_bearing_stiffness=axis.joints.far_bearing_stiffness + values["stiffness_n_per_m"])


FAR_BEARING_STIFFNESS = Effect(
    key="far-bearing-stiffness",
    name="Axial stiffness of the far bearing",
    physics=(
        "The far end of the screw is held as well, more stiffly than the model has it: frequencies rise, most "
        "where the table is far from the fixed bearing."
    ),
    source="Tian et al., Eq. (8)",
    parameters=(EffectParameter("stiffness_n_per_m", "N/m", lower=0.0, upper=2e9, scale=3e7),),
    add=_add,
)
