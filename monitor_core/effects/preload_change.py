"""A preload that is not the one that was stated."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, preload_change=axis.added.preload_change + values["preload_n"])


def _applies(axis: AxisPhysics) -> bool:
    return axis.joints.dynamic_load_rating is not None


PRELOAD_CHANGE = Effect(
    key="preload-change",
    name="Change of the nut's preload",
    physics=(
        "Balls and raceways wear, and the nut is pressed together by less than was set: its contacts soften with the "
        "cube root of the preload. Frequencies fall a little, more at the stiff end of the screw; the antiresonance of "
        "the nut, which masses and bracket make, stays."
    ),
    source="Nguyen et al. (2018), Eq. (1)",
    parameters=(EffectParameter("preload_n", "N", lower=-5000.0, upper=5000.0, scale=30.0),),
    add=_add,
    applies=_applies,
)
