"""Read the units of a file or a channel map, and convert to SI, each by one factor. No unit is ever assumed.

A unit is a product of powers with a factor, so that every spelling of one is the same unit: ``m/(N.s2)``,
``(m/s²)/N`` and ``m/s^2/N``. What follows a stroke up to the next divides: ``m/s2/N.m`` is by the newton metre.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from functools import lru_cache

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint

_RESPONSE_UNITS = {
    ResponsePoint.ACCELERATION_AT_TABLE: "m/s2",
    ResponsePoint.ACCELERATION_AT_NUT: "m/s2",
    ResponsePoint.DISPLACEMENT_AT_TABLE: "m",
    ResponsePoint.ANGLE_AT_MOTOR: "rad",
}


class Quantity(StrEnum):
    """What a channel measures."""

    TORQUE = "torque"
    FORCE = "force"
    ACCELERATION = "acceleration"
    VELOCITY = "velocity"
    POSITION = "position"
    ANGLE = "motor-angle"
    SPEED = "motor-speed"
    CURRENT = "current"
    TIME = "time"
    FREQUENCY = "frequency"


#: 1 g is 9.806 65 m/s² (3rd CGPM, 1901).
_STANDARD_GRAVITY = 9.80665
#: 1 lb is 0.453 592 37 kg, and 1 lbf that under standard gravity: 4.448 221 615 260 5 N; an ounce is a sixteenth. 1 in
#: is 0.0254 m, 1 ft is 12 of them (NIST SP 811, 2008, appendix B.8; all exact). 1 kgf is 9.806 65 N, there as well.
_POUND_FORCE = 4.4482216152605
_FORCE = {"kg": 1, "m": 1, "s": -2}
#: Factor and powers of each unit that has a word of its own; raw ones (V, A, counts, percent, angles) have their own.
_ATOMS: dict[str, tuple[float, Mapping[str, int]]] = {
    "m": (1.0, {"m": 1}), "in": (0.0254, {"m": 1}), "ft": (0.3048, {"m": 1}), "kg": (1.0, {"kg": 1}),
    "s": (1.0, {"s": 1}), "min": (60.0, {"s": 1}), "h": (3600.0, {"s": 1}),
    "d": (86400.0, {"s": 1}), "Hz": (1.0, {"s": -1}),
    "N": (1.0, _FORCE), "lbf": (_POUND_FORCE, _FORCE), "ozf": (_POUND_FORCE / 16.0, _FORCE),
    "kgf": (_STANDARD_GRAVITY, _FORCE), "g": (_STANDARD_GRAVITY, {"m": 1, "s": -2}),
    "V": (1.0, {"V": 1}), "A": (1.0, {"A": 1}), "count": (1.0, {"count": 1}), "%": (1.0, {"%": 1}),
    "‰": (0.1, {"%": 1}), "rad": (1.0, {"rad": 1}), "deg": (math.pi / 180.0, {"rad": 1}),
    "rev": (2.0 * math.pi, {"rad": 1}), "dB": (1.0, {"dB": 1}), "K": (1.0, {"K": 1}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}), "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
}  # fmt: skip
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "da": 10.0, "k": 1e3, "M": 1e6}
_WITH_PREFIX = frozenset(("m", "s", "N", "g", "V", "A", "rad", "Hz", "Pa", "W", "bar"))
#: Other words of real files, in small letters.
_WORDS = {
    "newton": "N", "newtons": "N", "volt": "V", "volts": "V", "amp": "A", "amps": "A", "ampere": "A", "amperes": "A",
    "sec": "s", "second": "s", "seconds": "s", "sekunden": "s", "msec": "ms", "usec": "us", "inch": "in",
    "inches": "in", "lb": "lbf", "lbs": "lbf", "oz": "ozf", "kp": "kgf", "gn": "g", "counts": "count", "°": "deg",
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "percent": "%", "hertz": "Hz", "pct": "%",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "hours": "h", "minutes": "min", "db": "dB",
    "turns": "rev", "increments": "count", "inc": "count", "digits": "count", "lsb": "count", "rpm": "rev/min",
    "turn": "rev", "°c": "K", "degc": "K", "celsius": "K", "day": "d", "days": "d",
}  # fmt: skip
#: Turns by the minute, as drives write them without saying what turns, in small letters and without blanks.
_TURNS_BY_MINUTE = frozenset(("1/min", "min-1", "min^-1", "u/min", "upm"))
_SIGNS = str.maketrans({
    "²": "2", "³": "3", "·": ".", "⋅": ".", "*": ".", "µ": "u", "μ": "u", "−": "-", "⁻": "-", "¹": "1",
})  # fmt: skip
_TOKEN = re.compile(r"\d+(?:\.\d+)?|°?[^\W\d_]+|[%‰°]|[-/().^]")
_METRES_BY_SECOND_SQUARED = re.compile(r"\b([mu]?m)(?:s\^?-?2|ps2)\b")  # never a square of milliseconds
_SHARE_OF = re.compile(r"\s*(?:%|per ?cent\b|pct\b)(?!\s*(?:[/.·*^]|per\b))", re.IGNORECASE)  # "% of rated"
_LONGEST = 60  # letters of a unit


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: what one of it is in SI units (V, A, counts, percent and radians are kept), and their powers."""

    factor: float
    powers: tuple[tuple[str, int], ...]

    def to(self, exponent: int) -> "Unit":
        """Return a power of the unit."""
        return Unit(self.factor**exponent, tuple((name, power * exponent) for name, power in self.powers))

    def __mul__(self, other: "Unit") -> "Unit":
        powers = dict(self.powers)
        for name, power in other.powers:
            powers[name] = powers.get(name, 0) + power
        return Unit(self.factor * other.factor, _sorted(powers))

    def is_same(self, other: "Unit") -> bool:
        """Tell whether numbers in both mean the same."""
        return self.powers == other.powers and math.isclose(self.factor, other.factor, rel_tol=1e-9)


def _sorted(powers: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((name, power) for name, power in powers.items() if power))


def unit_of(text: str | None) -> Unit | None:
    """Return the unit that a text spells; None if it spells none that is known here.

    Examples
    --------
    >>> unit_of("lbf-in").is_same(unit_of("in.lbf")), unit_of("furlong")
    (True, None)

    """
    return None if text is None or len(text) > _LONGEST else _spelt(text)


@lru_cache(maxsize=1024)
def _spelt(text: str) -> Unit | None:
    if re.sub(r"\s", "", text.translate(_SIGNS)).lower() in _TURNS_BY_MINUTE:
        return _spelt("rev/min")
    tokens = _tokens(text)
    unit = None if tokens is None else _read(tokens)
    if unit is None and _SHARE_OF.match(text) is not None:
        return _spelt("%")
    return unit if unit is not None and unit.powers else None


def _tokens(text: str) -> list[str] | None:
    plain = _METRES_BY_SECOND_SQUARED.sub(r"\1/s2", text.replace("**", "^").translate(_SIGNS))
    tokens = _TOKEN.findall(plain)
    return tokens if "".join(tokens) == re.sub(r"\s", "", plain) else None


def _read(tokens: Sequence[str]) -> Unit | None:
    rest = list(tokens)
    unit = _quotient(rest)
    return None if rest else unit


def _quotient(rest: list[str]) -> Unit | None:
    """Take products parted by strokes off the beginning of a list of tokens."""
    unit = _product(rest)
    while unit is not None and rest[:1] == ["/"]:
        rest.pop(0)
        below = _product(rest)
        unit = None if below is None else unit * below.to(-1)
    return unit


def _product(rest: list[str]) -> Unit | None:
    unit = _power(rest)
    while unit is not None and rest and rest[0] not in ("/", ")"):
        if rest[0] in (".", "-"):
            rest.pop(0)
        other = None if rest[:1] and rest[0].isdigit() else _power(rest)
        unit = None if other is None else unit * other
    return unit


def _power(rest: list[str]) -> Unit | None:
    word = rest.pop(0) if rest else ""
    if word[:1].isdigit():  # "100 %", "1/s"
        return Unit(float(word), ()) if float(word) > 0.0 else None
    if word == "(":
        unit = _quotient(rest)
        if not rest or rest.pop(0) != ")":
            return None
    else:
        unit = _atom(word)
    if rest[:1] == ["^"]:
        rest.pop(0)
    sign = -1 if rest[:1] == ["-"] and len(rest) > 1 and rest[1].isdigit() else 1
    if sign < 0:
        rest.pop(0)
    if unit is None or not rest or not rest[0].isdigit() or len(rest[0]) > 1:
        return unit
    return unit.to(sign * int(rest.pop(0)))


def _atom(word: str) -> Unit | None:
    if word in _ATOMS:
        factor, powers = _ATOMS[word]
        return Unit(factor, _sorted(powers))
    for prefix, factor in _PREFIXES.items():
        if word.startswith(prefix) and word[len(prefix) :] in _WITH_PREFIX:
            of_word, powers = _ATOMS[word[len(prefix) :]]
            return Unit(factor * of_word, _sorted(powers))
    if word.lower() in _WORDS and (len(word) > 2 or word[0] == "°" or word.islower()):
        return _read(_TOKEN.findall(_WORDS[word.lower()]))
    if (match := re.fullmatch(r"([mkM]?N)([mc]?m)", word)) is not None:  # a torque without a sign between: Nm
        return _read([match[1], ".", match[2]])
    return _atom("g") if word == "G" else None


def _known(text: str) -> Unit:
    unit = unit_of(text)
    if unit is None:
        raise ValueError(text)
    return unit


#: Units that are proposed for each quantity; any other unit of its powers is read as well.
_CUSTOMARY = {
    Quantity.TORQUE: ("N.m", "mN.m", "N.mm", "N.cm", "kN.m", "lbf.in", "lbf.ft", "ozf.in"),
    Quantity.FORCE: ("N", "mN", "daN", "kN", "lbf", "kgf"),
    Quantity.ACCELERATION: ("m/s2", "mm/s2", "g", "mg", "in/s2"),
    Quantity.VELOCITY: ("m/s", "mm/s", "um/s", "m/min", "mm/min", "in/s"),
    Quantity.POSITION: ("m", "mm", "um", "nm", "in"),
    Quantity.ANGLE: ("rad", "mrad", "deg", "rev"),
    Quantity.SPEED: ("rad/s", "deg/s", "rev/s", "rev/min"),
    Quantity.CURRENT: ("A", "mA"),
    Quantity.TIME: ("s", "ms", "us", "ns", "min", "h", "d"),
    Quantity.FREQUENCY: ("Hz", "kHz"),
}
#: Factor to SI of the customary ones; the first is the unit of SI.
FACTOR_TO_SI = {quantity: {name: _known(name).factor for name in names} for quantity, names in _CUSTOMARY.items()}
#: What an acquisition writes before a sensitivity makes it a quantity.
RAW_UNITS = ("V", "mV", "A", "mA", "count", "%", "deg", "rad", "rev")
_RAW_POWERS = frozenset(_known(name).powers for name in RAW_UNITS)
_OUR_SPELLING = {
    (_known(name).powers, f"{_known(name).factor:.9e}"): name
    for name in (*(name for names in _CUSTOMARY.values() for name in names), *RAW_UNITS, "dB")
}


def canonical_unit(text: str | None) -> str | None:
    """Return our spelling of a unit found in a file, or None if it states none that is known here."""
    unit = unit_of(text)
    if text is None or unit is None:
        return None
    return _OUR_SPELLING.get((unit.powers, f"{unit.factor:.9e}"), text.strip())


def si_unit(quantity: Quantity) -> str:
    """Return the unit of SI, as files spell it."""
    return _CUSTOMARY[quantity][0]


def quantity_of_unit(text: str | None) -> Quantity | None:
    """Return the quantity that a unit belongs to; None for those of none, and those that are not known here."""
    unit = unit_of(text)
    return next((q for q in Quantity if unit is not None and _known(si_unit(q)).powers == unit.powers), None)


def is_raw(text: str | None) -> bool:
    """Tell whether a unit is that of an acquisition, which a sensitivity makes a quantity."""
    unit = unit_of(text)
    return unit is not None and unit.powers in _RAW_POWERS


def factor_to(wanted: str, text: str) -> float | None:
    """Return what a value in the unit of a text is multiplied with to be in another; None where it is none of these."""
    unit, target = unit_of(text), _known(wanted)
    return unit.factor / target.factor if unit is not None and unit.powers == target.powers else None


def factor_to_si(unit: str, quantity: Quantity, where: str) -> float:
    """Return what a value in ``unit`` is multiplied with to be in SI.

    ``RecordingFormatError`` if the unit does not belong to the quantity.
    """
    if (factor := factor_to(si_unit(quantity), unit)) is not None:
        return factor
    other = quantity_of_unit(unit)
    hint = f", a unit of {other}" if other is not None else ""
    hint += "; a raw unit needs sensitivity and sensitivity_unit" if is_raw(unit) else ""
    raise RecordingFormatError(
        f"{where}: expected a unit of {quantity} ({', '.join(_CUSTOMARY[quantity])}); got {unit!r}{hint}"
    )


def sensor_factor(raw_unit: str, sensitivity: float, sensitivity_unit: str, quantity: Quantity, where: str) -> float:
    """Return what a raw value is multiplied with to be in SI: the SI unit of the quantity per raw unit.

    The raw unit is V, A, count, % or an angle. The sensitivity is raw per quantity as on a sensor's sheet (``mV/g``,
    ``mV/(m/s2)``) or quantity per raw (``N.m/A``, ``mm/rev``; ``N.m/100%`` of a rated torque);
    ``RecordingFormatError`` if its unit does not connect the raw unit with the quantity. ``where`` names file and place
    for the message.

    Examples
    --------
    0.1 V from an accelerometer of 100 mV/g is 1 g, 9.80665 m/s² by definition:

    >>> round(0.1 * sensor_factor("V", 100.0, "mV/g", Quantity.ACCELERATION, "example"), 10)
    9.80665
    """
    wanted, raw = _known(si_unit(quantity)), unit_of(raw_unit) if is_raw(raw_unit) else None
    for unit in () if raw is None else _ratios(sensitivity_unit):
        if raw is not None and unit.powers == (raw * wanted.to(-1)).powers:
            return raw.factor / unit.factor / sensitivity
        if raw is not None and unit.powers == (wanted * raw.to(-1)).powers:
            return raw.factor * unit.factor * sensitivity
    raise RecordingFormatError(
        f"{where}: expected sensitivity_unit to connect a raw unit ({', '.join(RAW_UNITS)}) with {quantity} "
        f"({', '.join(_CUSTOMARY[quantity])}), such as 'mV/g' or 'N.m/A'; "
        f"got {sensitivity_unit!r} for unit {raw_unit!r}"
    )


def _ratios(text: str) -> Iterator[Unit]:
    """Yield the ways to read a quotient, one for each stroke: ``mV/m/s2`` may only mean millivolts by ``m/s2``."""
    tokens = _tokens(text) or []
    for at in (i for i, word in enumerate(tokens) if word == "/"):
        above, below = _read(tokens[:at]), _read(tokens[at + 1 :])
        if above is not None and below is not None:
            yield above * below.to(-1)


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
    """Tell whether a text spells the unit that two points imply; ``m/s2/N.m`` divides by the newton metre."""
    return factor_to(response_unit(excitation, response), text) == 1.0


def response_factor(unit: str, excitation: ExcitationPoint, response: ResponsePoint, where: str) -> float:
    """Return what a frequency response in ``unit`` is multiplied with to be in SI: ``um/N``, ``g/lbf``, ``m/(N.s2)``.

    ``RecordingFormatError`` if the unit is not that of what answers by that of what is excited.
    """
    if (factor := factor_to(response_unit(excitation, response), unit)) is not None:
        return factor
    raise RecordingFormatError(
        f"{where}: expected the unit of {response} by {excitation}, such as {response_unit(excitation, response)!r}; "
        f"got {unit!r}"
    )


def metres(millimetres: float) -> float:
    """Shift the decimal point, so that 123.4 mm is the number 0.1234 (``123.4 * 1e-3`` may miss it by a bit)."""
    return float(Decimal(repr(float(millimetres))).scaleb(-3))


def to_millimetres(metres_: float) -> float:
    """Shift the decimal point back; the inverse of :func:`metres` for values of up to 15 digits."""
    return float(Decimal(repr(float(metres_))).scaleb(3))
