"""A mode of the structure that is no part of the drive."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(
        axis,
        second_mode_residue=values["residue_per_kg"],
        second_mode_frequency=values["frequency_hz"],
        second_mode_damping_ratio=values["damping_ratio"],
    )


def _applies(axis: AxisPhysics) -> bool:
    return not axis.added.second_mode_residue


SECOND_MODE = Effect(
    key="second-mode",
    name="One more mode at the table",
    physics=(
        "Something on the table or in its structure resonates by itself and adds one modal term, driven and seen "
        "at the table, at a frequency that nothing of the drive moves."
    ),
    source="Ewins, Modal Testing, chapter 2: one term of the modal sum",
    parameters=(
        EffectParameter("residue_per_kg", "1/kg", lower=0.0, upper=1.0, scale=1e-3),
        EffectParameter("frequency_hz", "Hz", lower=5.0, upper=5000.0, scale=50.0, null=300.0),
        EffectParameter("damping_ratio", "-", lower=0.0, upper=0.3, scale=0.02, null=0.02),
    ),
    add=_add,
    form_share=0.08,
    needs=frozenset({ConditionAxis.FREQUENCY}),
    applies=_applies,
)
