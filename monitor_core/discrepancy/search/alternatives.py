"""Judge the effects of the final fit: the evidence for each, and the alternatives that would do in its place."""

from collections.abc import Collection, Iterator

from monitor_core.discrepancy.search.found import Accepted, Rival
from monitor_core.discrepancy.search.refits import rivals_at, substitute_effect
from monitor_core.discrepancy.search.stepwise import is_another, is_ordinary
from monitor_core.discrepancy.search.textbook import is_at_textbook_value
from monitor_core.discrepancy.search.workspace import Workspace, is_far, screening_misleads
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.evidence import EvidenceScale, delta_bic
from monitor_core.fitting.hold_out import gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted


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
