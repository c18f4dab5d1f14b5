"""List what may have changed in an axis since its reference was taken: the causes, and what each does."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

from monitor_core.change.reference_axis import ReferenceAxis
from monitor_core.change.reference_ratio import ThenAndNow
from monitor_core.effects.drive_effects import (
    ADDED_MASS,
    BEARING_CHANGE,
    FAR_BEARING_CHANGE,
    POSITION_OFFSET,
    PRELOAD_CHANGE,
    TORQUE_DELAY,
    WARMING,
)
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.models.extended import AxisPhysics, moving_mass


class Cause(StrEnum):
    """What an alarm names."""

    PRELOAD = "preload"
    PAYLOAD = "payload"
    BEARING = "bearing"
    POSITION = "position"
    SENSOR = "sensor"
    TEMPERATURE = "temperature"
    NONE = "none"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Change:
    """One change under trial, with the sizes that such changes have: normal about ``usual`` with ``spread``."""

    cause: Cause
    effect: Effect[ThenAndNow]
    spread: float  # in the unit of the parameter
    usual: float = 0.0
    known_to: float = 0.0  # relative standard deviation of the coefficient that its size rests on [-]


#: A payload may be taken off as well as put on.
_MASS = EffectParameter("mass_kg", "kg", lower=-9.0, upper=23.0, scale=0.023, reference=Reference.MOVING_MASS)
_SPREAD_OF_MASS = 0.2  # of the moving mass
_SPREAD_OF_PRELOAD = 0.25  # of the preload
_SPREAD_OF_STIFFNESS = 0.4  # of ln(stiffness)
_SPREAD_OF_POSITION = 5e-3  # [m]
_SPREAD_OF_DELAY = 2e-4  # [s]
_SPREAD_OF_GAIN = 0.05
_SPREAD_OF_WARMING = 10.0  # [K]
#: Joints soften with temperature as steel does, more or less.
_WARMING_KNOWN_TO = 0.15
#: A change of the temperature that windows report is one beyond this. [K]
_REPORTED = 1.0


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


def possible_changes(axis: ReferenceAxis, preload: float | None) -> tuple[Change, ...]:
    """Return the changes that an axis can have; no preload [N] of the reference where the nut does not follow it."""
    at_reference = axis.physics({})
    sizes, moving = sizes_of_drive(at_reference.then, ()), moving_mass(at_reference.then)
    changes = [
        Change(Cause.PAYLOAD, since_then(ADDED_MASS, _MASS.sized(sizes)), _SPREAD_OF_MASS * moving),
        Change(Cause.POSITION, since_then(POSITION_OFFSET.sized(sizes)), _SPREAD_OF_POSITION),
        Change(Cause.SENSOR, since_then(TORQUE_DELAY.sized(sizes)), _SPREAD_OF_DELAY),
        Change(Cause.SENSOR, SENSOR_GAIN, _SPREAD_OF_GAIN),
        Change(Cause.BEARING, since_then(BEARING_CHANGE), _SPREAD_OF_STIFFNESS),
        Change(Cause.BEARING, since_then(FAR_BEARING_CHANGE), _SPREAD_OF_STIFFNESS),
        _temperature_change(axis.reported_warming),
    ]
    if preload is not None:
        effect = since_then(PRELOAD_CHANGE.sized(MachineSizes({Reference.PRELOAD: preload})))
        changes.insert(0, Change(Cause.PRELOAD, effect, _SPREAD_OF_PRELOAD * preload))
    return tuple(change for change in changes if change.effect.applies(at_reference))


def is_reported(warming: float) -> bool:
    """Return whether windows report a change of the temperature, in kelvins."""
    return abs(warming) > _REPORTED


def _temperature_change(reported: float) -> Change:
    """Return the change of temperature: as the windows report it, as well as coefficients are known, or any."""
    spread = _SPREAD_OF_WARMING
    if is_reported(reported):
        spread = math.hypot(_REPORTED, _WARMING_KNOWN_TO * reported)
    return Change(Cause.TEMPERATURE, since_then(WARMING), spread, usual=reported, known_to=_WARMING_KNOWN_TO)


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
