"""Convert the units of a file or a channel map to SI, each by one factor. No unit is ever assumed.

The unit of a frequency response follows from excitation and response: it is compared, never converted.
"""

import math
from collections.abc import Iterator
from decimal import Decimal
from enum import StrEnum

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint

_RESPONSE_UNITS = {
    ResponsePoint.ACCELERATION_AT_TABLE: "m/s2",
    ResponsePoint.ACCELERATION_AT_NUT: "m/s2",
    ResponsePoint.DISPLACEMENT_AT_TABLE: "m",
    ResponsePoint.ANGLE_AT_MOTOR: "rad",
}
#: Other signs for powers and products; no spelling of a quotient of units is common to all writers.
_SIGNS = str.maketrans({"^": None, " ": None, "²": "2", "·": ".", "⋅": ".", "*": "."})


def excitation_unit(excitation: ExcitationPoint) -> str:
    """Return the unit of what drives the axis there."""
    return "N" if excitation is ExcitationPoint.FORCE_AT_TABLE else "N.m"


def response_unit(excitation: ExcitationPoint, response: ResponsePoint) -> str:
    """Return the unit that two points imply, as files spell it: ``m/(N.m.s2)``, ``m/N``, ``rad/(N.m)``, …."""
    per = excitation_unit(excitation)
    if response.is_acceleration:
        return f"m/({per}.s2)"
    return f"{_RESPONSE_UNITS[response]}/{'N' if per == 'N' else '(N.m)'}"


def is_response_unit(text: str, excitation: ExcitationPoint, response: ResponsePoint) -> bool:
    """Tell whether a text spells the unit; ``m/s2/N.m`` divides by the newton metre, as people write."""
    plain = text.replace("**", "").translate(_SIGNS).replace("Nm", "N.m")
    of, per = _RESPONSE_UNITS[response], excitation_unit(excitation)
    quotients = {f"{above}/{below}" for above in (of, f"({of})") for below in (per, f"({per})")}
    if response.is_acceleration:
        quotients |= {f"m/({per}.s2)", f"m/(s2.{per})"}
    return plain in quotients


class Quantity(StrEnum):
    """What a channel measures."""

    TORQUE = "torque"
    FORCE = "force"
    ACCELERATION = "acceleration"
    POSITION = "position"
    TIME = "time"


#: 1 g is 9.806 65 m/s² (3rd CGPM, 1901).
_STANDARD_GRAVITY = 9.80665
#: 1 lb is 0.453 592 37 kg, and 1 lbf that under standard gravity: 4.448 221 615 260 5 N. 1 in is 0.0254 m, 1 ft is 12
#: of them (NIST SP 811, 2008, appendix B.8; all exact). 1 kgf is 9.806 65 N, there as well.
_POUND_FORCE = 4.4482216152605
#: Factor to SI.
FACTOR_TO_SI: dict[Quantity, dict[str, float]] = {
    Quantity.TORQUE: {
        "N.m": 1.0, "mN.m": 1e-3, "N.mm": 1e-3, "N.cm": 1e-2, "kN.m": 1e3,
        "lbf.in": 0.0254 * _POUND_FORCE, "lbf.ft": 0.3048 * _POUND_FORCE,
    },
    Quantity.FORCE: {
        "N": 1.0, "mN": 1e-3, "daN": 10.0, "kN": 1e3, "lbf": _POUND_FORCE, "kgf": _STANDARD_GRAVITY,
    },
    Quantity.ACCELERATION: {"m/s2": 1.0, "mm/s2": 1e-3, "g": _STANDARD_GRAVITY, "in/s2": 0.0254},
    Quantity.POSITION: {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    Quantity.TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6},
}  # fmt: skip
#: What an acquisition writes before a sensitivity makes it a quantity; factor to V, A or counts.
RAW_UNITS = {"V": 1.0, "mV": 1e-3, "A": 1.0, "mA": 1e-3, "count": 1.0}
_RAW_DIMENSION = {"V": "V", "mV": "V", "A": "A", "mA": "A", "count": "count"}

_ANSWERS = {"m/s2": Quantity.ACCELERATION, "m": Quantity.POSITION}
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0}

#: Spellings found in real files, for comparing a file's own unit with the map's.
_SPELLINGS = {
    "m/s^2": "m/s2", "m/s²": "m/s2", "m/s**2": "m/s2", "m/s/s": "m/s2", "mm/s^2": "mm/s2", "mm/s²": "mm/s2",
    "Nm": "N.m", "N*m": "N.m", "N·m": "N.m", "N-m": "N.m", "mNm": "mN.m", "Ncm": "N.cm", "kNm": "kN.m",
    "Volts": "V", "Volt": "V", "volts": "V", "volt": "V", "Amps": "A", "Ampere": "A",
    "Newton": "N", "newton": "N", "newtons": "N", "gn": "g", "sec": "s", "seconds": "s", "µm": "um", "μm": "um",
    "µs": "us", "μs": "us", "msec": "ms", "Sekunden": "s", "lb": "lbf", "lbs": "lbf", "lbf-in": "lbf.in",
    "lbf*in": "lbf.in", "lbf·in": "lbf.in", "lbf⋅in": "lbf.in", "in-lbf": "lbf.in", "in.lbf": "lbf.in",
    "in-lb": "lbf.in", "lbf-ft": "lbf.ft", "lbf*ft": "lbf.ft", "lbf·ft": "lbf.ft", "lbf⋅ft": "lbf.ft",
    "ft-lbf": "lbf.ft", "ft-lb": "lbf.ft", "ft.lbf": "lbf.ft", "N⋅m": "N.m", "counts": "count",
    "Nmm": "N.mm", "N·mm": "N.mm", "N*mm": "N.mm", "N-mm": "N.mm", "N⋅mm": "N.mm", "kp": "kgf",
    "inch": "in", "in/s^2": "in/s2", "in/s²": "in/s2",
}  # fmt: skip
_KNOWN = {unit for units in FACTOR_TO_SI.values() for unit in units} | set(RAW_UNITS)


def canonical_unit(text: str | None) -> str | None:
    """Return our spelling of a unit found in a file, or None if it states none that is known here."""
    if text is None:
        return None
    unit = _SPELLINGS.get(text.strip(), text.strip())
    return unit if unit in _KNOWN else None


def factor_to_si(unit: str, quantity: Quantity, where: str) -> float:
    """Return what a value in ``unit`` is multiplied with to be in SI.

    ``RecordingFormatError`` if the unit does not belong to the quantity.
    """
    factors, canonical = FACTOR_TO_SI[quantity], canonical_unit(unit)
    if canonical not in factors:
        other = next((str(of) for of, units in FACTOR_TO_SI.items() if canonical in units), None)
        hint = "; a raw unit needs sensitivity and sensitivity_unit" if canonical in RAW_UNITS else ""
        hint = f", a unit of {other}" if other is not None else hint
        raise RecordingFormatError(f"{where}: expected a unit of {quantity} ({', '.join(factors)}); got {unit!r}{hint}")
    return factors[canonical]


def sensor_factor(raw_unit: str, sensitivity: float, sensitivity_unit: str, quantity: Quantity, where: str) -> float:
    """Return what a raw value is multiplied with to be in SI: the SI unit of the quantity per raw unit.

    The raw unit is V, mV, A, mA or count. The sensitivity is raw per quantity as on a sensor's sheet (``mV/g``,
    ``mV/(m/s2)``) or quantity per raw (``N.m/A``); ``RecordingFormatError`` if its unit does not connect the raw unit
    with the quantity. ``where`` names file and place for the message.

    Examples
    --------
    0.1 V from an accelerometer of 100 mV/g is 1 g, 9.80665 m/s² by definition:

    >>> round(0.1 * sensor_factor("V", 100.0, "mV/g", Quantity.ACCELERATION, "example"), 10)
    9.80665
    """
    raw_unit = canonical_unit(raw_unit) or raw_unit
    for above, below in _quotients(sensitivity_unit):
        if _same_raw(raw_unit, above) and below in FACTOR_TO_SI[quantity]:
            return RAW_UNITS[raw_unit] / RAW_UNITS[above] / sensitivity * FACTOR_TO_SI[quantity][below]
        if _same_raw(raw_unit, below) and above in FACTOR_TO_SI[quantity]:
            return RAW_UNITS[raw_unit] / RAW_UNITS[below] * sensitivity * FACTOR_TO_SI[quantity][above]
    raise RecordingFormatError(
        f"{where}: expected sensitivity_unit to connect a raw unit ({', '.join(RAW_UNITS)}) with {quantity} "
        f"({', '.join(FACTOR_TO_SI[quantity])}), such as 'mV/g' or 'N.m/A'; "
        f"got {sensitivity_unit!r} for unit {raw_unit!r}"
    )


def _quotients(text: str) -> Iterator[tuple[str, str]]:
    """Split a quotient of two units at each of its strokes: ``mV/m/s2`` may only mean millivolts by ``m/s2``."""
    parts = text.replace(" ", "").split("/")
    for at in range(1, len(parts)):
        sides = ("/".join(parts[:at]), "/".join(parts[at:]))
        above, below = (side[1:-1] if side.startswith("(") and side.endswith(")") else side for side in sides)
        yield canonical_unit(above) or above, canonical_unit(below) or below


def quotient_of(text: str) -> tuple[str, str] | None:
    """Return the two units of a quotient in our spelling, None where it has none that are known here."""
    known = _KNOWN | set(_ANGLES)
    return next(((above, below) for above, below in _quotients(text) if above in known and below in known), None)


def _same_raw(raw_unit: str, other: str) -> bool:
    return raw_unit in _RAW_DIMENSION and _RAW_DIMENSION[raw_unit] == _RAW_DIMENSION.get(other)


def response_factor(unit: str, excitation: ExcitationPoint, response: ResponsePoint, where: str) -> float:
    """Return what a frequency response in ``unit`` is multiplied with to be in SI: ``um/N``, ``g/lbf``, ``m/(N.s2)``.

    ``RecordingFormatError`` if the unit is not that of what answers by that of what is excited.
    """
    if is_response_unit(unit, excitation, response):
        return 1.0
    driven = FACTOR_TO_SI[Quantity.FORCE if excitation_unit(excitation) == "N" else Quantity.TORQUE]
    answers = _ANGLES if _RESPONSE_UNITS[response] == "rad" else FACTOR_TO_SI[_ANSWERS[_RESPONSE_UNITS[response]]]
    for above, below in _quotients(unit):
        if above in answers and below in driven:
            return answers[above] / driven[below]
    raise RecordingFormatError(
        f"{where}: expected the unit of {response} by {excitation}, such as {response_unit(excitation, response)!r} "
        f"({', '.join(answers)} by {', '.join(driven)}); got {unit!r}"
    )


def metres(millimetres: float) -> float:
    """Shift the decimal point, so that 123.4 mm is the number 0.1234 (``123.4 * 1e-3`` may miss it by a bit)."""
    return float(Decimal(repr(float(millimetres))).scaleb(-3))


def to_millimetres(metres_: float) -> float:
    """Shift the decimal point back; the inverse of :func:`metres` for values of up to 15 digits."""
    return float(Decimal(repr(float(metres_))).scaleb(3))
