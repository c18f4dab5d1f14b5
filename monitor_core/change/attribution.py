"""Attribute a moved frequency of an axis to a change.

Measurements of a *reference* time and *recent* ones, each at several positions, and a drive model of the axis:

1. What the model leaves open is fitted to the reference (``reference_axis``).
2. Recent measurements are compared with the reference cell by cell (``reference_ratio``): the measured ratio of the
   whole responses, amplitude and phase, against the modelled ratio. What the model is wrong in at both times cancels.
3. Each change is a hypothesis that acts on the recent side only (``changes``); no change is one of them, and so
   is an unknown one. Their posterior probabilities say which it is (``trials``).

What distinguishes them: a mass moves the antiresonance of the nut with the frequency, a preload does not. A bearing and
an offset of the position move the frequency at one end of the screw more than at the other. A delay turns the phase
alone. Warming softens all by one share; it looks like a little mass on the table, and often only the usual size of
either, or a thermometer, decides between them.

At least three positions at both times are needed; what five and seven are worth was measured, see
docs/explanation/running-axis.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor_core.change.cells import ChangeTolerances
from monitor_core.change.changes import Cause
from monitor_core.change.reference_axis import fit_reference
from monitor_core.change.reference_ratio import compare_times
from monitor_core.change.trials import TriedChange, tried_changes
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.observations import FrequencyResponseObservation, with_accelerometer_at


@dataclass(frozen=True, slots=True)
class AttributionSettings:
    """When a change is named. The figures are set on simulated sessions, see benchmarks/running_axis.py."""

    tolerances: ChangeTolerances = field(default_factory=ChangeTolerances)
    least_confidence: float = 0.9  # below it the likeliest causes are equivalent
    look_alike: float = 10.0  # of BIC, within which another cause is mentioned,
    least_share: float = 0.05  # and so is one that is at least so probable [-]
    remainder: float = 1.5  # times the noise: what an unknown cause is taken to leave


@dataclass(frozen=True, slots=True)
class ChangeAttribution:
    """Which change explains that an axis moved."""

    outcome: Outcome  # named | equivalent | none | unknown
    cause: Cause
    confidence: float  # posterior probability of the cause [-]
    changes: tuple[TriedChange, ...]  # likeliest first
    equivalent_to: tuple[Cause, ...]  # that fit nearly as well or are hardly less probable; none and unknown may be
    gap_before: float  # rms of what no change leaves, in standard deviations
    gap_after: float
    sentence: str  # for the alarm


def attribute_change(
    drive: DescribedDrive,
    reference: Sequence[FrequencyResponseObservation],
    recent: Sequence[FrequencyResponseObservation],
    *,
    preload: float | None = None,
    settings: AttributionSettings | None = None,
) -> ChangeAttribution:
    """Find the change that explains the difference between recent and reference measurements of an axis.

    The axis is as its model file describes it. Stated payloads and temperatures count as known; a preload that is not
    stated is the reference's. ``preload`` [N] is that of the reference, for an axis whose nut follows it; without it no
    change of the preload is thought of.

    ``NotIdentifiableError`` if fewer than three positions were measured at both times, no line stands above its noise,
    or the model does not describe the reference. ``OutsideValidityError`` if the model has no answer under one of the
    conditions.
    """
    settings = settings or AttributionSettings()
    reference, recent = (_with_preload(side, preload) for side in (reference, recent))
    axis = fit_reference(drive, reference, settings.tolerances)
    # a model that is off by more than its form is no better at what changes
    share = settings.tolerances.share_of_change * max(axis.gap, 1.0)
    tolerances = replace(settings.tolerances, share_of_change=share)
    reference, recent = (with_accelerometer_at(axis.accelerometer, side) for side in (reference, recent))
    comparison = compare_times(reference, recent, tolerances)
    axis = replace(axis, reported_warming=_mean_temperature(recent) - _mean_temperature(reference))
    changes, of_unknown = tried_changes(comparison, axis, preload, remainder=settings.remainder)
    return _judged(changes, of_unknown, settings)


def _with_preload(
    observations: Sequence[FrequencyResponseObservation], preload: float | None
) -> tuple[FrequencyResponseObservation, ...]:
    return tuple(
        replace(observation, conditions=replace(observation.conditions, preload=preload))
        if observation.conditions.preload is None
        else observation
        for observation in observations
    )


def _mean_temperature(observations: Sequence[FrequencyResponseObservation]) -> float:
    return float(np.mean([observation.conditions.temperature_deviation for observation in observations]))


def _judged(changes: tuple[TriedChange, ...], of_unknown: float, settings: AttributionSettings) -> ChangeAttribution:
    first = changes[0]
    before = next(change.gap for change in changes if change.cause is Cause.NONE)
    equivalent: list[Cause] = []
    if of_unknown > first.probability:
        outcome, cause, confidence = Outcome.UNKNOWN, Cause.UNKNOWN, of_unknown
        sentence = (
            f"no single change explains it, {_percent(of_unknown)} confidence; the best, {first.words}, leaves "
            f"{first.gap:.1f} times the noise"
        )
    elif first.cause is Cause.NONE:
        outcome, cause, confidence = Outcome.NONE, Cause.NONE, first.probability
        sentence = f"nothing has changed beyond the noise, {_percent(confidence)} confidence"
    else:
        cause = first.cause
        confidence = sum(change.probability for change in changes if change.cause is cause)
        outcome = Outcome.NAMED if confidence >= settings.least_confidence else Outcome.EQUIVALENT
        others = [change for change in changes if change.plausible and change.cause is not cause]
        alike = [other for other in others if _is_alike(other, first, settings)]
        equivalent = [change.cause for change in alike]
        sentence = _sentence(first, confidence, alike, others)
        if of_unknown > settings.least_share:
            equivalent.append(Cause.UNKNOWN)
            sentence += f"; none of these: {_percent(of_unknown)}"
    return ChangeAttribution(
        outcome=outcome,
        cause=cause,
        confidence=confidence,
        changes=changes,
        equivalent_to=tuple(dict.fromkeys(equivalent)),
        gap_before=before,
        gap_after=first.gap,
        sentence=sentence,
    )


def _is_alike(other: TriedChange, first: TriedChange, settings: AttributionSettings) -> bool:
    return first.delta_bic - other.delta_bic < settings.look_alike or other.probability > settings.least_share


def _sentence(
    first: TriedChange, confidence: float, alike: Sequence[TriedChange], others: Sequence[TriedChange]
) -> str:
    parts = [f"{first.words} (95 %), {_percent(confidence)} confidence"]
    if alike:
        parts.append("nearly alike: " + ", or ".join(change.words for change in alike))
    known = {change.cause for change in alike}
    rest = [change for change in others if change.size is not None and change.cause not in known]
    if rest:
        causes = ", ".join(dict.fromkeys(str(change.cause) for change in rest))
        least = min(first.delta_bic - change.delta_bic for change in rest)
        parts.append(f"{causes}: worse by ΔBIC ≥ {least:.0f}")
    return "; ".join(parts)


def _percent(probability: float) -> str:
    return "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
