"""Convert the units of a file or a channel map to SI, each by one factor. No unit is ever assumed.

Name the unit of a frequency response: excitation and response imply it; it is compared, never converted.
"""

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


#: Factor to SI. 1 g is 9.806 65 m/s² (3rd CGPM, 1901).
FACTOR_TO_SI: dict[Quantity, dict[str, float]] = {
    Quantity.TORQUE: {"N.m": 1.0, "mN.m": 1e-3, "N.cm": 1e-2, "kN.m": 1e3},
    Quantity.FORCE: {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    Quantity.ACCELERATION: {"m/s2": 1.0, "mm/s2": 1e-3, "g": 9.80665},
    Quantity.POSITION: {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    Quantity.TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6},
}
#: What an acquisition writes before a sensitivity makes it a quantity; factor to V, A or counts.
RAW_UNITS = {"V": 1.0, "mV": 1e-3, "A": 1.0, "mA": 1e-3, "count": 1.0}
_RAW_DIMENSION = {"V": "V", "mV": "V", "A": "A", "mA": "A", "count": "count"}

#: Spellings found in real files, for comparing a file's own unit with the map's.
_SPELLINGS = {
    "m/s^2": "m/s2", "m/s²": "m/s2", "m/s**2": "m/s2", "m/s/s": "m/s2", "mm/s^2": "mm/s2", "mm/s²": "mm/s2",
    "Nm": "N.m", "N*m": "N.m", "N·m": "N.m", "N-m": "N.m", "mNm": "mN.m", "Ncm": "N.cm", "kNm": "kN.m",
    "Volts": "V", "Volt": "V", "volts": "V", "volt": "V", "Amps": "A", "Ampere": "A",
    "Newton": "N", "newton": "N", "newtons": "N", "gn": "g", "sec": "s", "seconds": "s", "µm": "um",
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
    factors = FACTOR_TO_SI[quantity]
    if unit not in factors:
        hint = "; a raw unit needs sensitivity and sensitivity_unit" if unit in RAW_UNITS else ""
        raise RecordingFormatError(f"{where}: expected a unit of {quantity} ({', '.join(factors)}); got {unit!r}{hint}")
    return factors[unit]


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
    for raw, per_raw in RAW_UNITS.items():
        if _RAW_DIMENSION[raw] != _RAW_DIMENSION.get(raw_unit):
            continue
        in_raw = RAW_UNITS[raw_unit] / per_raw
        for unit, factor in FACTOR_TO_SI[quantity].items():
            if sensitivity_unit in (f"{raw}/{unit}", f"{raw}/({unit})"):
                return in_raw / sensitivity * factor
            if sensitivity_unit in (f"{unit}/{raw}", f"({unit})/{raw}"):
                return in_raw * sensitivity * factor
    raise RecordingFormatError(
        f"{where}: expected sensitivity_unit to connect a raw unit ({', '.join(RAW_UNITS)}) with {quantity} "
        f"({', '.join(FACTOR_TO_SI[quantity])}), such as 'mV/g' or 'N.m/A'; "
        f"got {sensitivity_unit!r} for unit {raw_unit!r}"
    )


def metres(millimetres: float) -> float:
    """Shift the decimal point, so that 123.4 mm is the number 0.1234 (``123.4 * 1e-3`` may miss it by a bit)."""
    return float(Decimal(repr(float(millimetres))).scaleb(-3))


def to_millimetres(metres_: float) -> float:
    """Shift the decimal point back; the inverse of :func:`metres` for values of up to 15 digits."""
    return float(Decimal(repr(float(metres_))).scaleb(3))
