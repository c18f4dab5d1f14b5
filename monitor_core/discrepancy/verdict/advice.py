"""Advise what to measure next: what would distinguish effects that look alike, and show those not seen yet."""

from collections.abc import Iterator, Sequence

import numpy as np

from monitor_core.discrepancy.explanation import Outcome
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.verdict.classes import EquivalenceClass
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.settings import is_testable, varied_conditions
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: With fewer positions many effects differ by a level alone.
_ENOUGH_POSITIONS = 5
#: A measurement that separates two effects by less is not worth it. [standard deviations]
_WORTH_MEASURING = 3.0


def next_measurement(
    found: Found[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    outcome: Outcome,
    candidates: Sequence[Effect[Physics]],
) -> str:
    """Return in a few words what to vary next; empty where nothing is open."""
    advice = [words for found_class in classes for words in _to_distinguish(found_class)]
    if outcome is not Outcome.NAMED:
        reported = {key for found_class in classes for key in found_class.keys}
        unseen = [effect for effect in candidates if effect.key not in reported]
        advice += _to_see_more(found.final.comparison.layout, unseen)
    return "; ".join(advice)


def separations(fitted: Fitted[Physics], other: Fitted[Physics]) -> dict[str, float]:
    """Return by how much two fits would differ if all settings were measured again under other conditions.

    In standard deviations, by what a sentence calls the change; without those under which one of them has no answer.
    """
    first, second = fitted.physics(), other.physics()
    found = {}
    for words, imagined in fitted.comparison.imagined().items():
        try:
            there = imagined.misfit(first), imagined.misfit(second)
        except OutsideValidityError:
            continue
        found[words] = float(np.linalg.norm(fitted.around.whitened_by(fitted.comparison.layout.difference(*there))))
    return found


def _to_distinguish(found_class: EquivalenceClass[Physics]) -> Iterator[str]:
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
    never = [other for other, found in apart.items() if max(found.values(), default=0.0) < _WORTH_MEASURING]
    if never:
        yield f"no change of conditions distinguishes {key} from {' or '.join(never)}"
    if found_class.untested:
        yield f"measure whole frequency responses, which distinguish {key} from {' and '.join(found_class.untested)}"


def _to_see_more(layout: Layout, candidates: Sequence[Effect[Physics]]) -> Iterator[str]:
    """Yield what has to vary for the other candidates to be seen."""
    varied = varied_conditions(layout)
    stated = {axis for setting in layout.settings for axis in setting.values}
    positions = {
        setting.values[ConditionAxis.POSITION] for setting in layout.settings if ConditionAxis.POSITION in stated
    }
    if positions and len(positions) < _ENOUGH_POSITIONS:
        yield f"measure at {_ENOUGH_POSITIONS} positions or more"
    if ConditionAxis.PAYLOAD in stated - varied:
        yield "measure with and without a known added mass"
    waiting: dict[ConditionAxis, list[str]] = {}
    for effect in candidates:
        for axis in () if is_testable(effect, layout) else sorted(effect.needs - varied):
            waiting.setdefault(axis, []).append(effect.key)
    for axis, keys in waiting.items():
        if axis is ConditionAxis.FREQUENCY:
            yield f"measure whole frequency responses, without which {', '.join(dict.fromkeys(keys))} cannot be seen"
        elif axis is not ConditionAxis.PAYLOAD:
            yield f"vary the {axis}, without which {', '.join(dict.fromkeys(keys))} cannot be seen"
