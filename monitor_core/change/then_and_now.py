"""Describe an axis at two times: when its reference was taken, and now."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


@dataclass(frozen=True, slots=True, kw_only=True)
class ThenAndNow:
    """An axis before and after a change; what is not known of the axis is the same in both."""

    then: AxisPhysics
    now: AxisPhysics
    log_gain: float = 0.0  # ln of the gain of the measuring chain now over then [-]


def since_then(effect: Effect[AxisPhysics], parameter: EffectParameter | None = None) -> Effect[ThenAndNow]:
    """Return an effect of one parameter as a change since the reference was taken.

    ``parameter`` is the range of the change where it differs from that of the effect: a mass may also have been taken
    off.
    """
    return Effect(
        key=effect.key,
        name=effect.name,
        physics=effect.physics,
        source=effect.source,
        parameters=effect.parameters if parameter is None else (parameter,),
        add=partial(_add, effect),
        applies=lambda axis: effect.applies(axis.now),
    )


def _add(effect: Effect[AxisPhysics], axis: ThenAndNow, values: Mapping[str, float]) -> ThenAndNow:
    return replace(axis, now=effect.added_to(axis.now, values))


def _add_gain(axis: ThenAndNow, values: Mapping[str, float]) -> ThenAndNow:
    return replace(axis, log_gain=axis.log_gain + values["ln_ratio"])


SENSOR_GAIN = Effect(
    key="sensor-gain",
    name="Gain of the sensors",
    physics=(
        "An accelerometer or a torque sensor was changed, or has lost sensitivity: the whole response is larger or "
        "smaller by one factor, and no frequency moves."
    ),
    source="no source: a factor",
    parameters=(EffectParameter("ln_ratio", "-", lower=-1.0, upper=1.0, scale=0.05),),
    add=_add_gain,
)
