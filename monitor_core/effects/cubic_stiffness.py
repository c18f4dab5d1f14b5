"""A nut that stiffens or softens with its deflection."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, cubic_nut_stiffness=axis.added.cubic_nut_stiffness + values["relative_stiffness_per_m2"])


CUBIC_STIFFNESS = Effect(
    key="cubic-stiffness",
    name="Cubic stiffness of the nut",
    physics=(
        "The force in the nut is k (1 + β δ²) δ: strong excitation finds another stiffness than weak excitation. "
        "A nut that loses contact softens, β < 0."
    ),
    source=(
        "Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5; "
        "Dykman & Krivoglaz, Phys. Status Solidi B 48 (1971) 497"
    ),
    parameters=(EffectParameter("relative_stiffness_per_m2", "1/m²", lower=-1e12, upper=1e13, scale=1e9),),
    add=_add,
    # rms error of eleven simulated machines; docs/hidden-effects.md says what is known of it
    form_share=0.22,
    needs=frozenset({ConditionAxis.FREQUENCY, ConditionAxis.LEVEL}),
)
