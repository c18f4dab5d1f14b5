"""Say what to measure or check next, in the sizes of the machine: its screw, its moving mass, its preload, its band.

What would distinguish effects that look alike, show those that were not seen yet, and tell what it is that nothing
explains.
"""

from collections.abc import Iterator, Sequence, Set

import numpy as np

from monitor_core.discrepancy.explanation import Described, Outcome
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.verdict.amplitude import AMPLITUDE_LAW
from monitor_core.discrepancy.verdict.classes import TIME_LAW, EquivalenceClass, Member
from monitor_core.discrepancy.verdict.what_is_described import checks_of_described
from monitor_core.discrepancy.verdict.what_is_left import checks_of_what_is_left, plain
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.conditions.settings import WARMER, is_testable, known_mass, varied_conditions
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: With fewer positions many effects differ by a level alone.
_ENOUGH_POSITIONS = 5
#: A measurement that separates two effects by less is not worth it. [standard deviations]
_WORTH_MEASURING = 3.0
#: Of the first natural frequency: the band in which a drive shows its masses, its joints and one more mode. [-]
_BAND_OF_RESPONSES = (0.1, 5.0)


def next_measurement(
    found: Found[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    outcome: Outcome,
    candidates: Sequence[Effect[Physics]],
    sizes: MachineSizes | None = None,
    *,
    described: Sequence[Described] = (),
) -> str:
    """Return in a few words what to vary or check next; empty where nothing is open.

    Of an outcome that leaves something open, *unknown*, *partial*, *equivalent* or *described*, it never is. The
    ``sizes`` of the machine give it masses, lengths, preloads and bands; without them it names those of the settings.
    """
    layout = found.final.comparison.layout
    advice = [words for found_class in classes for words in _to_distinguish(found_class, sizes)]
    advice += [words for found_there in described for words in checks_of_described(found_there, layout)]
    if outcome in (Outcome.UNKNOWN, Outcome.PARTIAL):
        advice += checks_of_what_is_left(found.final, sizes)
    if outcome is not Outcome.NAMED:
        lines = has_lines(layout)  # of natural frequencies it is said above what distinguishes what is not tested
        untested = {key for found_class in classes for key in found_class.untested if lines}
        reported = {key for found_class in classes for key in found_class.keys} - untested
        unseen = [effect for effect in candidates if effect.key not in reported]
        of_level = any(AMPLITUDE_LAW in found_class.other_laws for found_class in classes)
        said = {ConditionAxis.LEVEL} if of_level else set()
        advice += _to_see_more(layout, unseen, sizes, said)
    return "; ".join(advice)


def separations(fitted: Fitted[Physics], other: Fitted[Physics]) -> dict[str, float]:
    """Return by how much two fits would differ if all settings were measured again under other conditions.

    In standard deviations, by what a sentence calls the change; without those under which one of them has no answer.
    """
    first, second = fitted.physics(), other.physics()
    found = {}
    for words, imagined in fitted.comparison.imagined(first).items():
        try:
            there = imagined.misfit(first), imagined.misfit(second)
        except OutsideValidityError:
            continue
        found[words] = float(np.linalg.norm(fitted.around.whitened_by(fitted.comparison.layout.difference(*there))))
    return found


def _to_distinguish(found_class: EquivalenceClass[Physics], sizes: MachineSizes | None) -> Iterator[str]:
    """Yield the change that distinguishes most members from the representative, and the members that none does."""
    first, *others = found_class.members
    key = first.effect.key
    apart = {other.effect.key: separations(first.fitted, other.fitted) for other in others}
    changes = dict.fromkeys(words for of_other in apart.values() for words in of_other)

    def separated_by(words: str) -> dict[str, float]:
        return {other: found[words] for other, found in apart.items() if found.get(words, 0.0) >= _WORTH_MEASURING}

    best = max(changes, key=lambda words: (len(separated_by(words)), sum(separated_by(words).values())), default="")
    separated = separated_by(best) if best else {}
    if separated:
        listed = " and from ".join(f"{other} by {distance:.0f}" for other, distance in separated.items())
        yield f"measure all settings {best}: {key} would then differ from {listed} standard deviations"
    never = [
        other for other in others if max(apart[other.effect.key].values(), default=0.0) < _WORTH_MEASURING
    ]  # fmt: skip
    if never:
        yield (
            f"no change of conditions distinguishes {key} from {' or '.join(other.effect.key for other in never)}: "
            f"look at the parts themselves, {' or '.join(map(_size_of, (first, *never)))}, or change one of them on "
            f"purpose and measure {first.fitted.comparison.layout.settings[0].name} again"
        )
    if found_class.untested and not has_lines(first.fitted.comparison.layout):
        yield (
            f"measure whole frequency responses{_band(sizes)}, which distinguish {key} from "
            f"{' and '.join(found_class.untested)}"
        )
    if TIME_LAW in found_class.other_laws:
        yield (
            "measure the first settings once more at the end, and all of them in random order, which distinguishes "
            f"{key} from what changes with time"
        )
    if AMPLITUDE_LAW in found_class.other_laws:
        yield (
            "measure some of the settings at a third of the usual excitation and at three times as much, which "
            f"distinguishes {key} from what goes with the excitation by another law"
        )


def _size_of(member: Member[Physics]) -> str:
    """Return what a member would be, by its first parameter."""
    effect, parameter = member.effect, member.effect.parameters[0]
    value = member.fitted.hypothesis.values(member.fitted.coordinates)[effect.key][parameter.name]
    return f"{effect.key} of {value:.3g}" + ("" if parameter.unit == "-" else f" {parameter.unit}")


def _to_see_more(
    layout: Layout, candidates: Sequence[Effect[Physics]], sizes: MachineSizes | None, said: Set[ConditionAxis]
) -> Iterator[str]:
    """Yield what has to vary for the other candidates to be seen, but for what was said already."""
    varied = varied_conditions(layout)
    stated = {axis for setting in layout.settings for axis in setting.values}
    positions = {
        setting.values[ConditionAxis.POSITION] for setting in layout.settings if ConditionAxis.POSITION in stated
    }
    if positions and len(positions) < _ENOUGH_POSITIONS:
        yield f"measure at {_ENOUGH_POSITIONS} positions or more{_along_the_screw(sizes)}"
    if ConditionAxis.PAYLOAD in stated - varied:
        mass = size_of(sizes, Reference.MOVING_MASS)
        yield "measure with and without a known added mass" + ("" if mass is None else f" of {known_mass(mass):g} kg")
    waiting: dict[ConditionAxis, list[str]] = {}
    for effect in candidates:
        for axis in () if is_testable(effect, layout) else sorted(effect.needs - varied - said):
            waiting.setdefault(axis, []).append(effect.key)
    for axis, keys in waiting.items():
        unseen = f"without which {', '.join(dict.fromkeys(keys))} cannot be seen"
        if axis is ConditionAxis.FREQUENCY:
            yield f"measure whole frequency responses{_band(sizes)}, {unseen}"
        elif axis is not ConditionAxis.PAYLOAD:
            yield f"vary the {axis}{_by_how_much(axis, sizes)}, {unseen}"


def size_of(sizes: MachineSizes | None, reference: Reference) -> float | None:
    """Return a size of the machine, None where it is not known."""
    return None if sizes is None else sizes.values.get(reference)


def _by_how_much(axis: ConditionAxis, sizes: MachineSizes | None) -> str:
    preload, speed = size_of(sizes, Reference.PRELOAD), size_of(sizes, Reference.VELOCITY)
    if axis is ConditionAxis.TEMPERATURE:
        return f" by {WARMER:g} K"
    if axis is ConditionAxis.LEVEL:
        return " to a third and to three times of what it is"
    if axis is ConditionAxis.PRELOAD and preload is not None:
        return f" from {plain(0.5 * preload, 2)} to {plain(preload, 2)} N"
    if axis is ConditionAxis.RECORD and speed is not None:
        return f" with a second motion at {plain(0.5 * speed, 2)} m/s"
    return ""


def _along_the_screw(sizes: MachineSizes | None) -> str:
    length = size_of(sizes, Reference.LENGTH)
    return "" if length is None else f" along the {plain(1e3 * length)} mm of the screw"


def _band(sizes: MachineSizes | None) -> str:
    frequency = size_of(sizes, Reference.FREQUENCY)
    if frequency is None:
        return ""
    lowest, highest = (plain(share * frequency, 2) for share in _BAND_OF_RESPONSES)
    return f" from {lowest} to {highest} Hz"
