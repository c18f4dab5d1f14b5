"""Effects of a channel that was recorded in another unit than is stated: one factor, under all conditions.

A factor within two either way is a wrong scale, not another unit: the range of ``force-scale`` ends where that of a
unit begins.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, increasing

#: Recorded over true value in SI, by what a person calls the unit. Weights by the standard gravity, pounds and inches
#: by their definitions (NIST SP 811).
_GRAVITY, _POUND, _INCH = 9.80665, 0.45359237, 0.0254
_FORCE = {"lbf": 1.0 / (_POUND * _GRAVITY), "kgf": 1.0 / _GRAVITY, "daN": 0.1, "kN": 1e-3, "mN": 1e3}
_LENGTH = {"mm": 1e3, "µm": 1e6, "cm": 1e2, "in": 1.0 / _INCH}
_RESPONSE = {"g": 1.0 / _GRAVITY, "mm or mm/s²": 1e3, "µm": 1e6, "in or in/s²": 1.0 / _INCH}
_TORQUE = {
    "N·mm": 1e3,
    "N·cm": 1e2,
    "mN·m": 1e3,
    "kgf·cm": 1e2 / _GRAVITY,
    "lbf·in": 1.0 / (_POUND * _GRAVITY * _INCH),
    "lbf·ft": 1.0 / (_POUND * _GRAVITY * 12.0 * _INCH),
    "ozf·in": 16.0 / (_POUND * _GRAVITY * _INCH),
}
#: By the name of the effect: what is recorded, its unit in SI, and the factors of others.
_UNITS: Mapping[str, tuple[str, str, Mapping[str, float]]] = {
    "Unit of force or position": (
        "force or position",
        "N or m",
        {f"force in {unit}": factor for unit, factor in _FORCE.items()}
        | {f"position in {unit}": 1.0 / factor for unit, factor in _LENGTH.items()},
    ),
    "Unit of response": ("response", "m or m/s²", _RESPONSE),
    "Unit of torque": ("torque", "N·m", _TORQUE),
}
#: A wrong scale, by this factor at the most, is no other unit.
_LEAST_LN_FACTOR = math.log(2.0)
_LARGEST_LN_FACTOR = math.log(2e6)
#: A factor of a unit is exact; how well one is known, in standard deviations, and what a sensitivity may be off by.
_COVERAGE, _SENSITIVITY = 2.0, 0.03

_LN_FACTOR = EffectParameter(
    "ln_factor", "-", lower=-_LARGEST_LN_FACTOR, upper=_LARGEST_LN_FACTOR, scale=_LEAST_LN_FACTOR, beyond=False
)
_effect = partial(
    Effect,
    source="NIST SP 811: factors between units",
    parameters=(_LN_FACTOR,),
    least=_LEAST_LN_FACTOR,
)

MOTION_UNIT = _effect(
    "unit",
    "Unit of force or position",
    "The recorded force is not in newtons, or the position not in metres: mass and viscous friction as stated are "
    "wrong by one large factor. Of the two no motion tells which; other forces are found in the unit of the record.",
    add=increasing("", unit_ln_factor="ln_factor"),
)

RESPONSE_UNIT = _effect(
    "unit",
    "Unit of response",
    "What table or nut do is recorded in g, millimetres or volts: their responses are wrong by one large factor at "
    "every frequency and under all conditions, and no phase or natural frequency is.",
    add=increasing("added", response_ln_factor="ln_factor"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)

TORQUE_UNIT = _effect(
    "torque-unit",
    "Unit of torque",
    "The torque is recorded in another unit or as a current: all responses to it are wrong by one large factor at "
    "every frequency and under all conditions, and no phase or natural frequency is.",
    add=increasing("added", torque_ln_factor="ln_factor"),
    needs=frozenset({ConditionAxis.FREQUENCY}),
)


@dataclass(frozen=True, slots=True)
class RecordedUnit:
    """In which unit a channel seems to be recorded."""

    quantity: str  # "torque"
    stated: str  # its unit
    factor: float  # recorded over true value [-]
    units: tuple[str, ...]  # that agree with the factor; none: a scale, as of volts


def recorded_unit(name: str, ln_factor: float, deviation: float) -> RecordedUnit:
    """Return the units that an effect of this name may stand for.

    ``name`` is that of the effect; the ln of recorded over true value comes with its deviation [-]. Units agree whose
    exact factor is within two standard deviations; none where the factor is a bound, without a finite deviation.
    """
    quantity, stated, others = _UNITS[name]
    apart = _COVERAGE * math.hypot(deviation, _SENSITIVITY)
    agreeing = (unit for unit, factor in others.items() if abs(ln_factor - math.log(factor)) <= apart < math.inf)
    return RecordedUnit(quantity, stated, math.exp(ln_factor), tuple(agreeing))
