"""Say in plain words what files and programs call by keys: effects, parameters, places, ratios."""

import math
import re
from functools import cache
from typing import Final

from monitor_core.discrepancy import AMPLITUDE_LAW, TIME_LAW
from monitor_core.effects import DRIVE_EFFECTS, MOTION_EFFECTS, PREFIX
from service.report.rounding import rounded, with_uncertainty

_TIMES: Final = 1.5  # from this ratio on people say "times"
#: Ends of names in files that say a unit; the value beside the name has it.
_UNIT: Final = re.compile(
    r"_(n_per_m|nm_per_rad|ns_per_m|nms_per_rad|m_per_n|n_per_k|per_k|per_kg|per_m2|kg_m2|kg_per_m3|kg|nm|n|mm|m|hz|s2|s|"
    r"pa|c)$"
)
#: What names in files are built of, where the words of a sentence are others.
_PLAIN: Final = {"ln_ratio": "size", "youngs": "Young's", "nut_stiffness": "nut rigidity", "lead": "lead"}
#: What places and maps are named by, and the unit after the number.
_PLACES: Final = (
    ("position_mm", "mm"),
    ("preload_n", "N"),
    ("payload_kg", "kg payload"),
    ("temperature_delta_c", "K warmer"),
)
_LEVELS: Final = r"(-?[\d.e+]+(?:\.\.-?[\d.e+]+)?)"
_MOST_NAMED: Final = 3
#: A key has a dash; a single word is its own plain word.
_KEY: Final = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)+(?::[a-z0-9_]+)?", re.ASCII)


@cache
def _names() -> dict[str, str]:
    names = {effect.key: effect.name for effect in MOTION_EFFECTS}
    names |= {effect.key: effect.name for effect in DRIVE_EFFECTS}
    return names | {
        AMPLITUDE_LAW: "Something that goes with the excitation by a law of its own",
        TIME_LAW: "Something that changes from one measurement to the next",
    }


def name_of(key: str) -> str:
    """Return the name of an effect by its key; a user's own, of which there is no name, by its key."""
    if key.startswith(PREFIX):
        words = parameter_words(key.removeprefix(PREFIX))
        return f"{words[:1].upper()}{words[1:]} other than stated"
    return _names().get(key, key)


def in_plain_words(sentence: str) -> str:
    """Return a sentence with names in place of the keys of effects; what is no such key stays."""
    return _KEY.sub(lambda found: _inside_a_sentence(found[0]), sentence)


def with_short_lists(sentence: str) -> str:
    """Return a sentence of the next measurement that names three of the effects which cannot be seen, and how many."""
    found = re.search(r"without which (.*) cannot be seen", sentence)
    keys = found[1].split(", ") if found else []
    if found is None or len(keys) <= _MOST_NAMED + 1:
        return sentence
    few = f"{', '.join(keys[:_MOST_NAMED])} and {len(keys) - _MOST_NAMED} more"
    return sentence.replace(found[1], few)


def _inside_a_sentence(key: str) -> str:
    if key not in _names() and not key.startswith(PREFIX):
        return key
    return f"“{name_of(key)}”"


def parameter_words(name: str) -> str:
    """Return what a parameter is called, without its unit: ``table_mass_kg`` is the table mass."""
    if name in _PLAIN:
        return _PLAIN[name]
    words = _UNIT.sub("", name)
    return " ".join(_PLAIN.get(word, word) for word in _PLAIN.get(words, words).split("_"))


def place_words(where: str) -> str:
    """Return a place of misfit: ``position_mm 500..850, band 150..200 Hz`` is 500 to 850 mm, 150 to 200 Hz."""
    said = where
    for name, unit in _PLACES:
        said = re.sub(rf"\b{name} {_LEVELS}", rf"\1 {unit}", said)
    said = re.sub(r"\bband (?=[\d.])", "", said)
    return re.sub(r"(?<=\d)\.\.(?=-?[\d.])", " to ", said).replace('"', "")


def ratio_words(ln_ratio: float) -> str:
    """Say a ratio to what is stated, known by its logarithm: "13 % more", "3.0 times as much"."""
    ratio = math.exp(ln_ratio)
    if 1.0 / _TIMES < ratio < _TIMES:
        return f"{rounded(abs(100.0 * (ratio - 1.0)), 2)} % {'more' if ln_ratio >= 0.0 else 'less'}"
    return f"{rounded(ratio, 2)} times as much"


def compared_with_stated(ln_ratio: float) -> str:
    """Say a ratio in a sentence: "13 % more than stated", "3.0 times what is stated"."""
    words = ratio_words(ln_ratio)
    return words.replace("times as much", "times what is stated") if "times" in words else f"{words} than stated"


def ratio_with_uncertainty(ln_ratio: float, uncertainty: float) -> str:
    """Say a ratio with its standard uncertainty: "(12.70 ± 0.40) % more"; large ones as times."""
    ratio = math.exp(ln_ratio)
    spread = ratio * uncertainty
    if not math.isfinite(spread):
        return f"{ratio_words(ln_ratio)} (uncertainty not known)"
    if 1.0 / _TIMES < ratio < _TIMES:
        change = abs(100.0 * (ratio - 1.0))
        return f"({with_uncertainty(change, 100.0 * spread)}) % {'more' if ln_ratio >= 0.0 else 'less'}"
    return f"({with_uncertainty(ratio, spread)}) times as much"


def ratio_interval(low: float, high: float) -> str:
    """Say both ends of an interval of a ratio, known by their logarithms."""
    return f"{ratio_words(low)} to {ratio_words(high)}"
