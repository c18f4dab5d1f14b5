"""Put accepted effects and the steps that led to them into the words and numbers of the answer."""

from collections.abc import Sequence
from typing import TypeVar

from monitor_core.discrepancy.explanation import FoundEffect, FoundParameter, GapPair, Step
from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, found_parameters
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.hold_out import gap_of
from monitor_core.fitting.solver.hypothesis_fit import Fitted

Physics = TypeVar("Physics")


def found_effect(group: EquivalenceClass[Physics], stated: Fitted[Physics], scale: EvidenceScale) -> FoundEffect:
    """Return the representative of a class with its parameters and remarks.

    Parameters
    ----------
    group : EquivalenceClass
    stated : Fitted
        With all effects of the augmented model, at the mode of the posterior.
    scale : EvidenceScale
    """
    member = group.representative
    parameters = found_parameters(member, stated, scale)
    remarks = [f"the same finding as {key}" for key in group.aliases]
    remarks += [
        f"a stand-in for something else: {name} = {_value(parameter)} is beyond its plausible range"
        for name, parameter in parameters.items()
        if not parameter.plausible
    ]
    remarks += [
        f"{name} = {_value(parameter)} is at an end of the range that is searched"
        for name, parameter in parameters.items()
        if parameter.at_end
    ]
    return FoundEffect(
        key=member.effect.key,
        name=member.effect.name,
        physics=member.effect.physics,
        parameters=parameters,
        equivalent_to=group.others,
        delta_bic=member.delta_bic,
        held_out_log_likelihood_gain=group.held_out_gain,
        remarks=tuple(remarks),
    )


def steps_of(found: Found[Physics], classes: Sequence[EquivalenceClass[Physics]]) -> tuple[Step, ...]:
    """Return what was added in each step, by the representatives of their classes, and what it left."""
    pairs = zip(found.accepted, classes, strict=True)
    named = {accepted.effect.key: group.representative.effect.key for accepted, group in pairs}
    steps = []
    for earlier, later in zip((found.baseline, *found.steps), found.steps, strict=False):
        known = {effect.key for effect in earlier.hypothesis.effects}
        added = [effect.key for effect in later.hypothesis.effects if effect.key not in known]
        left = found.final if later is found.steps[-1] else later
        steps.append(Step(" + ".join(named.get(key, key) for key in added), gap_pair(left)))
    return tuple(steps)


def gap_pair(fitted: Fitted[Physics]) -> GapPair:
    """Return the gap of a fit on the values it saw and on those it did not."""
    return GapPair(fitted.gap, gap_of(fitted.comparison, fitted.held_out))


def _value(parameter: FoundParameter) -> str:
    return f"{parameter.estimate.value:.3g}" + ("" if parameter.unit == "-" else f" {parameter.unit}")
