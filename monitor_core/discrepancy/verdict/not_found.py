"""Report the effects that were not found: refitted rivals, screened effects with detection limits, untestable ones."""

import math
from collections.abc import Sequence

from monitor_core.discrepancy.explanation import Candidate
from monitor_core.discrepancy.screening.sizes import Screened
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.verdict.classes import EquivalenceClass
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.conditions.settings import varied_conditions
from monitor_core.fitting.hold_out import gain


def candidates_not_found(
    found: Found[Physics],
    candidates: Sequence[Effect[Physics]],
    classes: Sequence[EquivalenceClass[Physics]],
    *,
    not_tried: str | None = None,
) -> tuple[Candidate, ...]:
    """Return which of the candidates are in no class of an accepted effect, best supported first.

    ``not_tried`` says why some of them may not have been screened.
    """
    reported = {key for group in classes for key in (group.representative.effect.key, *group.aliases, *group.untested)}
    rivals = {
        rival.effect.key: (rival, accepted.without, group.representative.effect.key)
        for accepted, group in zip(found.accepted, classes, strict=True)
        for rival in accepted.rivals
    }
    screened = {result.effect.key: result for result in found.screened}
    answers: dict[str, Candidate] = {}
    for effect in candidates:
        if effect.key in reported or effect.key in answers:
            continue
        result = screened.get(effect.key)
        limit = _detection_limit(result, found)
        evidence, held_out, untestable, replaced = math.nan, math.nan, None, None
        if effect.key in found.final.hypothesis.keys:  # no larger than every axis may have it
            answers[effect.key] = Candidate(effect.key, evidence, held_out, effect.ordinary, effect.parameters[0].unit)
            continue
        if effect.key in rivals:
            rival, without, replaced = rivals[effect.key]
            evidence = rival.delta_bic  # in the place of what was accepted
            held_out = gain(without.held_out, rival.fitted.held_out, found.evidence_scale)
        elif result is not None and limit is not None:
            scale = found.evidence_scale
            evidence = scale.factor * result.decrease - scale.penalty(len(effect.parameters))
        else:
            untestable = _why_untestable(effect, result, found)
            if not_tried and result is None and effect.applies(found.final.physics()):
                untestable = not_tried
            if untestable is None:
                continue
        unit = effect.parameters[0].unit
        answers[effect.key] = Candidate(effect.key, evidence, held_out, limit, unit, untestable, replaced)
    return tuple(sorted(answers.values(), key=_rank))


def _rank(candidate: Candidate) -> float:
    return -candidate.delta_bic if math.isfinite(candidate.delta_bic) else math.inf


def _why_untestable(effect: Effect[Physics], result: Screened[Physics] | None, found: Found[Physics]) -> str | None:
    """Say why nothing could be seen of an effect; None where the axis lacks what it acts on."""
    missing = sorted(str(axis) for axis in effect.needs - varied_conditions(found.final.comparison.layout))
    if missing:
        return f"{', '.join(missing)} does not vary"
    if result is None:
        return "the model has no answer with it" if effect.applies(found.final.physics()) else None
    if result.information > 0.0:
        return "no value within its range would be seen"
    return "nothing that was measured moves with it"


def _detection_limit(result: Screened[Physics] | None, found: Found[Physics]) -> float | None:
    """Return the value of the first parameter that would be seen; None if there is none within its range."""
    if result is None or result.information <= 0.0:
        return None
    scale, parameter = found.evidence_scale, result.effect.parameters[0]
    needed = found.least_delta_bic + scale.penalty(len(result.effect.parameters))
    limit = abs(parameter.scale) * math.sqrt(needed / (scale.factor * result.information))
    limit = max(limit, result.effect.ordinary, result.effect.least)
    return limit if limit <= max(abs(parameter.lower), abs(parameter.upper)) else None
