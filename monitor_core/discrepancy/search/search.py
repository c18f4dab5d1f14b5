"""Search for what a model lacks: textbook physics first, then one effect after the other.

1. Physics that the family leaves out is tried at its textbook values, in every combination.
2. Every effect is screened, the most promising are refitted (``refits``), and the best that the evidence carries is
   accepted; after each step what is no longer needed is left out again.
3. What is no clean name is left out: evidence is a sum over thousands of values, in all of which the form of the model
   errs alike. A name also needs a size, must help where nothing was fitted, and may not strain what is declared only to
   explain what a healthy axis leaves.
4. Effects that the data cannot distinguish from an accepted effect are kept with it.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

from monitor_core.discrepancy.search.refits import rivals_at, substitute_effect
from monitor_core.discrepancy.search.workspace import (
    PULLS_OF_TOLERANCES,
    Accepted,
    Found,
    Rival,
    StoppableAxis,
    TimeIsUpError,
    Workspace,
    are_pulled,
    better_minimum,
    is_far,
    may_lack_more,
    screening_misleads,
    variances_of_pulls,
)
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale, least_difference, significance
from monitor_core.fitting.hold_out import expected_gain, gain, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted


def find_steps(workspace: Workspace[Physics], baseline: Fitted[Physics] | None = None) -> tuple[Fitted[Physics], ...]:
    """Return the fits of the search: without any effect, the ``baseline`` if it is known already, and after each step.

    Raises OutsideValidityError if the axis itself has no answer.
    """
    hypothesis = Hypothesis(workspace.axis)
    # with the axis of the workspace, which may be asked to stop
    known = None if baseline is None else replace(baseline, hypothesis=hypothesis)
    baseline = known or workspace.fit(hypothesis, hypothesis.null)
    workspace.reach(baseline)
    first = add_textbook_physics(workspace, baseline)
    taken = [first] if first is not baseline else []
    steps = add_stepwise(workspace, first, taken, most_effects=len(first.hypothesis.effects) + 1)
    workspace.remember(baseline)
    has_another = len(steps) > len(taken)
    if not (has_another and workspace.is_explained_otherwise(workspace.baseline, steps[-1])):
        steps = add_stepwise(workspace, steps[-1], steps) if has_another else steps
        # the best without an effect is in no false minimum, as far as an effect has led out of it
        first = first if first.hypothesis.effects else workspace.baseline
        steps = _other_first_steps(workspace, first, steps)
    current = steps[-1] if steps else workspace.baseline
    return _ended(workspace, current, steps)


def find_again(workspace: Workspace[Physics], found: Found[Physics]) -> tuple[Fitted[Physics], ...]:
    """Return the fits of a search of other records, made anew: without any effect, and after each step.

    What is needed no more is left out, and others are sought beside it. Nothing is returned where one of the fits has
    no answer.
    """
    steps, plain, first = list[Fitted[Physics]](), Hypothesis(workspace.axis), found.baseline
    again = [(replace(step.hypothesis, axis=workspace.axis), step.coordinates) for step in (first, *found.steps)]
    if first.hypothesis.effects:  # of what is ordinary, where nothing was found
        again.insert(0, (plain, plain.carried_over(first.hypothesis, first.coordinates)))
    for hypothesis, start in again:
        fitted = workspace.try_fit(hypothesis, start)
        if fitted is None:
            return ()
        workspace.remember(fitted)
        workspace.reach(*steps, fitted)
        steps.append(fitted)
    further = steps[1:]
    if not (further and workspace.is_explained_otherwise(workspace.baseline, further[-1])):
        further = add_stepwise(workspace, steps[-1], further)
    return _ended(workspace, further[-1] if further else steps[0], further)


def _ended(
    workspace: Workspace[Physics], current: Fitted[Physics], steps: Sequence[Fitted[Physics]]
) -> tuple[Fitted[Physics], ...]:
    """Return the fits of a search that has come to a fit by steps: without what is not needed, or is no clean name."""
    final = cleaned(workspace, prune(workspace, current, current.hypothesis.effects))
    return _leading_to(final, [workspace.baseline, *steps[:-1]] if final.hypothesis.effects else [])


def judge_found(
    workspace: Workspace[Physics], steps: Sequence[Fitted[Physics]], *, alternatives: bool = True
) -> Found[Physics]:
    """Judge what a search has found: the evidence for each effect, and ``alternatives`` that would do in its place."""
    final = steps[-1]
    scale = evidence_scale(final)
    accepted = tuple(
        judge_effect(workspace, final, effect, scale, alternatives=alternatives) for effect in findings(final)
    )
    return Found(
        baseline=workspace.baseline if accepted else final,
        steps=tuple(steps[1:]),
        final=final,
        accepted=accepted,
        evidence_scale=scale,
        screened=workspace.screened(final),
        least_delta_bic=workspace.least_evidence(final),
    )


def judge_so_far(workspace: Workspace[Physics], axis: StoppableAxis[Physics]) -> Found[Physics]:
    """Judge where a search stands that was left: without fits of its own, and without what else would do.

    What an effect gains on held-out values is not a number where that is not known yet.
    """
    baseline, final = workspace.so_far[0], workspace.so_far[-1]
    scale, known = evidence_scale(final), (*workspace.so_far, *workspace.best_fits.values())
    accepted = []
    for effect in findings(final):
        others = [fitted for fitted in known if fitted.hypothesis.keys <= final.hypothesis.keys - {effect.key}]
        without = min(others, key=lambda fitted: fitted.cost)
        held_out_gain = math.nan
        with suppress(TimeIsUpError), axis.stoppable():
            held_out_gain = gain(without.held_out, final.held_out, scale)
        accepted.append(Accepted(effect, delta_bic(without, final, scale), held_out_gain, (), without))
    return Found(
        baseline=baseline,
        steps=tuple(workspace.so_far[1:]),
        final=final,
        accepted=tuple(accepted),
        evidence_scale=scale,
        screened=workspace.known_screening(final),
        least_delta_bic=workspace.least_evidence(final),
    )


def _other_first_steps(
    workspace: Workspace[Physics], first: Fitted[Physics], steps: list[Fitted[Physics]]
) -> list[Fitted[Physics]]:
    """Return the steps, or those from another first effect that end at a better fit, where something is left."""
    current, settings = steps[-1] if steps else first, workspace.settings
    rivals = rivals_at(workspace, first) if may_lack_more(current) else ()
    for rival in rivals[1 : settings.n_first_steps]:
        least = settings.least_share_of_gain * rivals[0].delta_bic
        if rival.delta_bic < max(least, workspace.least_evidence(first, rival.effect)):
            break
        if not holds(workspace, first, rival.fitted, evidence_scale(rival.fitted)):
            continue
        other = add_stepwise(workspace, rival.fitted, [rival.fitted])
        if delta_bic(current, other[-1], evidence_scale(other[-1])) > least_difference(workspace.comparison):
            steps, current = other, other[-1]
    return steps


def _leading_to(final: Fitted[Physics], earlier: Sequence[Fitted[Physics]]) -> tuple[Fitted[Physics], ...]:
    """Return fits with the final fit at their end, which replaces a fit of the same effects."""
    return (*(fitted for fitted in earlier if fitted.hypothesis.keys != final.hypothesis.keys), final)


_TEXTBOOK = 0.2  # of the scale of a parameter: a value so near its textbook value is that


def add_textbook_physics(workspace: Workspace[Physics], baseline: Fitted[Physics]) -> Fitted[Physics]:
    """Return the fit with those effects, at their textbook values, that together help most.

    Every combination is tried: where several strong effects are missing at once a single one may make things worse, and
    a greedy search would go astray.
    """
    physics = baseline.physics()
    known = [effect for effect in workspace.candidates if effect.textbook is not None and effect.applies(physics)]
    best = baseline
    for size in range(1, len(known) + 1):
        for effects in combinations(known, size):
            hypothesis = Hypothesis(workspace.axis, effects)
            trial = workspace.try_fit(hypothesis, hypothesis.at_textbook_values(baseline.coordinates))
            least = workspace.comparison.least_delta_bic
            if trial is not None and delta_bic(best, trial, evidence_scale(trial)) > least:
                best = trial
    # a single effect that helps may be a stand-in; an effect that is needed is found again by the stepwise search
    return best if len(best.hypothesis.effects) != 1 else baseline


def is_at_textbook_value(fitted: Fitted[Physics], effect: Effect[Physics]) -> bool:
    """Return whether a fit has an effect at its textbook values."""
    values = fitted.hypothesis.values(fitted.coordinates)[effect.key]
    return effect.textbook is not None and all(
        abs(values[parameter.name] - effect.textbook[parameter.name]) < _TEXTBOOK * abs(parameter.scale)
        for parameter in effect.parameters
    )


#: Effects after the first that must bring a fit near to the data.
_FAR_STEPS = 2


def add_stepwise(
    workspace: Workspace[Physics],
    start: Fitted[Physics],
    steps: Sequence[Fitted[Physics]],
    most_effects: int | None = None,
) -> list[Fitted[Physics]]:
    """Return the steps with those of adding one effect after the other, as long as the evidence carries them."""
    current, taken = start, list(steps)
    most = workspace.settings.most_effects if most_effects is None else most_effects
    baseline = workspace.so_far[:1]
    workspace.remember(current)
    while len(current.hypothesis.effects) < most and not _leads_nowhere(start, current):
        workspace.progress(f"{_effects(current)} found, screening {len(workspace.remaining(current))} more")
        better = _best_addition(workspace, current)
        if better is None:
            break
        again = _refitted_without(workspace, current, better)
        if delta_bic(again, better, evidence_scale(better)) < workspace.least_evidence(
            again, better.hypothesis.effects[-1]
        ):
            current = again  # the effect had only led out of a false minimum
            taken[-1:] = [again] if taken else []
            continue
        before = current.hypothesis.keys
        current = prune(workspace, better, better.hypothesis.effects[:-1])
        if current.hypothesis.keys <= before:
            break
        workspace.remember(current)
        taken.append(current)
        workspace.reach(*baseline, *taken)
    return taken


def _leads_nowhere(start: Fitted[Physics], current: Fitted[Physics]) -> bool:
    """Return whether the catalogue does not have what is missing: two more effects are still far from responses."""
    lines = has_lines(current.comparison.layout)
    return lines and len(current.hypothesis.keys - start.hypothesis.keys) >= _FAR_STEPS and is_far(current)


def _effects(fitted: Fitted[Physics]) -> str:
    n_effects = len(fitted.hypothesis.effects)
    return f"{n_effects} effect" if n_effects == 1 else f"{n_effects} effects"


def prune(
    workspace: Workspace[Physics], fitted: Fitted[Physics], effects: Sequence[Effect[Physics]]
) -> Fitted[Physics]:
    """Return the fit without those of some effects that are not needed."""
    for effect in effects:
        without = workspace.without(fitted, effect)
        evidence = delta_bic(without, fitted, evidence_scale(fitted))
        if evidence < workspace.least_evidence(without, effect) or is_another(fitted, effect):
            return prune(workspace, without, [kept for kept in effects if kept.key != effect.key])
    return fitted


def is_ordinary(fitted: Fitted[Physics], effect: Effect[Physics]) -> bool:
    """Return whether an effect is found no larger than every axis may have it.

    It stays in the model, and is no finding: without it another effect would be found in its place.
    """
    return _size(fitted, effect) < effect.ordinary


def is_another(fitted: Fitted[Physics], effect: Effect[Physics]) -> bool:
    """Return whether an effect is found so small that it is another effect, and is left to that."""
    return _size(fitted, effect) < effect.least


def _size(fitted: Fitted[Physics], effect: Effect[Physics]) -> float:
    return abs(fitted.hypothesis.values(fitted.coordinates)[effect.key][effect.parameters[0].name])


def findings(fitted: Fitted[Physics]) -> tuple[Effect[Physics], ...]:
    """Return the effects of a fit that are findings: those that not every axis may have so."""
    return tuple(effect for effect in fitted.hypothesis.effects if not is_ordinary(fitted, effect))


def holds(
    workspace: Workspace[Physics], without: Fitted[Physics], fuller: Fitted[Physics], scale: EvidenceScale
) -> bool:
    """Return whether an effect that helps where it was fitted helps where it was not."""
    before, after = without.held_out, fuller.held_out
    if before is None or after is None:
        return True
    expected = expected_gain(before, after, scale)
    forgiven = workspace.settings.forgiven_share * 0.5 * max(delta_bic(without, fuller, scale), 0.0)
    least = workspace.settings.least_held_out_share * expected - 2.0 * math.sqrt(2.0 * expected)
    return gain(before, after, scale) > least - forgiven


def _best_addition(workspace: Workspace[Physics], current: Fitted[Physics]) -> Fitted[Physics] | None:
    """Return the fit with the best further effect; None if the evidence carries none."""
    for rival in rivals_at(workspace, current):
        scale = evidence_scale(rival.fitted)
        if delta_bic(current, rival.fitted, scale) < workspace.least_evidence(current, rival.effect):
            continue  # less is asked of a parameter that is pulled beyond belief, though another explains more
        another = is_another(rival.fitted, rival.fitted.hypothesis.effects[-1])
        if not another and holds(workspace, current, rival.fitted, scale):
            return rival.fitted
    return None


def _refitted_without(
    workspace: Workspace[Physics], current: Fitted[Physics], fuller: Fitted[Physics]
) -> Fitted[Physics]:
    """Return the better fit without the last effect: the current fit, or a refit from where the effect led.

    Any effect may show the way out of a false minimum. That is no evidence for it.
    """
    again = workspace.without(fuller, fuller.hypothesis.effects[-1])
    return better_minimum(current, again)


#: Standard deviations that the size of an effect must measure at least, and that a declared parameter may be pulled by.
LEAST_SIZE, _STRAINED = 3.0, 3.5
#: Tolerances: what pulls a declared parameter by no more than that beyond where it was has not strained it.
_FURTHER = 1.0


def cleaned(workspace: Workspace[Physics], fitted: Fitted[Physics]) -> Fitted[Physics]:
    """Return the fit without the effects that are no clean names."""
    for effect in findings(fitted):
        without = workspace.without(fitted, effect)
        if not is_clean(without, fitted, effect):
            return cleaned(workspace, without)
    return fitted


def is_clean(without: Fitted[Physics], fuller: Fitted[Physics], effect: Effect[Physics]) -> bool:
    """Return whether an effect has a size, and strains nothing for little.

    Where something is missing without it, a strain is for the outcome to judge: something else may be missing beside.
    """
    # natural frequencies show that of an added mode, and hardly how large the mode is
    has_only_frequency = effect.frequency is not None and not has_lines(fuller.comparison.layout)
    if not has_only_frequency and significance(fuller, effect, evidence_scale(fuller)) < LEAST_SIZE:
        return False
    return _is_something_missing(without) or strain(without, fuller) < _STRAINED


def _is_something_missing(fitted: Fitted[Physics]) -> bool:
    """Return whether a fit leaves more than a healthy axis: in its gap, or in what its settings are pulled by."""
    return are_pulled(variances_of_pulls(fitted), PULLS_OF_TOLERANCES) or judged_gap(fitted).exceeds_healthy


def strain(without: Fitted[Physics], fuller: Fitted[Physics]) -> float:
    """Return the largest pull of a declared parameter that what a fuller fit adds pulls further, in its tolerance.

    By a whole one at least: a parameter that was as far off before is not strained for it.
    """
    names = without.hypothesis.uncertain
    before = dict(zip(names, without.coordinates[: len(names)].tolist(), strict=True))
    after = fuller.coordinates[: fuller.hypothesis.n_uncertain].tolist()
    pulls = zip(fuller.hypothesis.uncertain, after, strict=True)
    return max((abs(pull) for name, pull in pulls if abs(pull) > abs(before.get(name, 0.0)) + _FURTHER), default=0.0)


def judge_effect(
    workspace: Workspace[Physics],
    final: Fitted[Physics],
    effect: Effect[Physics],
    scale: EvidenceScale,
    *,
    alternatives: bool = True,
) -> Accepted[Physics]:
    """Return the evidence for an effect of the final fit, and its ``alternatives`` where they are asked for.

    Physics without which the model is far from the data, and that is found at its textbook value, has no rival.
    """
    without = workspace.without(final, effect)
    refitted: list[tuple[Effect[Physics], Fitted[Physics]]] = []
    if alternatives and not (is_at_textbook_value(final, effect) and is_far(without)):
        refitted = [(rival.effect, rival.fitted) for rival in rivals_at(workspace, without)]
        if screening_misleads(without):
            refitted += _substitutions(workspace, final, effect, {other.key for other, _ in refitted})
    rivals = sorted(
        (
            Rival(other, trial, delta_bic(without, trial, scale))
            for other, trial in refitted
            if other.key != effect.key and not (is_ordinary(trial, other) or is_another(trial, other))
        ),
        key=lambda rival: rival.delta_bic,
        reverse=True,
    )
    held_out_gain = gain(without.held_out, final.held_out, scale)
    return Accepted(effect, delta_bic(without, final, scale), held_out_gain, tuple(rivals), without)


def _substitutions(
    workspace: Workspace[Physics], final: Fitted[Physics], effect: Effect[Physics], known: Collection[str]
) -> Iterator[tuple[Effect[Physics], Fitted[Physics]]]:
    """Yield further effects that may do in the place of an effect, refitted from where the data are near.

    An effect with little predicted gain far from the data was not refitted there.
    """
    workspace.progress(f"looking for alternatives to {effect.key}")
    for other in workspace.remaining(final):
        if other.key in known:
            continue
        rise, start = substitute_effect(final, effect, other)
        if rise < workspace.settings.most_rise:
            hypothesis = final.hypothesis.without(effect.key).with_effect(other)
            trial = workspace.try_fit(hypothesis, start)
            if trial is not None:
                yield other, trial
