"""Explain a discrepancy end to end: compare, find what is missing, and judge it."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from typing import Generic

from monitor_core.discrepancy.assembly import Judged, explanation_of
from monitor_core.discrepancy.conclusion import conclude, has_names
from monitor_core.discrepancy.description.describe import Description
from monitor_core.discrepancy.description.otherwise import OF_NUT, Otherwise, goes_with_time
from monitor_core.discrepancy.explanation import Explanation, Outcome, Unfinished
from monitor_core.discrepancy.records.rounds import Records, Worst, cleared
from monitor_core.discrepancy.search.found import Accepted, Found
from monitor_core.discrepancy.search.search import find_again, find_steps, judge_found, judge_so_far, leave_out
from monitor_core.discrepancy.search.stepwise import findings
from monitor_core.discrepancy.search.time_limit import StoppableAxis, TimeIsUpError
from monitor_core.discrepancy.search.workspace import SearchSettings, Workspace
from monitor_core.discrepancy.verdict.classes import (
    AMPLITUDE_LAW,
    TIME_LAW,
    EquivalenceClass,
    classes_with_fit,
    margin_between,
    rests_on_levels_of,
)
from monitor_core.discrepancy.verdict.outcome import (
    OutcomeSettings,
    hidden_in_remainder,
    names_nothing,
    remainder_of,
)
from monitor_core.discrepancy.verdict.wandering import wandering
from monitor_core.effects.effect import Effect, Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.hold_out import judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.fitting.solver.posterior_mode import at_mode


@dataclass(frozen=True, slots=True)
class ExplainSettings:
    """When an effect is accepted, and when something is left."""

    search: SearchSettings = field(default_factory=SearchSettings)
    outcome: OutcomeSettings = field(default_factory=OutcomeSettings)


def explain_comparison(
    comparison: Comparison[Physics],
    axis: DescribedAxis[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    settings: ExplainSettings | None = None,
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
    settings, progress = settings or ExplainSettings(), progress or (lambda _: None)
    layout = comparison.layout
    progress(f"comparing the model as stated with {layout.n_values} values at {len(layout.settings)} settings")
    records = cleared(comparison, axis, progress, candidates)
    searched: _Searched[Physics] | None = None
    with_all: _Searched[Physics] | None = None
    of_all: Judged[Physics] | None = None
    described = False
    while True:
        searched = _search(
            records, axis, candidates, before=searched, has_no_name=described,
            sizes=sizes, settings=settings, progress=progress, time_is_up=time_is_up,
        )  # fmt: skip
        with_all = with_all if records.wrong else searched
        # what a wrong record leaves must not be described
        worst, described = searched.worst, False
        if worst is None:
            judged = _judge(searched, settings, sizes)
            if searched.unfinished or (searched.is_settled and judged.final is searched.final):
                break
            of_all = of_all if records.wrong else judged
            worst = records.worst(judged.final)
            # what has no name in spite of the record will have none without it
            described = judged.outcome is Outcome.DESCRIBED
        if worst is None:
            break
        progress(f"once more without record {worst.record.number} ({worst.record.setting})")
        records = replace(records.with_wrong(worst), right=frozenset())
        if described:
            records = records.cleared_under(judged.final, progress)
    if judged.outcome is Outcome.UNKNOWN and records.wrong and not judged.unfinished:
        # where so much is missing that nothing is found, records may stand out that are right
        if of_all is None:
            if with_all is None:
                again = _search(
                    Records(comparison), axis, candidates, may_be_wrong=False,
                    sizes=sizes, settings=settings, progress=progress, time_is_up=time_is_up,
                )  # fmt: skip
            else:
                again = _with_no_record_wrong(with_all, settings)
            of_all = _judge(again, settings, sizes)
        if of_all.outcome is not Outcome.UNKNOWN:
            judged, records = of_all, Records(comparison)
    progress("locating the misfit")
    return replace(explanation_of(judged, candidates, sizes), records=records.named(judged.final))


@dataclass(frozen=True, slots=True, eq=False)
class _Searched(Generic[Physics]):
    """What a search of the records that are kept has found, before it is judged what is left."""

    steps: tuple[Fitted[Physics], ...]  # of a search that has ended
    found: Found[Physics]
    classes: tuple[EquivalenceClass[Physics], ...]
    hidden: tuple[str, ...]
    worst: Worst | None  # of the records, where no more is left than a healthy axis leaves
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


def _search(
    records: Records[Physics],
    axis: DescribedAxis[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    may_be_wrong: bool = True,
    before: _Searched[Physics] | None = None,
    has_no_name: bool = False,
    sizes: MachineSizes | None,
    settings: ExplainSettings,
    progress: Callable[[str], None],
    time_is_up: Callable[[], bool] | None,
) -> _Searched[Physics]:
    """Find what explains the records that are kept.

    Of a search ``before``, with a record more, the effects are fitted anew; others are sought beside them unless what
    is missing ``has_no_name``. Where one of the records ``may_be_wrong``, and stands out from what explains the others,
    nothing is sought that would do in the place of what was found: it will be sought without that record. Nor is it
    where what was found is one name, and what follows the excitation by a law of its own explains more.
    """
    comparison, doing = records.kept, "comparing the model as stated"

    def report(sentence: str) -> None:
        nonlocal doing
        doing = sentence
        progress(sentence)

    report(f"adjusting the model to {comparison.layout.n_values} values at {len(comparison.layout.settings)} settings")
    stoppable = StoppableAxis(axis, lambda: bool(workspace.so_far) and time_is_up is not None and time_is_up())

    otherwise: Otherwise[Physics] = Otherwise(settings.outcome, sizes, report)
    workspace = Workspace(comparison, stoppable, tuple(candidates), settings.search, report, otherwise.explains)
    steps: tuple[Fitted[Physics], ...] = ()
    hidden, worst, follows, unfinished = list[str](), None, None, None
    try:
        with stoppable.stoppable():
            steps = () if before is None else find_again(workspace, before.found, others=not has_no_name)
            steps = steps or find_steps(workspace, records.baseline)
            while (least := hidden_in_remainder(steps[0], steps[-1], workspace.without, settings.outcome)) is not None:
                hidden.append(least.key)
                steps = leave_out(workspace, steps, least)
            report("judging what was found")
            follows = otherwise.follows(workspace.baseline, steps[-1])
            if may_be_wrong and follows is None:
                worst = _worst_of(records, workspace, steps[-1], named=not has_no_name)
            found, classes = _named(
                records, workspace, steps, settings, for_now=worst is not None or follows is not None
            )
    except TimeIsUpError:
        steps, hidden, worst, follows, unfinished = (), [], None, None, _unfinished(workspace, doing)
        found = judge_so_far(workspace, stoppable)
        classes, final = classes_with_fit(found, candidates)
        found = replace(found, final=final)
    return _Searched(steps, found, tuple(classes), tuple(hidden), worst, follows, unfinished, stoppable, workspace)


def _worst_of(
    records: Records[Physics], workspace: Workspace[Physics], final: Fitted[Physics], *, named: bool
) -> Worst | None:
    """Return the record that stands out from what a search has found, or that an effect with a name was found for."""
    if judged_gap(final).exceeds_healthy:
        return None
    without = (workspace.without(final, effect) for effect in (findings(final) if named else ()))
    behind = (records.behind_effect(final, plain) for plain in without)
    return records.worst(final) or next((worst for worst in behind if worst is not None), None)


def _named(
    records: Records[Physics],
    workspace: Workspace[Physics],
    steps: Sequence[Fitted[Physics]],
    settings: ExplainSettings,
    *,
    for_now: bool,
) -> tuple[Found[Physics], Sequence[EquivalenceClass[Physics]]]:
    """Judge what a search has found; ``for_now`` without what would do in the place of it."""
    lost = for_now or names_nothing(steps[0], steps[-1], settings.outcome)
    found = judge_found(workspace, steps, alternatives=not lost)
    classes, final = classes_with_fit(found, workspace.candidates)
    # where something is missing no size is so well known that the mode would matter
    if (
        not lost
        and not judged_gap(final).exceeds_healthy
        and has_names(found.baseline, final, classes, settings.outcome)
    ):
        final = at_mode(final)
    if not lost and has_lines(final.comparison.layout):
        pairs = zip(classes, found.accepted, strict=True)
        classes = tuple(_left_to_time(workspace, found, group, accepted) for group, accepted in pairs)
        classes = tuple(_left_to_amplitude(records, group) for group in classes)
    return replace(found, final=final), classes


def _left_to_amplitude(records: Records[Physics], group: EquivalenceClass[Physics]) -> EquivalenceClass[Physics]:
    """Return a class with another law of the amplitude in it, where a record was taken out that tells them apart."""
    known = AMPLITUDE_LAW in (*group.untested, *group.other_laws)
    if known or not rests_on_levels_of(group.representative.effect, records.whole.layout, records.wrong):
        return group
    return replace(group, other_laws=(*group.other_laws, AMPLITUDE_LAW))


def _left_to_time(
    workspace: Workspace[Physics], found: Found[Physics], group: EquivalenceClass[Physics], accepted: Accepted[Physics]
) -> EquivalenceClass[Physics]:
    """Return a class with the law of time in it, where that would do in the place of an effect of the nut."""
    first = group.representative
    if first.effect.key not in OF_NUT:
        return group
    margin, is_open = margin_between(found, first.delta_bic), False
    with suppress(TimeIsUpError):  # all else is known by now
        is_open = goes_with_time(accepted.without, first.fitted, margin, workspace.progress)
    return replace(group, other_laws=(*group.other_laws, TIME_LAW)) if is_open else group


def _with_no_record_wrong(searched: _Searched[Physics], settings: ExplainSettings) -> _Searched[Physics]:
    """Return a search of all records with what it has found judged as if none of them were wrong."""
    workspace, doing = searched.workspace, "judging what was found"
    workspace.progress(doing)
    try:
        with searched.axis.stoppable():
            found, classes = _named(Records(workspace.comparison), workspace, searched.steps, settings, for_now=False)
    except TimeIsUpError:
        return replace(searched, worst=None, unfinished=_unfinished(workspace, doing))
    return replace(searched, found=found, classes=tuple(classes), worst=None)


def _judge(searched: _Searched[Physics], settings: ExplainSettings, sizes: MachineSizes | None) -> Judged[Physics]:
    """Judge what is left, and describe it if it is too much."""
    found, final = searched.found, searched.final
    classes: Sequence[EquivalenceClass[Physics]] = searched.classes
    remainder = remainder_of(final, counts_strain=True)
    members = ((group.representative.effect, group.representative.delta_bic) for group in classes)
    wanders = wandering(final, members, remainder, settings.outcome)
    with nullcontext() if searched.unfinished else searched.axis.stoppable():
        concluded = conclude(searched.workspace, found, classes, remainder, settings.outcome, wanders=bool(wanders),
                             unfinished=bool(searched.unfinished), follows=searched.follows, sizes=sizes)  # fmt: skip
    outcome, description = concluded.outcome, concluded.description
    if description is not None and description.fitted is not None:
        outcome, final, remainder = Outcome.DESCRIBED, description.fitted, remainder_of(description.fitted)
        found, classes = description.put_into(found, classes)
    # an effect that would do in the place of another is reported there
    reported = {key for group in classes for key in group.keys}
    hidden = (key for key in searched.hidden if key not in reported and remainder.is_left(concluded.judged_by))
    return Judged(
        outcome=outcome,
        found=found,
        final=final,
        classes=tuple(classes),
        remainder=remainder,
        wanders=wanders,
        hidden=tuple(hidden),
        described=() if description is None else (description.described,),
        unfinished=searched.unfinished,
        axis=searched.axis,
    )


def _unfinished(workspace: Workspace[Physics], doing: str) -> Unfinished:
    """Return what a search that was left was doing, and what it had not tried."""
    untried = (effect.key for effect in workspace.remaining(workspace.so_far[-1]) if effect.key not in workspace.tried)
    return Unfinished(doing, tuple(dict.fromkeys(untried)))
