"""The discrepancy workflow from end to end: compare, find what is missing, judge, and put it into words and numbers."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from monitor_core.discrepancy.explanation import (
    Candidate,
    Explanation,
    FoundEffect,
    FoundParameter,
    Gap,
    Misfit,
    MisfitMap,
    Outcome,
    Step,
)
from monitor_core.discrepancy.localisation.places import (
    HealthyScatter,
    localise,
    misfit_map,
    varied_conditions_of_maps,
)
from monitor_core.discrepancy.localisation.signatures import signatures
from monitor_core.discrepancy.screening import Scanned
from monitor_core.discrepancy.search.search import Found, Search, SearchSettings
from monitor_core.discrepancy.verdict.advice import next_measurement
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, Member, equivalence_class, found_parameters
from monitor_core.discrepancy.verdict.outcome import (
    OutcomeSettings,
    explained_share,
    gap_pair,
    hidden_in_remainder,
    outcome_of,
    remainder_of,
)
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.settings import varied_conditions
from monitor_core.fitting.described_axis import DescribedAxis
from monitor_core.fitting.evidence import Yardstick
from monitor_core.fitting.hold_out import gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.fitting.solver.posterior_mode import at_mode

Physics = TypeVar("Physics")


@dataclass(frozen=True, slots=True)
class ExplainSettings:
    """When an effect is accepted, and when something is left."""

    search: SearchSettings = field(default_factory=SearchSettings)
    outcome: OutcomeSettings = field(default_factory=OutcomeSettings)


def explain(
    comparison: Comparison[Physics],
    subject: DescribedAxis[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    settings: ExplainSettings | None = None,
    progress: Callable[[str], None] | None = None,
) -> Explanation:
    """Find where measurements and a described axis part, what is missing, and how far it closes the gap.

    Parameters
    ----------
    comparison : Comparison
        The measurements.
    subject : DescribedAxis
        The described axis.
    candidates : sequence of Effect
        What it may lack.
    settings : ExplainSettings, optional
    progress : callable, optional
        Told in a few words what is being done.

    Raises
    ------
    OutsideValidityError
        If the described axis itself has no answer under one of the conditions.
    """
    settings = settings or ExplainSettings()
    tell = progress or (lambda _sentence: None)
    search = Search(comparison, subject, tuple(candidates), settings.search, tell)
    steps, hidden = search.run(), list[str]()
    while (least := hidden_in_remainder(steps[0], steps[-1], search.without, settings.outcome)) is not None:
        hidden.append(least.key)
        steps = search.leave_out(steps, least)
    tell("judging what was found")
    found = search.found(steps)
    classes, final = _classes(found, candidates)
    final = at_mode(final)
    found = replace(found, final=final)
    remainder = remainder_of(found.final)
    gap = Gap(comparison.unit, comparison.noise_floor, gap_pair(found.baseline), remainder.gap)
    explained = explained_share(found.baseline, found.final, remainder.misfit)
    left = remainder.is_left(settings.outcome)
    outcome = outcome_of(classes, remainder, explained=explained, settings=settings.outcome)
    told = {key for one in classes for key in (one.leader.effect.key, *one.others, *one.twins)}
    tell("locating the misfit")
    scatter = HealthyScatter(found.yardstick.correlation, math.sqrt(max(found.yardstick.scale, 1.0)))
    models = {"before": found.baseline.physics(), "after": found.final.physics()}
    values = final.hypothesis.values(final.coordinates)
    ratios = final.hypothesis.ln_ratios(final.coordinates) | {
        key.removeprefix(PREFIX): of_effect["ln_ratio"] for key, of_effect in values.items() if key.startswith(PREFIX)
    }
    return Explanation(
        outcome=outcome,
        effects=tuple(_found_effect(one, final, found.yardstick) for one in classes),
        localisation=_places(found.baseline, candidates, scatter),
        remainder=_places(found.final, candidates, scatter) if outcome is not Outcome.NONE else (),
        gap=gap,
        steps=_steps(found, classes),
        candidates=_candidates(found, candidates, classes),
        pulls={name: math.sqrt(value) for name, value in remainder.pulls.items()} | _parameter_pulls(found.final),
        least_delta_bic=found.least_delta_bic,
        next_measurement=next_measurement(found, classes, outcome, candidates),
        ln_ratios=ratios,
        added={key: of_effect for key, of_effect in values.items() if not key.startswith(PREFIX)},
        panels=comparison.panels(_with_answer(comparison, models)),
        maps=_maps(found),
        gap_by_channel=_gap_by_channel(found),
        pulls_before=_parameter_pulls(found.baseline),
        # one that would do in the place of another is told there
        hidden_in_remainder=tuple(key for key in hidden if key not in told and left),
    )


def _classes(
    found: Found[Physics], candidates: Sequence[Effect[Physics]]
) -> tuple[tuple[EquivalenceClass[Physics], ...], Fitted[Physics]]:
    """Return what was found, each effect with what would do in its place, and the fit with those that lead.

    The model is what the words say: what has no answer beside the others leads no class.
    """
    classes: list[EquivalenceClass[Physics]] = []
    final = found.final
    for one in found.accepted:
        leading = {other.leader.effect.key for other in classes}
        barred: set[str] = set()
        while True:
            of_one = equivalence_class(found, one, candidates, leading=leading, barred=barred)
            with_leader = _with_leader(final, one.effect, of_one.leader)
            if with_leader is not None:
                break
            barred.add(of_one.leader.effect.key)
        final = with_leader
        classes.append(of_one)
    return tuple(classes), final


def _with_leader(final: Fitted[Physics], accepted: Effect[Physics], leader: Member[Physics]) -> Fitted[Physics] | None:
    """Return a fit with the leader in the place of the effect that was accepted; None where it has no answer."""
    if leader.effect.key == accepted.key:
        return final
    hypothesis = final.hypothesis.without(accepted.key).with_effect(leader.effect)
    if {one.key for one in hypothesis.effects} == {one.key for one in leader.fitted.hypothesis.effects}:
        return leader.fitted
    start = hypothesis.carried_over(final.hypothesis, final.coordinates)
    own = hypothesis.carried_over(leader.fitted.hypothesis, leader.fitted.coordinates)
    n_own = len(leader.effect.parameters)
    start[start.size - n_own :] = own[own.size - n_own :]
    try:
        return fit(final.comparison, hypothesis, start, final.fitted)
    except OutsideValidityError:
        return None


def _with_answer(comparison: Comparison[Physics], models: Mapping[str, Physics]) -> dict[str, Physics]:
    """Return the models that have an answer at the settings as stated; some have one at the likely settings alone."""
    found = {}
    for name, physics in models.items():
        with suppress(OutsideValidityError):
            comparison.misfit(physics)
            found[name] = physics
    return found


def _steps(found: Found[Physics], classes: Sequence[EquivalenceClass[Physics]]) -> tuple[Step, ...]:
    """Return what was added one after the other, by the keys that lead their classes, and what it left."""
    leaders = {one.effect.key: of.leader.effect.key for one, of in zip(found.accepted, classes, strict=True)}
    steps = []
    for earlier, later in zip((found.baseline, *found.steps), found.steps, strict=False):
        known = {effect.key for effect in earlier.hypothesis.effects}
        added = [effect.key for effect in later.hypothesis.effects if effect.key not in known]
        left = found.final if later is found.steps[-1] else later
        steps.append(Step(" + ".join(leaders.get(key, key) for key in added), gap_pair(left)))
    return tuple(steps)


def _found_effect(one: EquivalenceClass[Physics], stated: Fitted[Physics], by: Yardstick) -> FoundEffect:
    leader = one.leader
    parameters = found_parameters(leader, stated, by)
    remarks = [f"the same finding as {key}" for key in one.twins]
    remarks += [
        f"a stand-in for something else: {name} = {_value(item)} is beyond its plausible range"
        for name, item in parameters.items()
        if not item.plausible
    ]
    remarks += [
        f"{name} = {_value(item)} stands at an end of the range that it is sought in"
        for name, item in parameters.items()
        if item.at_end
    ]
    return FoundEffect(
        key=leader.effect.key,
        name=leader.effect.name,
        physics=leader.effect.physics,
        parameters=parameters,
        equivalent_to=one.others,
        delta_bic=leader.delta_bic,
        held_out_log_likelihood_gain=one.held_out_gain,
        remarks=tuple(remarks),
    )


def _value(found: FoundParameter) -> str:
    return f"{found.estimate.value:.3g}" + ("" if found.unit == "-" else f" {found.unit}")


def _places(
    fitted: Fitted[Physics], candidates: Sequence[Effect[Physics]], scatter: HealthyScatter
) -> tuple[Misfit, ...]:
    present = {effect.key for effect in fitted.hypothesis.effects}
    physics = fitted.physics()
    others = [one for one in candidates if one.key not in present and one.applies(physics)]
    return localise(fitted.comparison.layout, fitted.standardised, signatures(fitted, others), scatter)


def _maps(found: Found[Physics]) -> tuple[MisfitMap, ...]:
    layout = found.final.comparison.layout
    maps = []
    for over in varied_conditions_of_maps(layout) or (None,):
        rows, columns, before = misfit_map(layout, found.baseline.standardised, over)
        _, _, after = misfit_map(layout, found.final.standardised, over)
        title = "Misfit in standard deviations" + ("" if over is None else f" over {over}")
        maps.append(MisfitMap(title, rows, columns, before, after))
    return tuple(maps)


def _gap_by_channel(found: Found[Physics]) -> dict[str, tuple[float, float]]:
    comparison, both = found.final.comparison, (found.baseline, found.final)
    gaps = {}
    for channel, name in enumerate(comparison.layout.channels):
        chosen = found.final.fitted & (comparison.layout.channel == channel)
        if np.any(chosen):
            before, after = (comparison.gap(one.misfit, one.standardised, chosen) for one in both)
            gaps[name] = (before, after)
    return gaps


def _parameter_pulls(fitted: Fitted[Physics]) -> dict[str, float]:
    hypothesis = fitted.hypothesis
    pulls = fitted.coordinates[: hypothesis.n_uncertain].tolist()
    return dict(zip(hypothesis.uncertain, pulls, strict=True))


def _candidates(
    found: Found[Physics], candidates: Sequence[Effect[Physics]], classes: Sequence[EquivalenceClass[Physics]]
) -> tuple[Candidate, ...]:
    """Return what was not found: refitted rivals, mere looks with what they could have seen, and the untestable."""
    told = {key for one in classes for key in (one.leader.effect.key, *one.twins, *one.untested)}
    rivals = {
        rival.effect.key: (rival, one.without, of_one.leader.effect.key)
        for one, of_one in zip(found.accepted, classes, strict=True)
        for rival in one.rivals
    }
    looks = {look.effect.key: look for look in found.looks}
    answers: dict[str, Candidate] = {}
    for effect in candidates:
        if effect.key in told or effect.key in answers:
            continue
        look = looks.get(effect.key)
        limit = _detection_limit(look, found)
        evidence, held, untestable, place = math.nan, math.nan, None, None
        if effect.key in rivals:
            rival, without, place = rivals[effect.key]
            evidence = rival.delta_bic  # in the place of what was accepted
            held = gain(without.held_out, rival.fitted.held_out, found.yardstick)
        elif look is not None and limit is not None:
            evidence = found.yardstick.factor * look.decrease - found.yardstick.penalty(len(effect.parameters))
        else:
            untestable = _why_untestable(effect, look, found)
            if untestable is None:
                continue
        unit = effect.parameters[0].unit
        answers[effect.key] = Candidate(effect.key, evidence, held, limit, unit, untestable, place)
    return tuple(sorted(answers.values(), key=lambda one: -one.delta_bic if math.isfinite(one.delta_bic) else math.inf))


def _why_untestable(effect: Effect[Physics], look: Scanned[Physics] | None, found: Found[Physics]) -> str | None:
    """Say why nothing could be seen of an effect; None where the axis lacks what it acts on."""
    missing = sorted(str(axis) for axis in effect.needs - varied_conditions(found.final.comparison.layout))
    if missing:
        return f"{', '.join(missing)} does not vary"
    if look is None:
        return "the model has no answer with it" if effect.applies(found.final.physics()) else None
    return (
        "no value within its range would be seen"
        if look.information > 0.0
        else "nothing that was measured moves with it"
    )


def _detection_limit(look: Scanned[Physics] | None, found: Found[Physics]) -> float | None:
    if look is None or look.information <= 0.0:
        return None
    by = found.yardstick
    needed = found.least_delta_bic + by.penalty(len(look.effect.parameters))
    one = look.effect.parameters[0]
    limit = abs(one.scale) * math.sqrt(needed / (by.factor * look.information))
    return limit if limit <= max(abs(one.lower), abs(one.upper)) else None
