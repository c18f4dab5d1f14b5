"""Conclude from what was found: the outcome by names alone, and what is described in their place."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from monitor_core.discrepancy.description.describe import Description, describe, describe_elsewhere
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.search.time_limit import TimeIsUpError
from monitor_core.discrepancy.search.workspace import Workspace
from monitor_core.discrepancy.verdict.classes import EquivalenceClass
from monitor_core.discrepancy.verdict.outcome import (
    OutcomeSettings,
    Remainder,
    explained_share,
    follow_conditions,
    outcome_of,
    remainder_of,
)
from monitor_core.effects.effect import Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.fitting.solver.hypothesis_fit import Fitted

_BELIEVED = (Outcome.NAMED, Outcome.EQUIVALENT, Outcome.PARTIAL)
_UNCERTAIN, _SURE = (Outcome.UNKNOWN, Outcome.PARTIAL), (Outcome.NAMED, Outcome.EQUIVALENT)


@dataclass(frozen=True, slots=True, eq=False)
class Conclusion:
    """What an answer comes to."""

    outcome: Outcome  # by names alone
    judged_by: OutcomeSettings
    description: Description | None = None


def conclude(
    workspace: Workspace[Physics],
    found: Found[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    remainder: Remainder,
    settings: OutcomeSettings,
    *,
    wanders: bool,
    unfinished: bool,
    follows: Description | None,
    sizes: MachineSizes | None,
) -> Conclusion:
    """Return the outcome of effects with names, and what is described beside them or in their place.

    What ``wanders`` over frequency is no effect of the catalogue, and what was found beside it may be a part of it. An
    ``unfinished`` search is not described, and what ``follows`` the excitation by a law of its own has been.
    """
    if follows is not None:
        return Conclusion(Outcome.DESCRIBED, settings, follows)
    outcome = Outcome.UNKNOWN if wanders else _outcome(found.baseline, found.final, classes, remainder, settings)
    if unfinished:
        return Conclusion(Outcome.PARTIAL if classes and outcome is not Outcome.UNKNOWN else Outcome.UNKNOWN, settings)
    relaxed, follow = settings.of_tolerances(), wanders or follow_conditions(found.final)
    by_tolerances = outcome if follow else _outcome(found.baseline, found.final, classes, remainder, relaxed)
    described = None
    # effects with names that explain what is missing leave nothing to describe but what settings scatter
    if outcome is Outcome.UNKNOWN or (outcome is Outcome.PARTIAL and by_tolerances is Outcome.PARTIAL):
        described = describe(found.baseline, found.final, workspace.candidates, sizes, workspace.progress)
        if described is not None and described.fitted is not None:
            return Conclusion(outcome, settings, described)
    if outcome in _UNCERTAIN and not follow:
        outcome, settings = by_tolerances, relaxed
    if outcome in _SURE:
        described = _elsewhere(workspace, found.final, sizes)
    return Conclusion(outcome, settings, None if outcome is Outcome.NONE else described)


def has_names(
    baseline: Fitted[Physics],
    final: Fitted[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    settings: OutcomeSettings,
) -> bool:
    """Return whether a name is believed of what was found, with the tolerances as stated or as they may be."""
    remainder = remainder_of(final, counts_strain=True)
    tried = (settings,) if follow_conditions(final) else (settings, settings.of_tolerances())
    return any(_outcome(baseline, final, classes, remainder, each) in _BELIEVED for each in tried)


def _outcome(
    baseline: Fitted[Physics],
    final: Fitted[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    remainder: Remainder,
    settings: OutcomeSettings,
) -> Outcome:
    explained = explained_share(baseline, final, remainder.misfit_under(settings))
    return outcome_of(classes, remainder, explained=explained, settings=settings)


def _elsewhere(workspace: Workspace[Physics], final: Fitted[Physics], sizes: MachineSizes | None) -> Description | None:
    """Return what swings in another place than what was named for it, None too where time is up."""
    swinging = [effect for effect in final.hypothesis.effects if effect.frequency is not None]
    with suppress(TimeIsUpError):
        without = [workspace.without(final, effect) for effect in swinging]
        return describe_elsewhere(final, without, sizes, workspace.progress)
    return None
