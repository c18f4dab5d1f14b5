"""Mass of the screw that is spread along it."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_screw
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    share = axis.screw.axial_mass_share
    return changed_screw(axis, axial_mass_share=share + values["share"] * (1.0 - share))


def _applies(axis: AxisPhysics) -> bool:
    return axis.screw.axial_mass_share < 1.0


SCREW_DISTRIBUTED_MASS = Effect(
    key="screw-distributed-mass",
    name="Distributed mass of the screw",
    physics=(
        "A share of the screw's mass, which the model lets move with the table, is spread along the screw: the "
        "first mode rises and the screw has axial modes of its own."
    ),
    source="Tian et al., Eq. (1)",
    parameters=(EffectParameter("share", "-", lower=0.0, upper=1.0, scale=1.0, beyond=False),),
    add=_add,
    applies=_applies,
    textbook={"share": 1.0},
)
