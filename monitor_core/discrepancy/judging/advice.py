"""What to measure next: what would part effects that look alike, and what would show those that nothing shows yet."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from monitor_core.discrepancy.comparing.conditions import varied_conditions
from monitor_core.discrepancy.effect import ConditionAxis, Effect
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.discrepancy.judging.classes import EquivalenceClass
from monitor_core.discrepancy.searching.fit import Fitted
from monitor_core.discrepancy.searching.search import Found

Physics = TypeVar("Physics")

#: With fewer positions many effects differ by a level alone.
_ENOUGH_POSITIONS = 5
#: What parts two effects by less is not worth a measurement. [standard deviations]
_WORTH_MEASURING = 3.0


def next_measurement(
    found: Found[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    outcome: Outcome,
    candidates: Sequence[Effect[Physics]],
) -> str:
    """Return in a few words what to vary next; empty where nothing is open.

    Parameters
    ----------
    found : Found
    classes : sequence of EquivalenceClass
        One for each effect that was accepted.
    outcome : Outcome
    candidates : sequence of Effect
        Everything the axis may lack.
    """
    advice = [
        _to_part(one.leader.fitted, other.fitted, one.leader.effect.key, other.effect.key)
        for one in classes
        for other in one.members[1:2]
    ]
    if outcome is not Outcome.NAMED:
        advice += _to_see_more(found, candidates)
    return "; ".join(advice)


def separations(one: Fitted[Physics], other: Fitted[Physics]) -> dict[str, float]:
    """Return by how much two fits would differ if all settings were measured again under other conditions.

    In standard deviations, by what a sentence calls the change.
    """
    first, second = one.physics(), other.physics()
    found = {}
    for words, imagined in one.comparison.imagined().items():
        difference = one.comparison.layout.difference(imagined.misfit(first), imagined.misfit(second))
        found[words] = float(np.linalg.norm(one.around.whitened_by(difference)))
    return found


def _to_part(one: Fitted[Physics], other: Fitted[Physics], key: str, other_key: str) -> str:
    apart = separations(one, other)
    best = max(apart, key=lambda words: apart[words], default=None)
    if best is None or apart[best] < _WORTH_MEASURING:
        return f"nothing that could be varied parts {key} from {other_key}"
    return (
        f"measure all settings {best}: {key} and {other_key} would then differ by {apart[best]:.0f} standard deviations"
    )


def _to_see_more(found: Found[Physics], candidates: Sequence[Effect[Physics]]) -> Iterator[str]:
    layout = found.final.comparison.layout
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
        for axis in effect.needs - varied:
            waiting.setdefault(axis, []).append(effect.key)
    for axis, keys in waiting.items():
        if axis is ConditionAxis.FREQUENCY:
            yield f"measure whole frequency responses, without which {', '.join(dict.fromkeys(keys))} cannot be seen"
        elif axis is not ConditionAxis.PAYLOAD:
            yield f"vary the {axis}, without which {', '.join(dict.fromkeys(keys))} cannot be seen"
