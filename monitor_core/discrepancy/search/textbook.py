"""Add physics that the family of a model leaves out, at its textbook values."""

from itertools import combinations

from monitor_core.discrepancy.search.workspace import Workspace
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.evidence import delta_bic, evidence_scale
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted

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
