"""Loss factor of the joints."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_joints
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_joints(axis, causal_loss_factor=axis.joints.causal_loss_factor + values["loss_factor"])


LOSS_FACTOR = Effect(
    key="loss-factor",
    name="Loss factor of the joints",
    physics=(
        "Every spring of a joint loses a share of its energy in each cycle, at any frequency. Peaks become lower "
        "and wider; natural frequencies hardly move. Springs stiffen a little with frequency."
    ),
    source="Sun et al. (2022), section 3: k (1 + jη); Kjartansson (1979) for what causality adds",
    parameters=(EffectParameter("loss_factor", "-", lower=0.0, upper=0.5, scale=0.02),),
    add=_add,
    form_share=0.05,
)
