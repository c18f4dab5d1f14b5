"""Tell where an answer says two things that cannot both be true.

Each rule is about what stands in the answer itself; none needs the data.
"""

from collections.abc import Iterator

from monitor_core.discrepancy.explanation import Explanation, FoundEffect, Outcome
from monitor_core.discrepancy.verdict.outcome import PULLS
from monitor_core.fitting.hold_out import REMAINDER

#: A gap on held-out values that is so many times as large has not fallen.
_NOT_FALLEN = 1.02


def contradictions(answer: Explanation) -> tuple[str, ...]:
    """Return what an answer contradicts itself in, in sentences; empty where nothing does."""
    return (*_of_outcome(answer), *_of_gap(answer), *_of_names(answer))


def _of_outcome(answer: Explanation) -> Iterator[str]:
    outcome, effects = answer.outcome, answer.effects
    if outcome is Outcome.NONE and effects:
        yield f"nothing is missing, and {_keys(effects)} is"
    if outcome in (Outcome.NAMED, Outcome.EQUIVALENT, Outcome.PARTIAL) and not effects:
        yield f"{outcome}, and no effect is"
    alike = any(effect.equivalent_to for effect in effects)
    if (outcome is Outcome.NAMED and alike) or (outcome is Outcome.EQUIVALENT and not alike):
        yield f"{outcome}, and {'something' if alike else 'nothing'} would do in the place of what was found"
    if outcome in (Outcome.UNKNOWN, Outcome.PARTIAL) and not _has_reason(answer):
        yield f"{outcome}, and nothing is left under a floor of {answer.gap.noise_floor:g} {answer.gap.unit}"


def _has_reason(answer: Explanation) -> bool:
    """Return whether anything speaks against the answer that nothing is left."""
    gap = answer.gap.after
    over = max(gap.fit, 0.0 if gap.held_out != gap.held_out else gap.held_out) > answer.gap.noise_floor
    pulled = any(abs(pull) > PULLS**0.5 for pull in answer.pulls.values())
    stand_in = any(not effect.plausible for effect in answer.effects)
    return over or pulled or stand_in or bool(answer.unfinished)


def _of_gap(answer: Explanation) -> Iterator[str]:
    before, after = answer.gap.before.held_out, answer.gap.after.held_out
    believed = answer.outcome in (Outcome.NAMED, Outcome.EQUIVALENT, Outcome.PARTIAL)
    if believed and after > _NOT_FALLEN * before:
        yield f"{_keys(answer.effects)} explains a gap that does not fall, from {before:.3g} to {after:.3g}"
    most = REMAINDER * answer.gap.noise_floor
    if believed and answer.outcome is not Outcome.PARTIAL and answer.gap.after.fit > 2.0 * most:
        yield f"everything is explained, and {answer.gap.after.fit:.3g} {answer.gap.unit} of it is left"


def _of_names(answer: Explanation) -> Iterator[str]:
    keys = [effect.key for effect in answer.effects]
    for key in dict.fromkeys(keys):
        if keys.count(key) > 1:
            yield f"{key} is found, and found again"
        if any(candidate.key == key for candidate in answer.candidates):
            yield f"{key} is found, and is among what was not"
    for effect in answer.effects:
        sizes = [*effect.parameters.values()][:1] if len(effect.parameters) == 1 else []
        if any(low < 0.0 < high for low, high in (size.interval_95 for size in sizes)):
            yield f"{effect.key} is found, and its size may be 0"


def _keys(effects: tuple[FoundEffect, ...]) -> str:
    return " and ".join(effect.key for effect in effects)
