"""Masses that a model counts wrongly, or puts where they are not."""

import math
from collections.abc import Mapping

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, changed, increasing
from monitor_core.effects.sizes import Reference
from monitor_core.models.extended import AxisPhysics

ADDED_MASS = Effect(
    key="added-mass",
    name="Added mass on the table",
    physics=(
        "A fixture, cover or cable carrier moves with the table. All frequencies fall, most where the table "
        "carries the mode; a known payload tells it from a softer path."
    ),
    source="no source: a rigid body in translation",
    parameters=(EffectParameter("mass_kg", "kg", lower=0.0, upper=9.0, scale=0.023, reference=Reference.MOVING_MASS),),
    add=increasing("added", table_mass="mass_kg"),
)

PAYLOAD_MASS = Effect(
    key="payload-mass",
    name="Wrong payload mass",
    physics=(
        "Wherever a payload is stated, the true one weighs more or less by one amount. Frequencies differ with "
        "the payload on the table and agree without it."
    ),
    source="no source: a rigid body in translation",
    parameters=(
        # what is stated cannot weigh less than nothing
        EffectParameter("mass_kg", "kg", lower=-0.83, upper=8.3, scale=0.083, reference=Reference.PAYLOAD),
    ),
    add=increasing("added", payload_error="mass_kg"),
    needs=frozenset({ConditionAxis.PAYLOAD}),
)


def _add_screw_distributed_mass(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    share = axis.screw.axial_mass_share
    return changed(axis, "screw", axial_mass_share=share + values["share"] * (1.0 - share))


def _may_have_screw_distributed_mass(axis: AxisPhysics) -> bool:
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
    add=_add_screw_distributed_mass,
    applies=_may_have_screw_distributed_mass,
    textbook={"share": 1.0},
)


def _has_a_bracket_that_yields(axis: AxisPhysics) -> bool:
    return math.isfinite(axis.joints.bracket_stiffness) or axis.added.series_compliance > 0.0


NUT_MASS = Effect(
    key="nut-mass",
    name="Mass of the nut before its bracket",
    physics=(
        "Of the mass that the model lets move with the table a part, the nut with its housing, sits between the "
        "contacts and the bracket: it swings on the bracket by itself, and the modes of table and screw rise a little."
    ),
    source="no source: two bodies on two springs; Tian et al. put the nut on the table",
    parameters=(
        EffectParameter(
            "mass_kg", "kg", lower=0.0, upper=0.5, scale=0.025, beyond=False, reference=Reference.MOVING_MASS
        ),
    ),
    add=increasing("added", nut_mass="mass_kg"),
    applies=_has_a_bracket_that_yields,
)
