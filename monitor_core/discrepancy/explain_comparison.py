"""Explain a discrepancy end to end: compare, find what is missing, and judge it."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Generic

from monitor_core.discrepancy.assembly import Judged, explanation_of
from monitor_core.discrepancy.description.describe import Description, describe, describe_elsewhere
from monitor_core.discrepancy.description.levels import describe_levels
from monitor_core.discrepancy.description.otherwise import OF_NUT, Otherwise, goes_with_time
from monitor_core.discrepancy.explanation import Explanation, Outcome, Unfinished, WrongRecord
from monitor_core.discrepancy.records import Records, cleared
from monitor_core.discrepancy.search.search import find_again, find_steps, judge_found, judge_so_far
from monitor_core.discrepancy.search.workspace import (
    PULLS_OF_TOLERANCES,
    Accepted,
    Found,
    StoppableAxis,
    TimeIsUpError,
    Workspace,
)
from monitor_core.discrepancy.verdict.classes import (
    AMPLITUDE_LAW,
    TIME_LAW,
    EquivalenceClass,
    classes_with_fit,
    goes_with_amplitude,
    margin_between,
    n_levels,
)
from monitor_core.discrepancy.verdict.outcome import (
    PULLS,
    Remainder,
    explained_share,
    follow_conditions,
    names_nothing,
    outcome_of,
    remainder_of,
    wandering,
)
from monitor_core.effects.effect import Effect, Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import delta_bic, evidence_scale
from monitor_core.fitting.hold_out import judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.fitting.solver.posterior_mode import at_mode

_UNCERTAIN, _SURE = (Outcome.UNKNOWN, Outcome.PARTIAL), (Outcome.NAMED, Outcome.EQUIVALENT)


def explain_comparison(
    comparison: Comparison[Physics],
    axis: DescribedAxis[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    sizes: MachineSizes | None = None,
    progress: Callable[[str], None] | None = None,
    time_is_up: Callable[[], bool] | None = None,
) -> Explanation:
    """Find where measurements and a described axis differ, which candidates it lacks, and how far they close the gap.

    ``sizes`` of the machine are those in which the next measurement is proposed; ``progress`` is called with a few
    words on what is being done. Once ``time_is_up`` says so the search is left, and the answer is what it had come to:
    *partial* or *unknown*, with what was not tried. Raises OutsideValidityError if the described axis
    itself has no answer under one of the conditions.
    """
    told = _Progress(progress or (lambda _: None))
    asked = _Asked(axis, tuple(candidates), sizes, told, time_is_up or (lambda: False))
    layout = comparison.layout
    asked.progress(f"comparing the model as stated with {layout.n_values} values at {len(layout.settings)} settings")
    records = cleared(comparison, axis, asked.progress, candidates)
    searched: _Searched[Physics] | None = None
    while True:
        searched = asked.search(records, searched)
        worst = searched.worst
        if worst is None:  # what a wrong record leaves must not be described
            judged = asked.judge(searched)
            if judged.unfinished or (searched.is_settled and judged.final is searched.final):
                break
            worst, _ = records.worst(judged.final)
        if worst is None:
            break
        asked.progress(f"once more without record {worst.number} ({worst.setting})")
        records = records.without(worst)
    if judged.outcome is Outcome.UNKNOWN and records.wrong and not judged.unfinished:
        # where so much is missing that nothing is found, records may stand out that are right
        of_all = asked.judge(asked.search(Records(comparison), may_be_wrong=False))
        if of_all.outcome is not Outcome.UNKNOWN:
            judged, records = of_all, Records(comparison)
    asked.progress("locating the misfit")
    return replace(explanation_of(judged, candidates, sizes), records=records.named(judged.final))


@dataclass(frozen=True, slots=True, eq=False)
class _Searched(Generic[Physics]):
    """What a search of the records that are kept has found, before it is judged what is left."""

    found: Found[Physics]
    classes: tuple[EquivalenceClass[Physics], ...]
    worst: WrongRecord | None  # of the records, where no more is left than a healthy axis leaves
    follows: Description | None  # what follows the excitation by a law of its own, in the place of the one name
    unfinished: Unfinished | None
    axis: StoppableAxis[Physics]
    workspace: Workspace[Physics]

    @property
    def final(self) -> Fitted[Physics]:
        """The fit with all that was found."""
        return self.found.final

    @property
    def is_settled(self) -> bool:
        """Whether the search has ended, and left no more than a healthy axis does."""
        return not self.unfinished and not judged_gap(self.final).exceeds_healthy


@dataclass(eq=False)
class _Progress:
    """What is being done, told and kept."""

    tell: Callable[[str], None]
    doing: str = ""

    def __call__(self, sentence: str) -> None:
        self.doing = sentence
        self.tell(sentence)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked(Generic[Physics]):
    """What is asked of any of the records."""

    axis: DescribedAxis[Physics]
    candidates: tuple[Effect[Physics], ...]
    sizes: MachineSizes | None
    progress: _Progress
    time_is_up: Callable[[], bool]

    def search(
        self, records: Records[Physics], before: _Searched[Physics] | None = None, *, may_be_wrong: bool = True
    ) -> _Searched[Physics]:
        """Find what explains the records that are kept.

        Of a search ``before``, with a record more, the effects are fitted anew, and others sought with them. Where one
        of the records ``may_be_wrong``, and stands out from what explains the others, nothing is sought that would do
        in the place of what was found: it will be sought without that record. Nor is it where what was found is one
        name, and what follows the excitation by a law of its own explains more.
        """
        comparison, report = records.kept, self.progress
        layout = comparison.layout
        report(f"adjusting the model to {layout.n_values} values at {len(layout.settings)} settings")
        stoppable = StoppableAxis(self.axis, lambda: bool(workspace.so_far) and self.time_is_up())
        otherwise: Otherwise[Physics] = Otherwise(self.sizes, report)
        workspace = Workspace(
            comparison, stoppable, self.candidates, progress=report, is_explained_otherwise=otherwise.explains
        )
        worst, follows, unfinished = None, None, None
        try:
            with stoppable.stoppable():
                steps = () if before is None else find_again(workspace, before.found)
                steps = steps or find_steps(workspace, records.baseline)
                report("judging what was found")
                follows = otherwise.follows(workspace.baseline, steps[-1])
                if may_be_wrong and follows is None and not judged_gap(steps[-1]).exceeds_healthy:
                    worst = _bent_to(records, steps) or records.worst(steps[-1])[0]
                found, classes = _named(workspace, steps, for_now=worst is not None or follows is not None)
        except TimeIsUpError:
            worst, follows, unfinished = None, None, _unfinished(workspace, report.doing)
            found = judge_so_far(workspace, stoppable)
            classes, final = classes_with_fit(found, self.candidates)
            found = replace(found, final=final)
        return _Searched(found, tuple(classes), worst, follows, unfinished, stoppable, workspace)

    def judge(self, searched: _Searched[Physics]) -> Judged[Physics]:
        """Judge what is left, and describe it if it is too much."""
        final, remainder = searched.final, remainder_of(searched.final, counts_strain=True)
        members = ((group.representative.effect, group.representative.delta_bic) for group in searched.classes)
        wanders = wandering(final, members, remainder)
        try:
            with nullcontext() if searched.unfinished else searched.axis.stoppable():
                searched = _with_other_laws(searched)
                outcome, description = self._conclude(searched, remainder, wanders=bool(wanders))
        except TimeIsUpError:  # which is raised once: nothing more is asked then
            searched = replace(searched, unfinished=Unfinished(self.progress.doing))
            outcome, description = self._conclude(searched, remainder, wanders=bool(wanders))
        found, classes = searched.found, searched.classes
        if description is not None and description.fitted is not None:
            outcome, final, remainder = Outcome.DESCRIBED, description.fitted, remainder_of(description.fitted)
            found, classes = description.put_into(found, classes)
        return Judged(
            outcome=outcome,
            found=found,
            final=final,
            classes=classes,
            remainder=remainder,
            wanders=wanders,
            described=() if description is None else (description.described,),
            unfinished=searched.unfinished,
            axis=searched.axis,
        )

    def _conclude(
        self, searched: _Searched[Physics], remainder: Remainder, *, wanders: bool
    ) -> tuple[Outcome, Description | None]:
        """Return the outcome of effects with names, and what is described beside them or in their place.

        What ``wanders`` over frequency is no effect of the catalogue, and what was found beside it may be a part of it.
        An unfinished search is not described, and what follows the excitation by a law of its own has been.
        """
        found, classes, workspace = searched.found, searched.classes, searched.workspace
        if searched.follows is not None:
            return Outcome.DESCRIBED, searched.follows
        outcome = Outcome.UNKNOWN if wanders else _outcome(found.baseline, found.final, classes, remainder, PULLS)
        if searched.unfinished:
            return Outcome.PARTIAL if classes and outcome is not Outcome.UNKNOWN else Outcome.UNKNOWN, None
        follow = wanders or follow_conditions(found.final)
        by_tolerances = (
            outcome if follow else _outcome(found.baseline, found.final, classes, remainder, PULLS_OF_TOLERANCES)
        )
        described, named = None, by_tolerances if outcome in _UNCERTAIN else outcome
        # effects with names that explain what is missing leave nothing to describe but what settings scatter
        if outcome is Outcome.UNKNOWN or (outcome is Outcome.PARTIAL and by_tolerances is Outcome.PARTIAL):
            described = describe(found.baseline, found.final, workspace.candidates, self.sizes, workspace.progress)
            described = described or describe_levels(found.baseline, found.final, workspace.progress)
            if described is not None and described.fitted is not None:
                return outcome, described
        if named in _SURE:
            described = None  # what has no form is not said beside a name
            described = self._elsewhere(workspace, found.final)
        return named, None if named is Outcome.NONE else described

    def _elsewhere(self, workspace: Workspace[Physics], final: Fitted[Physics]) -> Description | None:
        """Return what swings in another place than what was named for it."""
        swinging = [effect for effect in final.hypothesis.effects if effect.frequency is not None]
        without = [workspace.without(final, effect) for effect in swinging]
        return describe_elsewhere(final, without, self.sizes, workspace.progress)


def _outcome(
    baseline: Fitted[Physics],
    final: Fitted[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    remainder: Remainder,
    allowed: float,
) -> Outcome:
    explained = explained_share(baseline, final, remainder.misfit_under(allowed))
    return outcome_of(classes, remainder, explained=explained, allowed=allowed)


def _bent_to(records: Records[Physics], steps: Sequence[Fitted[Physics]]) -> WrongRecord | None:
    """Return the record that a search bent to: with what was found, or alone better than all that was found."""
    first, final = steps[0], steps[-1]
    found = delta_bic(first, final, evidence_scale(final))
    return records.bent_to(final) or (records.bent_to(first, found) if first is not final else None)


def _named(
    workspace: Workspace[Physics], steps: Sequence[Fitted[Physics]], *, for_now: bool
) -> tuple[Found[Physics], Sequence[EquivalenceClass[Physics]]]:
    """Judge what a search has found; ``for_now`` without what would do in the place of it."""
    lost = for_now or names_nothing(steps[0], steps[-1])
    found = judge_found(workspace, steps, alternatives=not lost)
    classes, final = classes_with_fit(found, workspace.candidates)
    # where something is missing no size is so well known that the mode would matter
    if not lost and classes and not judged_gap(final).exceeds_healthy:
        final = at_mode(final)
    return replace(found, final=final), classes


def _with_other_laws(searched: _Searched[Physics]) -> _Searched[Physics]:
    """Return what was found, with the laws of time and amplitude in the classes that they would do in the place of."""
    found = searched.found
    is_named = not (searched.unfinished or searched.follows or names_nothing(found.baseline, found.final))
    if not is_named or not has_lines(found.final.comparison.layout):
        return searched
    pairs = zip(searched.classes, found.accepted, strict=True)
    classes = tuple(_left_to_time(searched.workspace, found, group, accepted) for group, accepted in pairs)
    if len(classes) > 1 and _goes_with_amplitude_alone(searched.workspace, found):
        laws = (tuple(dict.fromkeys((*group.other_laws, AMPLITUDE_LAW))) for group in classes)
        classes = tuple(replace(group, other_laws=each) for group, each in zip(classes, laws, strict=True))
    return replace(searched, classes=classes)


def _goes_with_amplitude_alone(workspace: Workspace[Physics], found: Found[Physics]) -> bool:
    """Return whether, at one level of excitation, one thing that goes with it would do in the place of all effects.

    Its own law may fail where nothing was fitted, so that the search has named it not: the truth may follow another.
    """
    baseline, final, scale = found.baseline, found.final, found.evidence_scale
    if n_levels(final.comparison.layout) > 1:
        return False
    least = -margin_between(found, delta_bic(baseline, final, scale))
    fits = (
        workspace.try_fit(baseline.hypothesis.with_effect(screened.effect), screened.starts[0])
        for screened in workspace.screened(baseline)
        if goes_with_amplitude(screened.effect)
    )
    return any(alone is not None and delta_bic(final, alone, scale) >= least for alone in fits)


def _left_to_time(
    workspace: Workspace[Physics], found: Found[Physics], group: EquivalenceClass[Physics], accepted: Accepted[Physics]
) -> EquivalenceClass[Physics]:
    """Return a class with the law of time in it, where that would do in the place of an effect of the nut."""
    first = group.representative
    if first.effect.key not in OF_NUT:
        return group
    margin = margin_between(found, first.delta_bic)
    is_open = goes_with_time(accepted.without, first.fitted, margin, workspace.progress)
    return replace(group, other_laws=(*group.other_laws, TIME_LAW)) if is_open else group


def _unfinished(workspace: Workspace[Physics], doing: str) -> Unfinished:
    """Return what a search that was left was doing, and what it had not tried."""
    untried = (effect.key for effect in workspace.remaining(workspace.so_far[-1]) if effect.key not in workspace.tried)
    return Unfinished(doing, tuple(dict.fromkeys(untried)))
