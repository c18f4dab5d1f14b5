"""A base that yields to the reaction of the force path."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(
        axis,
        base_compliance=values["compliance_m_per_n"],
        base_frequency=values["frequency_hz"],
        base_damping_ratio=values["damping_ratio"],
    )


def _applies(axis: AxisPhysics) -> bool:
    return not axis.added.base_compliance


BASE_COMPLIANCE = Effect(
    key="base-compliance",
    name="Compliance of the base",
    physics=(
        "Bed or foundation is a mass on a spring, which the reaction of the bearings pushes: one more resonance, "
        "whose frequency does not depend on the position of the table."
    ),
    source="no source: a mass on a spring",
    parameters=(
        EffectParameter("compliance_m_per_n", "m/N", lower=0.0, upper=1e-7, scale=1e-9),
        # beds rock on their mounts and bend as a whole below it; what resonates above is a part, and moves with one
        EffectParameter("frequency_hz", "Hz", lower=5.0, upper=200.0, scale=20.0, null=60.0),
        EffectParameter("damping_ratio", "-", lower=0.0, upper=0.3, scale=0.02, null=0.02),
    ),
    add=_add,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=_applies,
)
