"""Put the records of an explanation into sentences, by the keys that files and programs use or by names for people."""

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from monitor_core.discrepancy import (
    AMPLITUDE_LAW,
    TIME_LAW,
    AgainstScrew,
    DescribedAlternative,
    Dimension,
    Explanation,
    Extent,
    FoundEffect,
    FoundParameter,
    MisfitPlace,
    NextStep,
    Unfinished,
    Untested,
    UntestedReason,
)
from monitor_core.effects import DRIVE_EFFECTS, MOTION_EFFECTS, PREFIX, ConditionAxis


@dataclass(frozen=True, slots=True)
class Wording:
    """How sentences call effects, parameters and parts of the data."""

    effect: Callable[[str], str]  # of its key
    parameter: Callable[[str], str]  # of its name in files
    extent: Callable[[Extent], str]
    longest_list: int | None  # of effects that cannot be seen; of a longer one the rest is counted


@cache
def texts(table: str) -> Mapping[str, str]:
    """Return a table of the file of texts that lies beside this module."""
    tables: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return tables[table]


# --- names for people

#: Ends of names in files that say a unit, longer ones first; the value beside the name has it.
_UNITS: Final = (
    "_nms_per_rad", "_nm_per_rad", "_ns_per_m", "_n_per_m", "_m_per_n", "_n_per_k", "_kg_per_m3", "_kg_m2", "_per_m2",
    "_per_kg", "_per_k", "_kg", "_nm", "_mm", "_hz", "_s2", "_pa", "_n", "_m", "_s", "_c",
)  # fmt: skip
#: What names in files are built of, where the words of a sentence are others.
_PLAIN: Final = {"ln_ratio": "size", "youngs": "Young's", "nut_stiffness": "nut rigidity"}


@cache
def _names() -> dict[str, str]:
    return {
        **{effect.key: effect.name for effect in MOTION_EFFECTS},
        **{effect.key: effect.name for effect in DRIVE_EFFECTS},
        AMPLITUDE_LAW: "Something that goes with the excitation by a law of its own",
        TIME_LAW: "Something that changes from one measurement to the next",
    }


def name_of(key: str) -> str:
    """Return the name of an effect by its key; a user's own, of which there is no name, by its key."""
    if key.startswith(PREFIX):
        words = parameter_words(key.removeprefix(PREFIX))
        return f"{words[:1].upper()}{words[1:]} other than stated"
    return _names().get(key, key)


def quoted_name(key: str) -> str:
    """Return the name of an effect as it stands inside a sentence."""
    return f"“{name_of(key)}”" if key in _names() or key.startswith(PREFIX) else key


def parameter_words(name: str) -> str:
    """Return what a parameter is called, without its unit: ``table_mass_kg`` is the table mass."""
    if name in _PLAIN:
        return _PLAIN[name]
    words = next((name.removesuffix(unit) for unit in _UNITS if name.endswith(unit)), name)
    return " ".join(_PLAIN.get(word, word) for word in _PLAIN.get(words, words).split("_"))


# --- places


#: Of each dimension its key and what follows the levels, what people read before and after them, and how many of what
#: is shown one is in SI.
_DIMENSIONS: Final = {
    Dimension.POSITION: ("position_mm ", "", "", " mm", 1e3),
    Dimension.PRELOAD: ("preload_n ", "", "", " N", 1.0),
    Dimension.PAYLOAD: ("payload_kg ", "", "", " kg payload", 1.0),
    Dimension.TEMPERATURE: ("temperature_delta_c ", "", "", " K warmer", 1.0),
    Dimension.LEVEL: ("excitation level ", "", "excitation level ", "", 1.0),
    Dimension.DIRECTION: ("direction ", "", "direction ", "", 1.0),
    Dimension.RECORD: ("record ", "", "record ", "", 1.0),
    Dimension.BAND: ("band ", " Hz", "", " Hz", 1.0),
    Dimension.MODE: ("mode ", " Hz", "mode ", " Hz", 1.0),
    Dimension.CHANNEL: ("channel ", "", "channel ", "", 1.0),
    Dimension.SETTINGS: ("", "", "", "", 1.0),
}
_WITHOUT_ORDER: Final = frozenset({Dimension.DIRECTION, Dimension.RECORD, Dimension.CHANNEL})


def extent_by_key(extent: Extent) -> str:
    """Return a part of the data as programs know it: "position_mm 500..850"."""
    key, unit, *_ = _DIMENSIONS[extent.dimension]
    names = [f'"{name}"' for name in extent.names] if extent.dimension is Dimension.CHANNEL else extent.names
    to = " to " if extent.dimension is Dimension.SETTINGS else ".."
    return f"{key}{_levels(extent, names, to)}{unit}"


def extent_in_words(extent: Extent) -> str:
    """Return a part of the data as people know it: "500 to 850 mm"."""
    _, _, before, behind, _ = _DIMENSIONS[extent.dimension]
    return f"{before}{_levels(extent, extent.names, ' to ')}{behind}"


def row_label(extent: Extent) -> str:
    """Return a part of the data as it stands beside a row of a picture, where there is little room."""
    if extent.dimension is Dimension.LEVEL:
        return f"level {_levels(extent, (), ' to ')}"
    return extent_in_words(extent)


def _levels(extent: Extent, names: Sequence[str], to: str) -> str:
    """Return both ends of a range, or one by one what has no order."""
    levels = [*(_level(extent.dimension, number) for number in extent.numbers), *names]
    if extent.dimension in _WITHOUT_ORDER:
        return " and ".join(levels)
    return levels[0] if levels[0] == levels[-1] else f"{levels[0]}{to}{levels[-1]}"


def _level(dimension: Dimension, number: float) -> str:
    if dimension is Dimension.DIRECTION and number:
        return "+" if number > 0.0 else "−"
    return plain(_DIMENSIONS[dimension][-1] * number, 4)


def place_sentence(place: MisfitPlace, wording: Wording) -> str:
    """Return where a misfit is."""
    if place.extents:
        return ", ".join(map(wording.extent, place.extents))
    return "everywhere" + (f", changing with {' and '.join(place.changing_with)}" if place.changing_with else "")


def map_title(over: ConditionAxis | None) -> str:
    """Return the title of a map of the misfit over a condition, or over none."""
    return "Misfit in standard deviations" + ("" if over is None else f" over {over}")


#: How files and programs call what people call by names.
KEYS: Final = Wording(str, str, extent_by_key, None)
NAMES: Final = Wording(quoted_name, parameter_words, extent_in_words, 3)


# --- what goes with an effect, and with what was not tested


def remarks(effect: FoundEffect, wording: Wording) -> Iterator[str]:
    """Yield what goes with a found effect: the same finding under other keys, and why it may stand in for another."""
    for key in effect.aliases:
        yield f"the same finding as {wording.effect(key)}"
    for name, parameter in effect.parameters.items():
        if not parameter.plausible:
            value = f"{wording.parameter(name)} = {_value(parameter)}"
            yield f"a stand-in for something else: {value} is beyond its plausible range"
    for name, parameter in effect.parameters.items():
        if parameter.at_end:
            yield f"{wording.parameter(name)} = {_value(parameter)} is at an end of the range that is searched"
    if effect.wanders_between is not None:
        lowest, highest = effect.wanders_between
        yield (
            f"a stand-in for something whose frequency wanders: it would be {lowest:.4g} Hz at one setting and "
            f"{highest:.4g} Hz at another"
        )
    if (unit := effect.recorded_unit) is not None:
        units = f", as by {' or '.join(unit.units)}" if unit.units else "; a unit, or a scale (volts, amperes)?"
        yield f"{unit.quantity} not in {unit.stated}: what is recorded is {unit.factor:.3g} times what is stated{units}"


def _value(parameter: FoundParameter) -> str:
    return _with_unit(parameter.estimate.value, parameter.unit)


def _with_unit(value: float, unit: str) -> str:
    return f"{value:.3g}" + ("" if unit == "-" else f" {unit}")


def untested_sentence(untested: Untested) -> str:
    """Return why an effect could not be tested."""
    if untested.reason is UntestedReason.NOT_VARIED:
        return f"{', '.join(untested.not_varied)} does not vary"
    return texts("untested")[untested.reason]


def unfinished_sentence(unfinished: Unfinished, wording: Wording) -> str:
    """Return what a search was doing when its time was up, and what it had not tried."""
    listed = ", ".join(map(wording.effect, unfinished.untried))
    untried = f"no fit had tried {listed}" if listed else "every effect had been looked at"
    return (
        f"Time was up while {unfinished.doing}: {untried}, and what else would do in the place of what was found was "
        "not looked for to the end; give it more time to be sure of the answer."
    )


def assumption_sentences(explanation: Explanation) -> Iterator[str]:
    """Yield what was assumed before anything was compared, and which parameters were not free."""
    yield from explanation.assumptions
    if explanation.taken_as_exact:
        listed = ", ".join(explanation.taken_as_exact)
        yield f"Taken as exact, since [uncertain] does not list it: {listed}."


def alternative_sentence(alternative: DescribedAlternative, wording: Wording) -> str:
    """Return what the data do not distinguish from what was described."""
    if not alternative.parameter:
        return f"something that swings at the {alternative.place}"
    varying = "" if alternative.varies_with is None else f", {alternative.varies_with}"
    return f"{wording.parameter(alternative.parameter)} at the {alternative.place}{varying}"


def against_screw_sentence(against: AgainstScrew) -> str:
    """Say what speaks against a ball screw axis, and what a screw would do."""
    shown = dict[str, str]()
    for name, value in against.values.items():
        if name.endswith("_m"):
            shown[name.removesuffix("_m")] = plain(1e3 * value, 4)
        else:
            percent = f"{100.0 * value:+.1f} %".replace("-", "−").replace("−0.0", "0.0")
            shown[name] = plain(value, 4) if name.endswith("_hz") else percent
    words = texts("against_screw")[against.objection].format(**shown)
    return f"This does not behave as a ball screw axis: {words}."


# --- what to do next


def next_measurement(steps: Sequence[NextStep], wording: Wording = KEYS) -> str:
    """Return all steps in one sentence; empty where nothing is open."""
    return "; ".join(step_sentence(step, wording) for step in steps)


def step_sentence(step: NextStep, wording: Wording) -> str:
    """Return what to measure or to check next, without a capital and a full stop."""
    return texts("next_step")[step.kind].format(**_fields(step, wording))


def plain(value: float, digits: int = 3) -> str:
    """Return a number with so many digits and without a power of ten, where one can read it so."""
    return f"{float(f'{value:.{digits}g}'):g}"


class _Number(float):
    """A number that a text shows with three digits, or with as many as it says."""

    def __format__(self, digits: str) -> str:
        return plain(float(self), int(digits or 3))


def _fields(step: NextStep, wording: Wording) -> dict[str, object]:
    """Return what a text may name: what the step is about, its values, its effects and what is expected."""
    named, *others = [wording.effect(effect.key) for effect in step.effects] or [""]
    unit, per_unit = _SHOWN_IN.get(step.condition, ("", 1.0))
    values = {name: _Number(value) for name, value in step.values.items()}
    values |= {f"{name}m": _Number(1e3 * value) for name, value in step.values.items() if name.endswith("_m")}
    phrases = {name: _filled(text, values) for name, text in texts("phrase").items()}
    return {
        "channel": step.quantity,
        "tag": _tag(step.quantity),
        "parameter": wording.parameter(step.quantity),
        "place": step.place,
        "settings": step.settings,
        "effect": named,
        "others": " or ".join(others),
        "all_others": " and ".join(others),
        "unseen": _listed([named, *others], wording.longest_list),
        "sizes": " or ".join(
            f"{wording.effect(effect.key)} of {_with_unit(effect.amount, effect.unit)}" for effect in step.effects
        ),
        "distances": " and from ".join(
            f"{other} by {effect.amount:.0f}" for other, effect in zip(others, step.effects[1:], strict=True)
        ),
        "levels": [_Number(per_unit * level) for level, _ in step.expected],
        "factors": [_percent(factor) for _, factor in step.expected],
        "unit": unit,
        "at": f"{step.settings[0]} at an excitation level of" if step.settings else "at",
        "what": "measure whole frequency responses" if step.condition is _RESPONSES else f"vary the {step.condition}",
        **phrases,
        "change": texts("change").get(step.condition or "", "").format(**phrases),
        "three_levels": " to a third and to three times of what it is" if step.condition is ConditionAxis.LEVEL else "",
        **values,
    }


def _filled(text: str, values: Mapping[str, float]) -> str:
    try:
        return text.format(**values)
    except KeyError:
        return ""


def _listed(names: Sequence[str], most: int | None) -> str:
    if most is None or len(names) <= most + 1:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def _tag(error: str) -> str:
    """Return what an error of settings is called: "gain 2" is that of a channel."""
    return f"gain (channel {error.removeprefix('gain ')})" if error.startswith("gain") else error


def _percent(factor: float) -> str:
    return f"{plain(100.0 * factor)} %" if math.isfinite(factor) else "hardly any"


_RESPONSES: Final = ConditionAxis.FREQUENCY
#: Units of what a law may follow, and how many of those one SI unit is; of a level N or N·m, by what excites.
_SHOWN_IN: Final[Mapping[ConditionAxis | None, tuple[str, float]]] = {
    ConditionAxis.POSITION: (" mm", 1e3),
    ConditionAxis.PRELOAD: (" N", 1.0),
    ConditionAxis.PAYLOAD: (" kg", 1.0),
    ConditionAxis.TEMPERATURE: (" K", 1.0),
}
