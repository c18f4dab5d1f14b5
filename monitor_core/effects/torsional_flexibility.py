"""A screw that twists more than the model lets it."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_screw
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics

_KEY = "torsional-flexibility"
_NAME = "Torsional flexibility of the screw"
_SOURCE = "Tian et al., Eq. (12); Nguyen et al. (2018), Eq. (3)"
#: In units of what the screw's own G J gives, so that one number serves a model that is rigid in torsion (1: as
#: flexible as the screw is) and one that twists already (0.1: a tenth more).
_COMPLIANCE = EffectParameter("compliance_share", "-", lower=-0.5, upper=10.0, scale=0.5)


def _add_compliance(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_screw(axis, torsion_share=axis.screw.torsion_share + values["compliance_share"])


def _add_both(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    share = axis.screw.torsional_inertia_share
    spread = share + values["inertia_share"] * (1.0 - share)
    held = axis.screw.far_end_held_share * (1.0 - values["inertia_share"])
    return changed_screw(_add_compliance(axis, values), torsional_inertia_share=spread, far_end_held_share=held)


def _has_spread_inertia(axis: AxisPhysics) -> bool:
    return axis.screw.torsional_inertia_share == 1.0


def _has_lumped_inertia(axis: AxisPhysics) -> bool:
    return axis.screw.torsional_inertia_share < 1.0


TORSIONAL_FLEXIBILITY = Effect(
    key=_KEY,
    name=_NAME,
    physics=(
        "The screw twists under the torque by more than the model's G J gives, by one ratio along it. Torsional modes "
        "move; axial ones where the table is far from the motor."
    ),
    source=_SOURCE,
    parameters=(_COMPLIANCE,),
    add=_add_compliance,
    applies=_has_spread_inertia,
)
TORSIONAL_FLEXIBILITY_OF_LUMPED_INERTIA = Effect(
    key=_KEY,
    name=_NAME,
    physics=(
        "The screw twists more than the model lets it, and a share of its inertia, which the model turns with the "
        "motor, twists with it: the drive has torsional modes. Its far end then turns freely, which some models hold."
    ),
    source=_SOURCE,
    parameters=(_COMPLIANCE, EffectParameter("inertia_share", "-", lower=0.0, upper=1.0, scale=1.0)),
    add=_add_both,
    applies=_has_lumped_inertia,
    textbook={"compliance_share": 0.0, "inertia_share": 1.0},
)
