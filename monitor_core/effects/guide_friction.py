"""Coulomb friction of the guides."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, guide_friction=axis.added.guide_friction + values["friction_n"])


GUIDE_FRICTION = Effect(
    key="guide-friction",
    name="Coulomb friction of the guides",
    physics=(
        "A force of constant size opposes the motion of the table. It damps weak excitation more than strong "
        "excitation; the response depends on the level."
    ),
    source="Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5",
    parameters=(EffectParameter("friction_n", "N", lower=0.0, upper=500.0, scale=5.0),),
    add=_add,
    form_share=0.03,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)
