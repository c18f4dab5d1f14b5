"""A preload that varies over each turn of the screw."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
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
    add=_add,
    needs=frozenset({ConditionAxis.POSITION}),
)
