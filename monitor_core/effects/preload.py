"""How the rigidity of the nut follows its preload, and what the preload really is."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added, increasing
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _may_have_preload_exponent(axis: AxisPhysics) -> bool:
    return axis.joints.dynamic_load_rating is not None


PRELOAD_EXPONENT = Effect(
    key="preload-exponent",
    name="Exponent of the preload",
    physics=(
        "The rigidity of the nut grows as preload^(1/3 + change), which Hertz's contact alone would make the "
        "cube root; at 10 % of the dynamic load rating it is unchanged."
    ),
    source="Nguyen et al. (2018), Eq. (1)",
    parameters=(EffectParameter("exponent_change", "-", lower=-1.0 / 3.0, upper=2.0 / 3.0, scale=0.1),),
    add=increasing("added", "preload_exponent_change", by="exponent_change"),
    needs=frozenset({ConditionAxis.PRELOAD}),
    applies=_may_have_preload_exponent,
)


def _add_periodic_preload(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(
        axis,
        periodic_preload_cosine=axis.added.periodic_preload_cosine + values["cosine_amplitude"],
        periodic_preload_sine=axis.added.periodic_preload_sine + values["sine_amplitude"],
    )


PERIODIC_PRELOAD = Effect(
    key="periodic-preload",
    name="Preload that varies over the lead",
    physics=(
        "Errors of the thread that repeat each turn make preload and nut rigidity vary with the position over "
        "one lead: preload (1 + a cos 2πx/lead + b sin 2πx/lead)."
    ),
    source="no source: first harmonic of an error that repeats each turn",
    parameters=(
        EffectParameter("cosine_amplitude", "-", lower=-0.5, upper=0.5, scale=0.1, beyond=False),
        EffectParameter("sine_amplitude", "-", lower=-0.5, upper=0.5, scale=0.1, beyond=False),
    ),
    add=_add_periodic_preload,
    needs=frozenset({ConditionAxis.POSITION}),
)


def _may_have_preload_change(axis: AxisPhysics) -> bool:
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
    add=increasing("added", "preload_change", by="preload_n"),
    applies=_may_have_preload_change,
)
