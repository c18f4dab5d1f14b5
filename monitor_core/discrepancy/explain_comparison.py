"""Explain a discrepancy end to end: compare, find what is missing, judge it, and put it into words and numbers."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from monitor_core.discrepancy.conclusion import conclude, has_names
from monitor_core.discrepancy.description.describe import swinging_at_port
from monitor_core.discrepancy.explanation import (
    Explanation,
    FoundEffect,
    FoundParameter,
    Gap,
    GapPair,
    Misfit,
    MisfitMap,
    Outcome,
    Step,
)
from monitor_core.discrepancy.localisation.localise import (
    HealthyScatter,
    localise,
    misfit_map,
    varied_conditions_of_maps,
)
from monitor_core.discrepancy.localisation.misfit_kind import signatures
from monitor_core.discrepancy.records.rounds import cleared
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.search.search import find_again, find_steps, judge_found, judge_so_far, leave_out
from monitor_core.discrepancy.search.time_limit import StoppableAxis, TimeIsUpError
from monitor_core.discrepancy.search.workspace import SearchSettings, Workspace
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, found_parameters
from monitor_core.discrepancy.verdict.next_measurement import next_measurement
from monitor_core.discrepancy.verdict.not_found import candidates_not_found
from monitor_core.discrepancy.verdict.outcome import (
    OutcomeSettings,
    classes_with_fit,
    hidden_in_remainder,
    names_nothing,
    remainder_of,
)
from monitor_core.discrepancy.verdict.wandering import Wandering, leaves_only_wandering, wandering
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.effects.units import unit_sentence
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison, Panel
from monitor_core.fitting.described_axis import DescribedAxis
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.hold_out import gap_of, judged_gap
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
    *partial* or *unknown*, with a sentence on what was not tried. Raises OutsideValidityError if the described axis
    itself has no answer under one of the conditions.
    """
    settings, progress = settings or ExplainSettings(), progress or (lambda _: None)
    layout = comparison.layout
    progress(f"comparing the model as stated with {layout.n_values} values at {len(layout.settings)} settings")
    records = cleared(comparison, axis, progress, candidates)
    searched: _Searched[Physics] | None = None
    described = False
    while True:
        searched = _search(
            records.kept, axis, candidates, baseline=records.baseline, before=searched, has_no_name=described,
            sizes=sizes, settings=settings, progress=progress, time_is_up=time_is_up,
        )  # fmt: skip
        # what a wrong record leaves must not be described
        worst, described = records.worst(searched.final) if searched.is_settled else None, False
        if worst is None:
            explanation, final = _explain(searched, candidates, settings, sizes)
            if searched.unfinished or (searched.is_settled and final is searched.final):
                break
            worst = records.worst(final)
            # what has no name in spite of the record will have none without it
            described = explanation.outcome is Outcome.DESCRIBED
        if worst is None:
            break
        progress(f"once more without record {worst.record.number} ({worst.record.setting})")
        records = replace(records.with_wrong(worst), right=frozenset())
    if explanation.outcome is Outcome.UNKNOWN and records.wrong and not explanation.unfinished:
        # where so much is missing that nothing is found, records may stand out that are right
        searched = _search(
            comparison, axis, candidates, sizes=sizes, settings=settings, progress=progress, time_is_up=time_is_up
        )
        whole, _ = _explain(searched, candidates, settings, sizes)
        if whole.outcome is not Outcome.UNKNOWN:
            return whole
    return replace(explanation, records=records.named(final))


@dataclass(frozen=True, slots=True, eq=False)
class _Searched(Generic[Physics]):
    """What a search of the records that are kept has found, before it is judged what is left."""

    found: Found[Physics]
    classes: tuple[EquivalenceClass[Physics], ...]
    hidden: tuple[str, ...]
    unfinished: str
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
    comparison: Comparison[Physics],
    axis: DescribedAxis[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    baseline: Fitted[Physics] | None = None,
    before: _Searched[Physics] | None = None,
    has_no_name: bool = False,
    sizes: MachineSizes | None,
    settings: ExplainSettings,
    progress: Callable[[str], None],
    time_is_up: Callable[[], bool] | None,
) -> _Searched[Physics]:
    """Find what explains the records that are kept; ``baseline`` is the fit without any effect if it is known.

    Of a search ``before``, with a record more, the effects are fitted anew; others are sought beside them unless what
    is missing ``has_no_name``.
    """
    said = ["comparing the model as stated"]

    def report(sentence: str) -> None:
        said.append(sentence)
        progress(sentence)

    report(f"adjusting the model to {comparison.layout.n_values} values at {len(comparison.layout.settings)} settings")
    stoppable = StoppableAxis(axis, lambda: bool(workspace.so_far) and time_is_up is not None and time_is_up())

    def explained_otherwise(fitted: Fitted[Physics]) -> bool:
        return (
            leaves_only_wandering(fitted, settings.outcome)
            or swinging_at_port(workspace.baseline, fitted, sizes, report) is not None
        )

    workspace = Workspace(comparison, stoppable, tuple(candidates), settings.search, report, explained_otherwise)
    hidden, unfinished = list[str](), ""
    try:
        with stoppable.stoppable():
            steps = () if before is None else find_again(workspace, before.found, others=not has_no_name)
            steps = steps or find_steps(workspace, baseline)
            while (least := hidden_in_remainder(steps[0], steps[-1], workspace.without, settings.outcome)) is not None:
                hidden.append(least.key)
                steps = leave_out(workspace, steps, least)
            report("judging what was found")
            lost = names_nothing(steps[0], steps[-1], settings.outcome)
            found = judge_found(workspace, steps, alternatives=not lost)
            classes, final = classes_with_fit(found, candidates)
            # where something is missing no size is so well known that the mode would matter
            if (
                not lost
                and not judged_gap(final).exceeds_healthy
                and has_names(found.baseline, final, classes, settings.outcome)
            ):
                final = at_mode(final)
    except TimeIsUpError:
        hidden, unfinished = [], _unfinished(workspace, said[-1])
        found = judge_so_far(workspace)
        classes, final = classes_with_fit(found, candidates)
    return _Searched(replace(found, final=final), tuple(classes), tuple(hidden), unfinished, stoppable, workspace)


def _explain(
    searched: _Searched[Physics],
    candidates: Sequence[Effect[Physics]],
    settings: ExplainSettings,
    sizes: MachineSizes | None,
) -> tuple[Explanation, Fitted[Physics]]:
    """Judge what is left, describe it if it is too much, and put all of it into words; return the final fit, too."""
    found, final, unfinished = searched.found, searched.final, searched.unfinished
    classes: Sequence[EquivalenceClass[Physics]] = searched.classes
    comparison = final.comparison
    remainder = remainder_of(final, found.baseline)
    wanders = wandering(final, (group.representative.effect for group in classes), remainder, settings.outcome)
    with nullcontext() if unfinished else searched.axis.stoppable():
        concluded = conclude(searched.workspace, found, classes, remainder, settings.outcome, wanders=bool(wanders),
                             unfinished=bool(unfinished), sizes=sizes)  # fmt: skip
    outcome, description = concluded.outcome, concluded.description
    if description is not None and description.fitted is not None:
        outcome, final, remainder = Outcome.DESCRIBED, description.fitted, remainder_of(description.fitted)
        found, classes = description.put_into(found, classes)
    said_of_it = () if description is None else (description.described,)
    reported = {key for group in classes for key in group.keys}
    searched.workspace.progress("locating the misfit")
    scale = found.evidence_scale
    scatter = HealthyScatter(scale.correlation, math.sqrt(max(scale.mean_square, 1.0)))
    explanation = Explanation(
        outcome=outcome,
        effects=tuple(_found_effect(group, final, scale, wanders) for group in classes),
        localisation=_misfits(found.baseline, candidates, scatter),
        remainder=_misfits(final, candidates, scatter) if outcome is not Outcome.NONE else (),
        gap=Gap(comparison.unit, comparison.noise_floor, _gap_pair(found.baseline), _gap_pair(final)),
        steps=_steps(found, classes),
        candidates=candidates_not_found(found, candidates, classes, not_tried="time was up" if unfinished else None),
        pulls={name: math.sqrt(value) for name, value in remainder.pulls.items()} | _parameter_pulls(final),
        least_delta_bic=found.least_delta_bic,
        next_measurement=next_measurement(found, classes, outcome, candidates, sizes, described=said_of_it),
        ln_ratios=_ln_ratios(final),
        added={key: values for key, values in _values(final).items() if not key.startswith(PREFIX)},
        panels=_panels(found),
        maps=_maps(found),
        gap_by_channel=_gap_by_channel(found),
        pulls_before=_parameter_pulls(found.baseline),
        # an effect that would do in the place of another is reported there
        hidden_in_remainder=tuple(
            key for key in searched.hidden if key not in reported and remainder.is_left(concluded.judged_by)
        ),
        unfinished=unfinished,
        described=said_of_it,
    )
    return explanation, final


def _ln_ratios(final: Fitted[Physics]) -> dict[str, float]:
    """Return ln(refitted/stated) of the parameters of the model file, those that are called wrong included."""
    wrong = {key.removeprefix(PREFIX): values for key, values in _values(final).items() if key.startswith(PREFIX)}
    return final.hypothesis.ln_ratios(final.coordinates) | {name: values["ln_ratio"] for name, values in wrong.items()}


def _values(final: Fitted[Physics]) -> dict[str, dict[str, float]]:
    return final.hypothesis.values(final.coordinates)


def _unfinished(workspace: Workspace[Physics], doing: str) -> str:
    """Say what a search that was left was doing, and what it had not tried."""
    untried = [effect.key for effect in workspace.remaining(workspace.so_far[-1]) if effect.key not in workspace.tried]
    listed = ", ".join(dict.fromkeys(untried))
    not_tried = f"no fit had tried {listed}" if listed else "every effect had been tried in some fit"
    return (
        f"Time was up while {doing}: {not_tried}, and what else would do in the place of what was found was not looked "
        "for to the end; give it more time to be sure of the answer."
    )


def _found_effect(
    group: EquivalenceClass[Physics], stated: Fitted[Physics], scale: EvidenceScale, wanders: Mapping[str, Wandering]
) -> FoundEffect:
    """Return the representative of a class with its parameters and remarks, as the augmented model states it."""
    member = group.representative
    parameters = found_parameters(member, stated, scale)
    remarks = [f"the same finding as {key}" for key in group.aliases]
    remarks += [
        f"a stand-in for something else: {name} = {_value(parameter)} is beyond its plausible range"
        for name, parameter in parameters.items()
        if not parameter.plausible
    ]
    if group.stands_in_for:
        remarks += [
            f"a stand-in for something else: {group.stands_in_for} would explain more, which such data cannot tell"
        ]
    remarks += [
        f"{name} = {_value(parameter)} is at an end of the range that is searched"
        for name, parameter in parameters.items()
        if parameter.at_end
    ]
    if (found := wanders.get(member.effect.key)) is not None:
        remarks += [
            "a stand-in for something whose frequency wanders: it would be "
            f"{found.lowest:.4g} Hz at one setting and {found.highest:.4g} Hz at another"
        ]
    if "ln_factor" in parameters:
        estimate = parameters["ln_factor"].estimate
        remarks += [unit_sentence(member.effect.name, estimate.value, estimate.standard_uncertainty)]
    return FoundEffect(
        key=member.effect.key,
        name=member.effect.name,
        physics=member.effect.physics,
        parameters=parameters,
        equivalent_to=group.others,
        delta_bic=member.delta_bic,
        held_out_log_likelihood_gain=group.held_out_gain,
        remarks=tuple(remarks),
        stands_in_for=group.stands_in_for,
    )


def _steps(found: Found[Physics], classes: Sequence[EquivalenceClass[Physics]]) -> tuple[Step, ...]:
    """Return what was added in each step, by the representatives of their classes, and what it left."""
    pairs = zip(found.accepted, classes, strict=True)
    named = {accepted.effect.key: group.representative.effect.key for accepted, group in pairs}
    steps = []
    for earlier, later in zip((found.baseline, *found.steps), found.steps, strict=False):
        added = [effect.key for effect in later.hypothesis.effects if effect.key not in earlier.hypothesis.keys]
        left = found.final if later is found.steps[-1] else later
        steps.append(Step(" + ".join(named.get(key, key) for key in added), _gap_pair(left)))
    return tuple(steps)


def _gap_pair(fitted: Fitted[Physics]) -> GapPair:
    """Return the gap of a fit on the values it saw and on those it did not."""
    return GapPair(fitted.gap, gap_of(fitted.comparison, fitted.held_out))


def _value(parameter: FoundParameter) -> str:
    return f"{parameter.estimate.value:.3g}" + ("" if parameter.unit == "-" else f" {parameter.unit}")


def _misfits(
    fitted: Fitted[Physics], candidates: Sequence[Effect[Physics]], scatter: HealthyScatter
) -> tuple[Misfit, ...]:
    present, physics = fitted.hypothesis.keys, fitted.physics()
    others = [effect for effect in candidates if effect.key not in present and effect.applies(physics)]
    return localise(fitted.comparison.layout, fitted.standardised, signatures(fitted, others), scatter)


def _panels(found: Found[Physics]) -> tuple[Panel, ...]:
    """Return pictures of both models, if they have an answer at the settings as stated and not only as fitted."""
    comparison, models = found.final.comparison, {}
    for name, fitted in (("before", found.baseline), ("after", found.final)):
        physics = fitted.physics()
        with suppress(OutsideValidityError):
            comparison.misfit(physics)
            models[name] = physics
    return comparison.panels(models)


def _maps(found: Found[Physics]) -> tuple[MisfitMap, ...]:
    layout = found.final.comparison.layout
    maps = []
    for over in varied_conditions_of_maps(layout) or (None,):
        rows, columns, before = misfit_map(layout, found.baseline.standardised, over)
        _, _, after = misfit_map(layout, found.final.standardised, over)
        title = "Misfit in standard deviations" + ("" if over is None else f" over {over}")
        maps.append(MisfitMap(title, rows, columns, before, after))
    return tuple(maps)


def _gap_by_channel(found: Found[Physics]) -> dict[str, tuple[float, float]]:
    comparison, both = found.final.comparison, (found.baseline, found.final)
    gaps = {}
    for channel, name in enumerate(comparison.layout.channels):
        chosen = found.final.fitted & (comparison.layout.channel == channel)
        if np.any(chosen):
            before, after = (comparison.gap(fitted.misfit, fitted.standardised, chosen) for fitted in both)
            gaps[name] = (before, after)
    return gaps


def _parameter_pulls(fitted: Fitted[Physics]) -> dict[str, float]:
    hypothesis = fitted.hypothesis
    pulls = fitted.coordinates[: hypothesis.n_uncertain].tolist()
    return dict(zip(hypothesis.uncertain, pulls, strict=True))
