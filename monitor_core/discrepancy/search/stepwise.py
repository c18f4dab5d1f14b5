"""Add one effect after the other while the evidence carries it, and leave out again what is no longer needed."""

import math
from collections.abc import Sequence

from monitor_core.discrepancy.search.refits import refit_resonances, rivals_at
from monitor_core.discrepancy.search.workspace import Workspace, better_minimum, is_far
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale
from monitor_core.fitting.hold_out import expected_gain, gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted

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
        if delta_bic(again, better, evidence_scale(better)) < workspace.least_evidence(again):
            current = again  # the effect had only led out of a false minimum
            taken[-1:] = [again] if taken else []
            continue
        before, better = current.hypothesis.keys, refit_resonances(workspace, better)
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
        if evidence < workspace.least_evidence(without) or is_another(fitted, effect):
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
    least = workspace.least_evidence(current)
    for rival in rivals_at(workspace, current):
        scale = evidence_scale(rival.fitted)
        if delta_bic(current, rival.fitted, scale) < least:
            return None
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
