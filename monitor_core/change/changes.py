"""List what may have changed in an axis since its reference was taken: the causes, and what each does."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from monitor_core.change.cells import SENSOR_GAIN, ThenAndNow, since_then
from monitor_core.change.reference_axis import ReferenceAxis
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
from monitor_core.models.extended import moving_mass


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
    in_words: Callable[[float, float], str]  # of the size and half the width of its 95 % interval
    usual: float = 0.0
    known_to: float = 0.0  # relative standard deviation of the coefficient that its size rests on [-]


@dataclass(frozen=True, slots=True)
class _Words:
    """How a size and half the width of its 95 % interval are put into words."""

    template: str
    less: str  # where the size is negative
    more: str
    per_unit: float = 1.0  # of the unit of the template in the unit of the size

    def __call__(self, size: float, half_width: float) -> str:
        change = self.less if size < 0.0 else self.more
        return self.template.format(change=change, size=_rounded(self.per_unit * abs(size), self.per_unit * half_width))


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
_PAYLOAD_WORDS = _Words("the table carries {size} kg {change}", "less", "more")
_POSITION_WORDS = _Words(
    "the table stands {size} mm {change} the fixed bearing than is stated", "nearer to", "further from", 1e3
)
_DELAY_WORDS = _Words("the response is recorded {size} ms {change} late against the torque", "less", "more", 1e3)
_GAIN_WORDS = _Words("the gain of the sensors {change} by {size} %", "fell", "rose", 100.0)
_TEMPERATURE_WORDS = _Words("the axis is {size} K {change}", "colder", "warmer")
_PRELOAD_WORDS = _Words("the preload {change} by {size} N", "fell", "rose")


def possible_changes(axis: ReferenceAxis, preload: float | None) -> tuple[Change, ...]:
    """Return the changes that an axis can have; no preload [N] of the reference where the nut does not follow it."""
    at_reference = axis.physics({})
    sizes, moving = sizes_of_drive(at_reference.then, ()), moving_mass(at_reference.then)
    changes = [
        Change(Cause.PAYLOAD, since_then(ADDED_MASS, _MASS.sized(sizes)), _SPREAD_OF_MASS * moving, _PAYLOAD_WORDS),
        Change(Cause.POSITION, since_then(POSITION_OFFSET.sized(sizes)), _SPREAD_OF_POSITION, _POSITION_WORDS),
        Change(Cause.SENSOR, since_then(TORQUE_DELAY.sized(sizes)), _SPREAD_OF_DELAY, _DELAY_WORDS),
        Change(Cause.SENSOR, SENSOR_GAIN, _SPREAD_OF_GAIN, _GAIN_WORDS),
        Change(Cause.BEARING, since_then(BEARING_CHANGE), _SPREAD_OF_STIFFNESS, _softer("the fixed bearing")),
        Change(Cause.BEARING, since_then(FAR_BEARING_CHANGE), _SPREAD_OF_STIFFNESS, _softer("the far bearing")),
        _temperature_change(axis.reported_warming),
    ]
    if preload is not None:
        effect = since_then(PRELOAD_CHANGE.sized(MachineSizes({Reference.PRELOAD: preload})))
        changes.insert(0, Change(Cause.PRELOAD, effect, _SPREAD_OF_PRELOAD * preload, _PRELOAD_WORDS))
    return tuple(change for change in changes if change.effect.applies(at_reference))


def is_reported(warming: float) -> bool:
    """Return whether windows report a change of the temperature, in kelvins."""
    return abs(warming) > _REPORTED


def _temperature_change(reported: float) -> Change:
    """Return the change of temperature: as the windows report it, as well as coefficients are known, or any."""
    spread = _SPREAD_OF_WARMING
    if is_reported(reported):
        spread = math.hypot(_REPORTED, _WARMING_KNOWN_TO * reported)
    return Change(
        Cause.TEMPERATURE, since_then(WARMING), spread, _TEMPERATURE_WORDS, usual=reported, known_to=_WARMING_KNOWN_TO
    )


def _softer(bearing: str) -> Callable[[float, float], str]:
    def words(size: float, half_width: float) -> str:
        ratio = math.exp(size)
        change = "lost" if size < 0.0 else "gained"
        percent = _rounded(100.0 * abs(ratio - 1.0), 100.0 * ratio * half_width)
        return f"{bearing} {change} {percent} % of its stiffness"

    return words


def _rounded(size: float, half_width: float) -> str:
    """Return a size and its interval with two digits of the interval."""
    digits = max(0, 1 - math.floor(math.log10(half_width))) if half_width > 0.0 else 0
    return f"{size:.{digits}f} ± {half_width:.{digits}f}"
