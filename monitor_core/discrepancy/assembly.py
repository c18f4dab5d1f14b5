"""Put the result of a search into an explanation: what the model lacks, what is left, what was not found, pictures."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.discrepancy.explanation import (
    Candidate,
    Described,
    Explanation,
    FoundEffect,
    Gap,
    GapPair,
    Misfit,
    MisfitMap,
    Outcome,
    Step,
    Unfinished,
    Untested,
    UntestedReason,
)
from monitor_core.discrepancy.localisation import (
    HealthyScatter,
    localise,
    misfit_map,
    signatures,
    varied_conditions_of_maps,
)
from monitor_core.discrepancy.screening import Screened
from monitor_core.discrepancy.search.workspace import Found, StoppableAxis, TimeIsUpError
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, found_parameters
from monitor_core.discrepancy.verdict.next_steps import next_steps
from monitor_core.discrepancy.verdict.outcome import Remainder, Wandering
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.effects.units import recorded_unit
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.settings import varied_conditions
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.hold_out import gain, gap_of
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.shown import Panel


@dataclass(frozen=True, slots=True, eq=False)
class Judged(Generic[Physics]):
    """What an answer comes to, before it is put into an explanation."""

    outcome: Outcome
    found: Found[Physics]
    final: Fitted[Physics]  # with what is described, too
    classes: tuple[EquivalenceClass[Physics], ...]
    remainder: Remainder
    wanders: Mapping[str, Wandering]  # by the key of the effect
    described: tuple[Described, ...]
    unfinished: Unfinished | None
    axis: StoppableAxis[Physics]


def explanation_of(
    judged: Judged[Physics], candidates: Sequence[Effect[Physics]], sizes: MachineSizes | None
) -> Explanation:
    """Return the explanation; ``sizes`` of the machine are those in which the next measurement is proposed."""
    found, final, classes, outcome = judged.found, judged.final, judged.classes, judged.outcome
    comparison, scale = final.comparison, found.evidence_scale
    scatter = HealthyScatter(scale.correlation, math.sqrt(max(scale.mean_square, 1.0)))
    return Explanation(
        outcome=outcome,
        effects=tuple(_found_effect(group, final, scale, judged) for group in classes),
        localisation=_misfits(found.baseline, candidates, scatter),
        remainder=_misfits(final, candidates, scatter) if outcome is not Outcome.NONE else (),
        gap=Gap(comparison.unit, comparison.noise_floor, _gap_pair(found.baseline), _gap_pair(final)),
        steps=_steps(found, classes),
        candidates=candidates_not_found(
            found, candidates, classes, axis=judged.axis, time_was_up=judged.unfinished is not None
        ),
        pulls={name: math.sqrt(value) for name, value in judged.remainder.pulls.items()} | _parameter_pulls(final),
        least_delta_bic=found.least_delta_bic,
        next_steps=next_steps(found, classes, outcome, candidates, sizes, described=judged.described),
        ln_ratios=_ln_ratios(final),
        added={key: values for key, values in _values(final).items() if not key.startswith(PREFIX)},
        panels=_panels(found),
        maps=_maps(found),
        gap_by_channel=_gap_by_channel(found),
        pulls_before=_parameter_pulls(found.baseline),
        unfinished=judged.unfinished,
        described=judged.described,
    )


def _ln_ratios(final: Fitted[Physics]) -> dict[str, float]:
    """Return ln(refitted/stated) of the parameters of the model file, those that are called wrong included."""
    wrong = {key.removeprefix(PREFIX): values for key, values in _values(final).items() if key.startswith(PREFIX)}
    return final.hypothesis.ln_ratios(final.coordinates) | {name: values["ln_ratio"] for name, values in wrong.items()}


def _values(final: Fitted[Physics]) -> dict[str, dict[str, float]]:
    return final.hypothesis.values(final.coordinates)


def _found_effect(
    group: EquivalenceClass[Physics], stated: Fitted[Physics], scale: EvidenceScale, judged: Judged[Physics]
) -> FoundEffect:
    """Return the representative of a class with its parameters, as the augmented model states it."""
    member = group.representative
    equal = [other.fitted for of_other in judged.classes if of_other is not group for other in of_other.members]
    parameters = found_parameters(member, stated, scale, equal)
    wandering, unit = judged.wanders.get(member.effect.key), None
    if "ln_factor" in parameters:
        estimate = parameters["ln_factor"].estimate
        unit = recorded_unit(member.effect.name, estimate.value, estimate.standard_uncertainty)
    return FoundEffect(
        key=member.effect.key,
        name=member.effect.name,
        physics=member.effect.physics,
        parameters=parameters,
        equivalent_to=group.others,
        delta_bic=member.delta_bic,
        held_out_log_likelihood_gain=group.held_out_gain,
        aliases=group.aliases,
        wanders_between=None if wandering is None else (wandering.lowest, wandering.highest),
        recorded_unit=unit,
    )


def _steps(found: Found[Physics], classes: Sequence[EquivalenceClass[Physics]]) -> tuple[Step, ...]:
    """Return what was added in each step, by the representatives of their classes, and what it left."""
    pairs = zip(found.accepted, classes, strict=True)
    named = {accepted.effect.key: group.representative.effect.key for accepted, group in pairs}
    steps = []
    for earlier, later in zip((found.baseline, *found.steps), found.steps, strict=False):
        added = [effect.key for effect in later.hypothesis.effects if effect.key not in earlier.hypothesis.keys]
        left = found.final if later is found.steps[-1] else later
        steps.append(Step(tuple(named.get(key, key) for key in added), _gap_pair(left)))
    return tuple(steps)


def _gap_pair(fitted: Fitted[Physics]) -> GapPair:
    """Return the gap of a fit on the values it saw and on those it did not."""
    return GapPair(fitted.gap, gap_of(fitted.comparison, fitted.held_out))


def _misfits(
    fitted: Fitted[Physics], candidates: Sequence[Effect[Physics]], scatter: HealthyScatter
) -> tuple[Misfit, ...]:
    present, physics = fitted.hypothesis.keys, fitted.physics()
    others = [effect for effect in candidates if effect.key not in present and effect.applies(physics)]
    return localise(fitted.comparison.layout, fitted.standardised, signatures(fitted, others), scatter)


def _panels(found: Found[Physics]) -> tuple[Panel, ...]:
    """Return pictures of both models, if they have an answer at the settings as stated and not only as fitted."""
    comparison, models = found.final.comparison, {}
    for name, fitted in (("before", found.baseline), ("after", found.final)):
        physics = fitted.physics()
        with suppress(OutsideValidityError):
            comparison.misfit(physics)
            models[name] = physics
    return comparison.panels(models)


def _maps(found: Found[Physics]) -> tuple[MisfitMap, ...]:
    layout = found.final.comparison.layout
    maps = []
    for over in varied_conditions_of_maps(layout) or (None,):
        rows, columns, before = misfit_map(layout, found.baseline.standardised, over)
        _, _, after = misfit_map(layout, found.final.standardised, over)
        maps.append(MisfitMap(over, rows, columns, before, after))
    return tuple(maps)


def _gap_by_channel(found: Found[Physics]) -> dict[str, tuple[float, float]]:
    comparison, both = found.final.comparison, (found.baseline, found.final)
    gaps = {}
    for channel, name in enumerate(comparison.layout.channels):
        chosen = found.final.fitted & (comparison.layout.channel == channel)
        if np.any(chosen):
            before, after = (comparison.gap(fitted.misfit, fitted.standardised, chosen) for fitted in both)
            gaps[name] = (before, after)
    return gaps


def _parameter_pulls(fitted: Fitted[Physics]) -> dict[str, float]:
    hypothesis = fitted.hypothesis
    pulls = fitted.coordinates[: hypothesis.n_uncertain].tolist()
    return dict(zip(hypothesis.uncertain, pulls, strict=True))


# --- what was not found


def candidates_not_found(
    found: Found[Physics],
    candidates: Sequence[Effect[Physics]],
    classes: Sequence[EquivalenceClass[Physics]],
    *,
    axis: StoppableAxis[Physics],
    time_was_up: bool = False,
) -> tuple[Candidate, ...]:
    """Return which of the candidates are in no class of an accepted effect, best supported first.

    Where ``time_was_up`` some of them were not screened for that. What rivals gain on held-out values takes fits of
    their own, which are left out once time is up.
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
        evidence, held_out, untested, replaced = math.nan, math.nan, None, None
        if effect.key in found.final.hypothesis.keys:  # no larger than every axis may have it
            answers[effect.key] = Candidate(effect.key, evidence, held_out, effect.ordinary, effect.parameters[0].unit)
            continue
        if effect.key in rivals:
            rival, without, replaced = rivals[effect.key]
            evidence = rival.delta_bic  # in the place of what was accepted
            with suppress(TimeIsUpError), axis.stoppable():
                held_out = gain(without.held_out, rival.fitted.held_out, found.evidence_scale)
        elif result is not None and limit is not None:
            scale = found.evidence_scale
            evidence = scale.factor * result.decrease - scale.penalty(len(effect.parameters))
        else:
            untested = _why_untested(effect, result, found, time_was_up=time_was_up)
            if untested is None:
                continue
        unit = effect.parameters[0].unit
        answers[effect.key] = Candidate(effect.key, evidence, held_out, limit, unit, untested, replaced)
    return tuple(sorted(answers.values(), key=_rank))


def _rank(candidate: Candidate) -> float:
    return -candidate.delta_bic if math.isfinite(candidate.delta_bic) else math.inf


def _why_untested(
    effect: Effect[Physics], result: Screened[Physics] | None, found: Found[Physics], *, time_was_up: bool
) -> Untested | None:
    """Return why nothing could be seen of an effect; None where the axis lacks what it acts on."""
    applies = effect.applies(found.final.physics())
    if time_was_up and result is None and applies:
        return Untested(UntestedReason.TIME_UP)
    missing = tuple(sorted(effect.needs - varied_conditions(found.final.comparison.layout)))
    if missing:
        return Untested(UntestedReason.NOT_VARIED, missing)
    if result is None:
        return Untested(UntestedReason.NO_ANSWER) if applies else None
    return Untested(UntestedReason.BELOW_NOISE if result.information > 0.0 else UntestedReason.WITHOUT_TRACE)


def _detection_limit(result: Screened[Physics] | None, found: Found[Physics]) -> float | None:
    """Return the value of the first parameter that would be seen; None if there is none within its range."""
    if result is None or result.information <= 0.0:
        return None
    scale, parameter = found.evidence_scale, result.effect.parameters[0]
    needed = found.least_delta_bic + scale.penalty(len(result.effect.parameters))
    limit = abs(parameter.scale) * math.sqrt(needed / (scale.factor * result.information))
    limit = max(limit, result.effect.ordinary, result.effect.least)
    return limit if limit <= max(abs(parameter.lower), abs(parameter.upper)) else None
