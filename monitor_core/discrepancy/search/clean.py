"""Leave out effects that the evidence carries and that are no clean names all the same.

Evidence is a sum over thousands of values, in all of which the form of the model errs alike. A name also needs a size,
must help where nothing was fitted, and may not strain what is declared only to explain what a healthy axis leaves.
"""

from monitor_core.discrepancy.search.stepwise import findings
from monitor_core.discrepancy.search.workspace import PULLS_OF_TOLERANCES, Workspace, are_pulled, variances_of_pulls
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import delta_bic, evidence_scale, significance
from monitor_core.fitting.hold_out import gain, gap_of, judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Standard deviations that the size of an effect must measure at least, and that a declared parameter may be pulled by.
LEAST_SIZE, _STRAINED = 3.0, 3.5
#: The same of responses, by the scatter of the data alone: in thousands of lines, evidence for a shape adds up that
#: measures no size. Of the names in three blind draws right ones have 5.3 at least, two of five wrong ones 3.4 and 4.5.
_LEAST_OF_LINES = 5.0
#: Tolerances: what pulls a declared parameter by no more than that beyond where it was has not strained it.
_FURTHER = 1.0
#: A gap on held-out values that rises by this factor does not fall.
_RISES = 1.02


def cleaned(workspace: Workspace[Physics], fitted: Fitted[Physics]) -> Fitted[Physics]:
    """Return the fit without the effects that are no clean names."""
    for effect in findings(fitted):
        without = workspace.without(fitted, effect)
        if not is_clean(without, fitted, effect, workspace.settings.forgiven_share):
            return cleaned(workspace, without)
    return fitted


def is_clean(without: Fitted[Physics], fuller: Fitted[Physics], effect: Effect[Physics], forgiven_share: float) -> bool:
    """Return whether an effect has a size, does not widen the gap on held-out values, and strains nothing for little.

    Of what it gains where it is fitted, ``forgiven_share`` may be lost where it is not. Where something is
    missing without it, a strain is for the outcome to judge: something else may be missing beside.
    """
    scale, comparison = evidence_scale(fuller), fuller.comparison
    # natural frequencies show that of an added mode, and hardly how large the mode is
    has_only_frequency = effect.frequency is not None and not has_lines(comparison.layout)
    if not has_only_frequency and significance(fuller, effect, scale) < LEAST_SIZE:
        return False
    if has_lines(comparison.layout) and significance(fuller, effect, scale, of_scatter=True) < _LEAST_OF_LINES:
        return False
    before, after = gap_of(comparison, without.held_out), gap_of(comparison, fuller.held_out)
    forgiven = 0.5 * forgiven_share * max(delta_bic(without, fuller, scale), 0.0)
    lost = -gain(without.held_out, fuller.held_out, scale)
    if after > _RISES * before and lost > forgiven:  # never where nothing is held out
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
