"""Put what was found into an explanation: words, numbers and pictures of what the model lacks and what is left."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.discrepancy.explanation import (
    Described,
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
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, found_parameters
from monitor_core.discrepancy.verdict.next_measurement import next_measurement
from monitor_core.discrepancy.verdict.not_found import candidates_not_found
from monitor_core.discrepancy.verdict.outcome import Remainder
from monitor_core.discrepancy.verdict.wandering import Wandering
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.effects.units import unit_sentence
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Panel
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.hold_out import gap_of
from monitor_core.fitting.solver.hypothesis_fit import Fitted


@dataclass(frozen=True, slots=True, eq=False)
class Judged(Generic[Physics]):
    """What an answer comes to, before it is put into words."""

    outcome: Outcome
    found: Found[Physics]
    final: Fitted[Physics]  # with what is described, too
    classes: tuple[EquivalenceClass[Physics], ...]
    remainder: Remainder
    wanders: Mapping[str, Wandering]  # by the key of the effect
    hidden: tuple[str, ...]  # keys of effects that hide in the remainder
    described: tuple[Described, ...]
    unfinished: str


def explanation_of(
    judged: Judged[Physics], candidates: Sequence[Effect[Physics]], sizes: MachineSizes | None
) -> Explanation:
    """Return the explanation; ``sizes`` of the machine are those in which the next measurement is proposed."""
    found, final, classes, outcome = judged.found, judged.final, judged.classes, judged.outcome
    comparison, scale = final.comparison, found.evidence_scale
    scatter = HealthyScatter(scale.correlation, math.sqrt(max(scale.mean_square, 1.0)))
    not_tried = "time was up" if judged.unfinished else None
    return Explanation(
        outcome=outcome,
        effects=tuple(_found_effect(group, final, scale, judged.wanders) for group in classes),
        localisation=_misfits(found.baseline, candidates, scatter),
        remainder=_misfits(final, candidates, scatter) if outcome is not Outcome.NONE else (),
        gap=Gap(comparison.unit, comparison.noise_floor, _gap_pair(found.baseline), _gap_pair(final)),
        steps=_steps(found, classes),
        candidates=candidates_not_found(found, candidates, classes, not_tried=not_tried),
        pulls={name: math.sqrt(value) for name, value in judged.remainder.pulls.items()} | _parameter_pulls(final),
        least_delta_bic=found.least_delta_bic,
        next_measurement=next_measurement(found, classes, outcome, candidates, sizes, described=judged.described),
        ln_ratios=_ln_ratios(final),
        added={key: values for key, values in _values(final).items() if not key.startswith(PREFIX)},
        panels=_panels(found),
        maps=_maps(found),
        gap_by_channel=_gap_by_channel(found),
        pulls_before=_parameter_pulls(found.baseline),
        hidden_in_remainder=judged.hidden,
        unfinished=judged.unfinished,
        described=judged.described,
    )


def _ln_ratios(final: Fitted[Physics]) -> dict[str, float]:
    """Return ln(refitted/stated) of the parameters of the model file, those that are called wrong included."""
    wrong = {key.removeprefix(PREFIX): values for key, values in _values(final).items() if key.startswith(PREFIX)}
    return final.hypothesis.ln_ratios(final.coordinates) | {name: values["ln_ratio"] for name, values in wrong.items()}


def _values(final: Fitted[Physics]) -> dict[str, dict[str, float]]:
    return final.hypothesis.values(final.coordinates)


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
