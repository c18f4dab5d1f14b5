"""Leave out effects that the evidence carries and that are no clean names all the same.

Evidence is a sum over thousands of values, in all of which the form of the model errs alike. A name also needs a size,
must help where nothing was fitted, and may not strain what is declared only to explain what a healthy axis leaves.
"""

from monitor_core.discrepancy.search.workspace import Workspace
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.evidence import evidence_scale, significance
from monitor_core.fitting.hold_out import gap_of, judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Standard deviations that the size of an effect must measure at least, and that a declared parameter may be pulled by.
_LEAST_SIZE, _STRAINED = 3.0, 3.5
#: A gap on held-out values that rises by this factor does not fall.
_RISES = 1.02


def cleaned(workspace: Workspace[Physics], fitted: Fitted[Physics]) -> Fitted[Physics]:
    """Return the fit without the effects that are no clean names."""
    for effect in fitted.hypothesis.effects:
        without = workspace.without(fitted, effect)
        if not is_clean(without, fitted, effect):
            return cleaned(workspace, without)
    return fitted


def is_clean(without: Fitted[Physics], fuller: Fitted[Physics], effect: Effect[Physics]) -> bool:
    """Return whether an effect has a size, does not widen the gap on held-out values, and strains nothing for little.

    Where something is missing without it, a strain is for the outcome to judge: something else may be missing beside.
    """
    if significance(fuller, effect, evidence_scale(fuller)) < _LEAST_SIZE:
        return False
    comparison = fuller.comparison
    before, after = gap_of(comparison, without.held_out), gap_of(comparison, fuller.held_out)
    if after > _RISES * before:  # never where nothing is held out
        return False
    return judged_gap(without).exceeds_healthy or strain(without, fuller) < _STRAINED


def strain(without: Fitted[Physics], fuller: Fitted[Physics]) -> float:
    """Return the largest pull of a declared parameter that is larger with what a fuller fit adds, in its tolerance."""
    names = without.hypothesis.uncertain
    before = dict(zip(names, without.coordinates[: len(names)].tolist(), strict=True))
    after = fuller.coordinates[: fuller.hypothesis.n_uncertain].tolist()
    pulls = zip(fuller.hypothesis.uncertain, after, strict=True)
    return max((abs(pull) for name, pull in pulls if abs(pull) > abs(before.get(name, 0.0))), default=0.0)
