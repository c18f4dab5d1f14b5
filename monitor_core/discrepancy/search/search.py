"""Search for what a model lacks: textbook physics first, then one effect after the other.

1. Physics that the family leaves out is tried at its textbook values, in every combination (``textbook``).
2. Every effect is screened, the most promising are refitted (``refits``), and the best that the evidence carries is
   accepted; after each step what is no longer needed is left out again (``stepwise``).
3. Effects that the data cannot distinguish from an accepted effect are kept with it (``alternatives``).
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from monitor_core.discrepancy.search.alternatives import judge_effect
from monitor_core.discrepancy.search.clean import cleaned
from monitor_core.discrepancy.search.found import Accepted, Found
from monitor_core.discrepancy.search.refits import rivals_at
from monitor_core.discrepancy.search.stepwise import add_stepwise, findings, holds, prune
from monitor_core.discrepancy.search.textbook import add_textbook_physics
from monitor_core.discrepancy.search.time_limit import StoppableAxis, TimeIsUpError
from monitor_core.discrepancy.search.unseen import unseen_in_place
from monitor_core.discrepancy.search.workspace import Workspace, may_lack_more
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.evidence import delta_bic, evidence_scale, least_difference
from monitor_core.fitting.hold_out import gain
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
    current = steps[-1] if steps else first if first.hypothesis.effects else workspace.baseline
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


def leave_out(
    workspace: Workspace[Physics], steps: Sequence[Fitted[Physics]], effect: Effect[Physics]
) -> tuple[Fitted[Physics], ...]:
    """Return the fits of a search that ends without one of its effects."""
    final = workspace.without(steps[-1], effect)
    return _leading_to(final, [step for step in steps if step.hypothesis.keys < final.hypothesis.keys])


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
        unseen=unseen_in_place(workspace, final, accepted, scale) if alternatives else (),
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
        if rival.delta_bic < max(least, workspace.least_evidence(first)):
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
