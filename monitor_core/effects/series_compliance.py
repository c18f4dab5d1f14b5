"""One more spring in the path of the force."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, series_compliance=axis.added.series_compliance + values["compliance_m_per_n"])


SERIES_COMPLIANCE = Effect(
    key="series-compliance",
    name="Compliance in series",
    physics=(
        "Pedestal, bolted joints and table yield in series with nut and bracket, the same at every position and "
        "preload, and with the loss factor of the joints."
    ),
    source="Nguyen et al. (2018), Eq. (4): one more term of the sum",
    parameters=(EffectParameter("compliance_m_per_n", "m/N", lower=0.0, upper=1e-7, scale=2e-9),),
    add=_add,
)
