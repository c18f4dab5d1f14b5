"""Ask whether effects that such data cannot show as themselves would do instead of what was found.

A nut that hardens is told from other causes by an excitation that varies; where that does not vary it is no candidate.
But its amplitude differs from setting to setting all the same, and something else, that goes with the position or the
preload, would get a name. What goes with a temperature or a payload that does not vary does the same in
all settings: there it is a wrong parameter, which has a name.
"""

from collections.abc import Iterator, Sequence

from monitor_core.discrepancy.screening.screen import screen
from monitor_core.discrepancy.screening.sizes import Screened
from monitor_core.discrepancy.search.found import Accepted, Unseen
from monitor_core.discrepancy.search.stepwise import prune
from monitor_core.discrepancy.search.workspace import Workspace, lowest_cost
from monitor_core.effects.effect import ConditionAxis, Physics
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.conditions.settings import varied_conditions
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, least_difference
from monitor_core.fitting.solver.hypothesis_fit import Fitted

_OF_AMPLITUDE = frozenset({ConditionAxis.LEVEL})


def unseen_in_place(
    workspace: Workspace[Physics],
    final: Fitted[Physics],
    accepted: Sequence[Accepted[Physics]],
    scale: EvidenceScale,
) -> tuple[Unseen, ...]:
    """Return what would do as well as effects that were found, or better: for each set of those, where it does best.

    Of natural frequencies alone nothing is returned: what only responses would show is another question.
    """
    if not has_lines(workspace.comparison.layout):
        return ()
    by_gain = sorted(_in_place(workspace, final, accepted, scale), key=lambda unseen: -unseen.delta_bic)
    best: dict[tuple[str, frozenset[str]], Unseen] = {}
    for unseen in by_gain:
        best.setdefault((unseen.key, unseen.instead_of), unseen)
    return tuple(best.values())


def _in_place(
    workspace: Workspace[Physics],
    final: Fitted[Physics],
    accepted: Sequence[Accepted[Physics]],
    scale: EvidenceScale,
) -> Iterator[Unseen]:
    settings, physics = workspace.settings, final.physics()
    missing = _OF_AMPLITUDE - varied_conditions(workspace.comparison.layout)
    effects = [each for each in workspace.candidates if each.needs & missing and each.applies(physics)]
    least, names = -least_difference(workspace.comparison), {each.effect.key for each in accepted}
    for step in accepted if effects else ():
        worth_it = settings.least_share_of_gain * (step.without.cost - final.cost)
        for screened in screen(step.without, effects):
            if screened.predicted_gain < max(worth_it, settings.least_predicted_gain):
                break
            workspace.progress(f"asking whether {screened.effect.key} would do in the place of {step.effect.key}")
            fitted = _fitted(workspace, step.without, screened)
            if fitted is None:
                continue
            alone = fitted = prune(workspace, fitted, fitted.hypothesis.effects[:-1])
            for effect in fitted.hypothesis.effects[:-1]:  # what was found beside it has evidence, and may be none
                alone = workspace.without(alone, effect) if effect.key in names else alone
            for tried in dict.fromkeys((fitted, alone)):
                more = delta_bic(final, tried, scale)
                if more > least:
                    yield Unseen(screened.effect.key, final.hypothesis.keys - tried.hypothesis.keys, more)


def _fitted(
    workspace: Workspace[Physics], without: Fitted[Physics], screened: Screened[Physics]
) -> Fitted[Physics] | None:
    hypothesis = without.hypothesis.with_effect(screened.effect)
    return lowest_cost(*(workspace.try_fit(hypothesis, start) for start in screened.starts))
