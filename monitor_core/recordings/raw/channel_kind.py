"""Propose what a channel measures, from its name, its unit and its values. A proposal is for a person to confirm."""

import re

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.recordings.elements.units import (
    FACTOR_TO_SI,
    RAW_UNITS,
    Quantity,
    canonical_unit,
    factor_to,
    is_raw,
    quantity_of_unit,
)

#: What drives an axis, and what holds one value while the axis stands.
DRIVES = (Quantity.TORQUE, Quantity.FORCE, Quantity.CURRENT)
STANDING = (Quantity.POSITION, Quantity.ANGLE, Quantity.VELOCITY, Quantity.SPEED)

#: How words in the name of a channel begin, in the languages of controls and loggers; the first kind that fits counts.
_BEGINNINGS: dict[Quantity | None, tuple[str, ...]] = {
    None: ("temp", "volt", "spann", "status", "phase"),
    Quantity.SPEED: ("rpm", "drehzahl"),
    Quantity.VELOCITY: ("veloc", "speed", "geschw", "vitesse"),
    Quantity.ACCELERATION: ("acc", "beschl", "vibr", "schwing"),
    Quantity.TORQUE: ("torq", "trq", "drehmo", "moment", "couple", "coppia"),
    Quantity.FORCE: ("forc", "kraft", "hammer", "impact", "impuls", "loadcell", "forza"),
    Quantity.ANGLE: ("theta", "angle", "winkel", "phi", "rotor"),
    Quantity.POSITION: (
        "pos", "lage", "weg", "displ", "encod", "travel", "stroke", "geber", "scale", "maßst", "massst", "règle",
        "regle",
    ),
    Quantity.FREQUENCY: ("freq", "hz"),
    Quantity.TIME: ("time", "zeit", "elapsed"),
}  # fmt: skip
#: A current, where no other word says what is current ("current position").
_CURRENT = ("current", "strom", "courant", "ampere", "iq")
#: Whole names that people give.
_WHOLE = {
    "a": Quantity.ACCELERATION, "ax": Quantity.ACCELERATION, "ay": Quantity.ACCELERATION,
    "az": Quantity.ACCELERATION, "f": Quantity.FORCE, "fx": Quantity.FORCE, "fy": Quantity.FORCE,
    "fz": Quantity.FORCE, "m": Quantity.TORQUE, "tq": Quantity.TORQUE, "i": Quantity.CURRENT,
    "t": Quantity.TIME,
    "sec": Quantity.TIME, "seconds": Quantity.TIME, "sek": Quantity.TIME,
}  # fmt: skip
#: What a unit says of a name that leaves it open, or says it loosely: a "torque" in A is the current that makes it.
_SAID_BY_UNIT = frozenset((
    (Quantity.POSITION, Quantity.ANGLE), (Quantity.VELOCITY, Quantity.SPEED),
    (Quantity.TORQUE, Quantity.CURRENT), (Quantity.CURRENT, Quantity.TORQUE),
    (Quantity.SPEED, Quantity.VELOCITY),
))  # fmt: skip
_PLANNED = re.compile(r"set|soll|target|ref|c(omman|m)d|error|fehler|nom", re.IGNORECASE)
_ERROR = re.compile(r"^err|err(or)?$|fehler|^(dev|diff|lag)$|^(deviat|differ)")  # of a word: not "Device", "Lage"
_IN_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]\s*$")
_ENDING = re.compile(
    r"[_ ]((?:m|mm|um|in|rad|deg|rev)[_/](?:s|min)|(?:[a-zA-Z]+\d?)(?:_s2|ps2|/s2|/s\^2|/s²)?)$", re.IGNORECASE
)
#: Units as names of columns spell them, in small letters.
_IN_NAMES = {
    "mnm": "mN.m", "ncm": "N.cm", "knm": "kN.m", "n": "N", "kn": "kN", "mm_s2": "mm/s2", "m_s2": "m/s2",
    "m_per_s2": "m/s2", "mm_s": "mm/s", "m_s": "m/s", "um_s": "um/s", "mm_min": "mm/min", "m_min": "m/min",
    "rad_s": "rad/s", "deg_s": "deg/s", "rev_s": "rev/s", "rev_min": "rev/min",
    "v": "V", "mv": "mV", "a": "A", "ma": "mA", "hz": "Hz", "khz": "kHz",
}  # fmt: skip
#: Units at the end of a name that are more often words.
_WORDS = frozenset(("in", "rev", "min", "h", "count", "K", "W"))
#: How single numbers are named that state the rate [Hz], or the step [s]; without blanks, hyphens and underscores.
_NAMES_OF_RATE = frozenset((
    "fs", "fshz", "fsamp", "fsample", "fsampling", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency",
    "sampleratehz", "samplingratehz", "samplingfrequencyhz", "samplingfreq", "samplefreq", "sampfreq", "samprate",
    "abtastrate", "abtastfrequenz",
))  # fmt: skip
_NAMES_OF_STEP = frozenset((
    "dt", "ts", "tsample", "sampletime", "samplingtime", "sampleinterval", "samplinginterval", "xincrement", "timestep",
    "deltat", "sampleperiod", "samplingperiod", "wfincrement", "abtastzeit", "abtastintervall",
))  # fmt: skip


def kind_of_name(name: str) -> Quantity | None:
    """Return what the name says; the last part of a name with slashes counts first."""
    for part in (re.split(r"[/\\.]", name)[-1], name):
        whole = _WHOLE.get(_without_unit(part).strip().lower())
        if whole is not None:
            return whole
        words = [word.removeprefix("ist").removeprefix("soll") for word in _words(_without_unit(part))]
        for kind, beginnings in _BEGINNINGS.items():
            if any(word.startswith(beginnings) for word in words):
                return kind
        if _is_current(part):
            return Quantity.CURRENT
    return None


def _is_current(name: str) -> bool:
    return any(word.startswith(_CURRENT) for word in _words(_without_unit(name)))


def kind_of_unit(unit: str | None) -> Quantity | None:
    """Return what a unit belongs to; a voltage is taken for nothing."""
    return Quantity.FREQUENCY if canonical_unit(unit) == "rad/s" else quantity_of_unit(unit)


def kind_in_unit(kind: Quantity | None, unit: str | None) -> Quantity | None:
    """Return what a name says, and its unit more closely: a position in degrees is an angle."""
    by_unit = kind_of_unit(unit)
    return by_unit if (kind, by_unit) in _SAID_BY_UNIT else kind


def unit_in_name(name: str) -> str | None:
    """Return the unit that the name of a channel states: ``Force [kN]``, ``acc (g)``, ``time_ms``; None if none.

    A single letter at the end is a unit only of what the rest of the name says: ``force_n``, but not ``torque_a``;
    and so is "in", which is a word: ``travel_in``, but not ``signal_in``.
    """
    bracket = _IN_BRACKETS.search(name)
    stated = None if bracket is None else _spelt(bracket[1].strip(), kind_of_name(name))
    stated = stated or _unit_behind_sign(name)
    return stated if stated is not None or bracket is not None else _unit_at_end(name)


def _unit_behind_sign(name: str) -> str | None:
    """Return the unit of "a / (m/s²)", "Kraft in N" and "Torque %"."""
    for sign in ("/", " in "):
        left, _, right = name.partition(sign)
        kind = kind_of_name(left)
        if kind is not None and kind == kind_of_unit(right) and not is_raw(right):
            return canonical_unit(right)
    return "%" if name.rstrip().endswith("%") else None


def _unit_at_end(name: str) -> str | None:
    if (ending := _ENDING.search(name)) is None:
        return None
    says = kind_of_name(name[: ending.start()])
    unit = _spelt(ending[1], says)
    if unit is None or unit in _WORDS:
        return unit if says is Quantity.POSITION and unit in ("in", "rev", "count") else None
    if is_raw(unit):
        letter_is_unit = unit == "A" and _is_current(name[: ending.start()])  # "current_a", but not "torque_a"
        is_said = letter_is_unit or (says is not None and len(ending[1]) > 1)
        return unit if is_said or unit in ("deg", "rad") else None
    fits = kind_in_unit(says, unit) == kind_of_unit(unit)
    return unit if (says is None and len(ending[1]) > 1) or fits else None


def _spelt(text: str, says: Quantity | None) -> str | None:
    """Return a unit as names spell it, in any letters: "nm" are newton metres of a torque."""
    small = text.lower()
    if small == "nm" and says in (Quantity.TORQUE, None):
        return "N.m" if says or text != "nm" else "nm"
    return canonical_unit(text) or canonical_unit(_IN_NAMES.get(small, small))


def rate_of_number(name: str, value: float) -> float | None:
    """Return the rate that a single number states by its name, as a rate or as a step [Hz]; None if it states none.

    Examples
    --------
    >>> rate_of_number("Sample Rate [kHz]", 51.2), rate_of_number("daq.dt", 0.001), rate_of_number("gain", 2.0)
    (51200.0, 1000.0, None)

    """
    letters, unit = letters_of(name), unit_in_name(name)
    if unit is not None and letters not in _NAMES_OF_RATE | _NAMES_OF_STEP:  # "dt_ms"
        letters = letters_of(_ENDING.sub("", name))
    if letters in _NAMES_OF_RATE:
        rate = value * (1.0 if unit is None else factor_to("Hz", unit) or 0.0)
        return rate if rate > 0.0 else None
    step = value * (1.0 if unit is None else factor_to("s", unit) or 0.0) if letters in _NAMES_OF_STEP else 0.0
    return 1.0 / step if 0.0 < step < 1.0 else None


def letters_of(name: str) -> str:
    """Return the letters of the last part of a name, small and without its unit: "samplerate"."""
    return re.sub(r"[\W\d_]", "", _without_unit(name).rpartition(".")[2].lower())


def names_other_unit(name: str) -> bool:
    """Tell whether a name ends in brackets that hold no unit known here: minutes, hours, nanoseconds, …."""
    return _IN_BRACKETS.search(name) is not None and unit_in_name(name) is None


def kind_of(name: str, unit: str | None, samples: SampleArray) -> Quantity | None:
    """Return what a channel looks like: by its name, else by its unit, else a time by values that rise evenly."""
    stated = unit or unit_in_name(name)
    by_name, by_unit = kind_in_unit(kind_of_name(name), stated), kind_of_unit(stated)
    if by_name is Quantity.ACCELERATION and by_unit in STANDING:
        by_name = by_unit  # what is in degrees or millimetres is none, whatever it is called
    for kind in (by_name, by_unit):
        if kind is Quantity.FREQUENCY and (_says_other(name) or not _rises(samples)):
            if canonical_unit(stated) == "rad/s":
                return Quantity.SPEED
            continue  # that of a drive, which goes up and down; lines of a spectrum rise
        if kind is not None:
            return kind
    return Quantity.TIME if unit is None and rises_evenly(samples) else None


def _rises(samples: SampleArray) -> bool:
    return samples.ndim == 1 and bool(np.all(samples[1:] > samples[:-1]))


def is_of_other_quantity(name: str, unit: str | None) -> bool:
    """Tell whether name or unit say something that no map asks for: a temperature, a voltage, a state."""
    stated = unit or unit_in_name(name)
    if canonical_unit(stated) is not None and kind_of_unit(stated) is None and not is_raw(stated):
        return True
    return _says_other(name)


def _says_other(name: str) -> bool:
    return any(word.startswith(_BEGINNINGS[None]) for word in _words(_without_unit(name)))


def is_planned(name: str) -> bool:
    """Tell whether a name is that of a set point or an error, which was not measured."""
    return _PLANNED.search(name) is not None


def is_of_motor(name: str) -> bool:
    """Tell whether a name is that of something the motor does, and not the table."""
    return any(word.startswith(("motor", "rotor")) for word in _words(name))


def is_error(name: str) -> bool:
    """Tell whether a name is that of what a control lacks of its set point."""
    return any(_ERROR.search(word) for word in _words(name))


@np.errstate(over="ignore", invalid="ignore")
def rises_evenly(samples: SampleArray) -> bool:
    """Tell whether values rise by one step, as sampling times and lines of a spectrum do."""
    if samples.ndim != 1 or samples.size < 3 or not np.all(np.isfinite(samples)):
        return False
    steps = np.diff(samples.astype(np.float64))
    middle = float(np.median(steps))
    return middle > 0.0 and bool(steps.min() > 0.0) and bool(np.mean(np.abs(steps - middle) < 0.5 * middle) > 0.9)


def units_of(kind: Quantity) -> tuple[str, ...]:
    """Return the units that a channel of a kind may have, raw ones last."""
    if kind is Quantity.FREQUENCY:
        return ("Hz",)
    raw = () if kind is Quantity.TIME else tuple(RAW_UNITS)
    return tuple(dict.fromkeys((*FACTOR_TO_SI[kind], *raw)))


def _without_unit(name: str) -> str:
    """Return a name without brackets at its end."""
    return _IN_BRACKETS.sub("", name)


def _words(name: str) -> list[str]:
    separated = re.sub(r"(?<=[^\W\d_])(?=[^\W\d_])(?<![A-ZÄÖÜ])(?=[A-ZÄÖÜ])", " ", name)
    return [word.lower() for word in re.split(r"[\W\d_]+", separated) if word]
