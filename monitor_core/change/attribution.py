r"""Attribute a moved frequency of an axis to a change.

Measurements of a *reference* time and *recent* ones, each at several positions, and a drive model of the axis:

1. What the model leaves open is fitted to the reference (``reference_axis``).
2. Recent measurements are compared with the reference cell by cell (``reference_ratio``): the measured ratio of the
   whole responses, amplitude and phase, against the modelled ratio. What the model is wrong in at both times cancels.
3. Each change is a hypothesis that acts on the recent side only (``changes``); no change is one of them, and so
   is an unknown one. Their posterior probabilities say which it is.

What distinguishes them: a mass moves the antiresonance of the nut with the frequency, a preload does not. A bearing and
an offset of the position move the frequency at one end of the screw more than at the other. A delay turns the phase
alone. Warming softens all by one share; it looks like a little mass on the table, and often only the usual size of
either, or a thermometer, decides between them.

At least three positions at both times are needed; what five and seven are worth was measured, see
docs/explanation/running-axis.md.

The evidence for a hypothesis, by Laplace's approximation,

.. math::

    \ln Z = -\tfrac12 \frac{\chi^2(\hat u)}{s^2} \, \frac{1 - \rho}{1 + \rho}
            - \frac{(\hat v - v_0)^2}{2 \tau^2} - \ln\frac{\tau}{\sigma_v}

weighs its fit and, by the spread τ that such changes have over the uncertainty σ of its size v, how much of its
freedom it needed (MacKay, Neural Computation 4 (1992) 415). s² and ρ are those of the best fit. *Unknown* is the
hypothesis that leaves ``remainder`` times the noise, whatever it is: where the best change leaves more, none of these
is the cause.

The axis is as its reference shows it, and what that leaves open widens the size of a change alone. Fitted together with
the change it would take up what the model lacks of it, such as friction that falls with the preload.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.change.cells import ChangeTolerances
from monitor_core.change.changes import Cause, Change, is_reported, possible_changes
from monitor_core.change.reference_axis import ReferenceAxis, fit_reference
from monitor_core.change.reference_ratio import ReferenceRatio, ThenAndNow, compare_times
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.observations import FrequencyResponseObservation, with_accelerometer_at
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.uncertainty import Estimate


@dataclass(frozen=True, slots=True)
class AttributionSettings:
    """When a change is named. The figures are set on simulated sessions, see benchmarks/running_axis.py."""

    tolerances: ChangeTolerances = field(default_factory=ChangeTolerances)
    least_confidence: float = 0.9  # below it the likeliest causes are equivalent
    look_alike: float = 10.0  # of BIC, within which another cause is mentioned,
    least_share: float = 0.05  # and so is one that is at least so probable [-]
    remainder: float = 1.5  # times the noise: what an unknown cause is taken to leave


@dataclass(frozen=True, slots=True)
class TriedChange:
    """A change as fitted."""

    cause: Cause
    key: str  # of the effect; "none" for no change
    size: Estimate | None  # None for no change
    unit: str
    plausible: bool  # whether its size is one that such changes have, and not zero as far as it is known
    gap: float  # rms of what it leaves, in standard deviations
    delta_bic: float  # BIC of no change less its own
    probability: float  # among all and an unknown one [-]


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
    look_alikes: tuple[TriedChange, ...]  # that fit nearly as well as the likeliest, or are hardly less probable
    probability_of_unknown: float  # that it is none of the changes [-]

    @property
    def is_unknown(self) -> bool:
        """Whether none of the changes explains it."""
        return self.cause is Cause.UNKNOWN

    @property
    def may_be_unknown(self) -> bool:
        """Whether none of the changes is hardly less probable than the cause."""
        return Cause.UNKNOWN in self.equivalent_to


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

    Examples
    --------
    A mass of 5 kg that nobody stated stands on the table of the axis of Nguyen et al. (2018):

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> axis = recordings.read_model_file(Path("replay_data/models/lumped.toml"))
    >>> points = mc.ExcitationPoint.TORQUE_AT_SCREW, mc.ResponsePoint.ACCELERATION_AT_TABLE
    >>> def observed(mass, seed):
    ...     rng, frequency = np.random.default_rng(seed), np.arange(40.0, 400.0, 4.0)
    ...     model = mc.build_model("lumped", {**axis.parameters, "table_mass_kg": 20.54 + mass})
    ...     for at in (mc.DriveConditions(x, preload=200.0) for x in (0.2, 0.45, 0.7)):
    ...         exact = model.frequency_response(frequency, at, excitation=points[0], response=points[1]).response
    ...         deviation = 0.004 * abs(exact)
    ...         noise = deviation * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
    ...         yield mc.FrequencyResponseObservation(at, frequency, exact + noise, deviation, *points)
    >>> found = mc.attribute_change(axis.drive(), [*observed(0.0, 1)], [*observed(5.0, 2)], preload=200.0)
    >>> f"{found.cause}: {found.changes[0].size.value:.1f} {found.changes[0].unit}"
    'payload: 5.0 kg'
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
    changes, of_unknown = _tried_changes(comparison, axis, preload, remainder=settings.remainder)
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
    likeliest = changes[0]
    alike: tuple[TriedChange, ...] = ()
    equivalent: list[Cause] = []
    if of_unknown > likeliest.probability:
        outcome, cause, confidence = Outcome.UNKNOWN, Cause.UNKNOWN, of_unknown
    elif likeliest.cause is Cause.NONE:
        outcome, cause, confidence = Outcome.NONE, Cause.NONE, likeliest.probability
    else:
        cause = likeliest.cause
        confidence = sum(change.probability for change in changes if change.cause is cause)
        outcome = Outcome.NAMED if confidence >= settings.least_confidence else Outcome.EQUIVALENT
        others = (change for change in changes if change.plausible and change.cause is not cause)
        alike = tuple(other for other in others if _is_alike(other, likeliest, settings))
        equivalent = [change.cause for change in alike]
        if of_unknown > settings.least_share:
            equivalent.append(Cause.UNKNOWN)
    return ChangeAttribution(
        outcome=outcome,
        cause=cause,
        confidence=confidence,
        changes=changes,
        equivalent_to=tuple(dict.fromkeys(equivalent)),
        gap_before=next(change.gap for change in changes if change.cause is Cause.NONE),
        gap_after=likeliest.gap,
        look_alikes=alike,
        probability_of_unknown=of_unknown,
    )


def _is_alike(other: TriedChange, likeliest: TriedChange, settings: AttributionSettings) -> bool:
    return likeliest.delta_bic - other.delta_bic < settings.look_alike or other.probability > settings.least_share


# --- the trials

#: Sizes tried before a fit, in spreads of the change.
_SIZES = (-4.0, -1.5, -0.5, -0.15, -0.05, 0.05, 0.15, 0.5, 1.5, 4.0)
#: Sizes beyond it are those of something else, in spreads of the change.
_LARGEST = 6.0


@dataclass(frozen=True, eq=False)
class _Trial:
    change: Change | None  # None: no change
    fitted: Fitted[ThenAndNow]

    @property
    def cause(self) -> Cause:
        return Cause.NONE if self.change is None else self.change.cause


def _tried_changes(
    comparison: ReferenceRatio, axis: ReferenceAxis, preload: float | None, *, remainder: float
) -> tuple[tuple[TriedChange, ...], float]:
    """Return all changes between two times, likeliest first, and the probability that it is none of them.

    ``preload`` [N] is that of the reference; an unknown cause is taken to leave ``remainder`` times the noise.
    """
    trials = _trials(comparison, axis, possible_changes(axis, preload))
    scale = evidence_scale(min((trial.fitted for trial in trials), key=lambda fitted: fitted.cost))
    sizes = [None if trial.change is None else _size(trial, trial.change, axis, scale) for trial in trials]
    of_unknown = -0.5 * scale.factor * scale.n_values * remainder**2
    of_changes = [_log_evidence(trial, size, scale) for trial, size in zip(trials, sizes, strict=True)]
    evidence = np.array([*of_changes, of_unknown])
    warming_reported = is_reported(axis.reported_warming)
    evidence += _log_prior([*(trial.cause for trial in trials), Cause.UNKNOWN], warming_reported=warming_reported)
    probability = np.exp(evidence - np.max(evidence))
    probability /= np.sum(probability)
    tried = [
        _tried(trial, size, trials[0], float(share), scale)
        for trial, size, share in zip(trials, sizes, probability, strict=False)
    ]
    return tuple(sorted(tried, key=lambda change: change.probability, reverse=True)), float(probability[-1])


def _trials(comparison: ReferenceRatio, axis: ReferenceAxis, changes: Sequence[Change]) -> list[_Trial]:
    """Return the fits of no change and of each change."""
    unchanged = Hypothesis(replace(axis, reported_warming=0.0).as_fitted())
    none = _Trial(None, fit(comparison, unchanged, unchanged.null))
    return [none, *(trial for change in changes if (trial := _fitted(comparison, axis, change)) is not None)]


def _axis_for(axis: ReferenceAxis, change: Change) -> ReferenceAxis:
    """Return the axis for a change: as warm as reported, unless the change is that of the temperature itself."""
    return replace(axis, reported_warming=0.0) if change.cause is Cause.TEMPERATURE else axis


def _fitted(comparison: ReferenceRatio, axis: ReferenceAxis, change: Change) -> _Trial | None:
    """Return the fit of a change from the best of several sizes; None where the model has an answer for none."""
    hypothesis = Hypothesis(_axis_for(axis, change).as_fitted(), (change.effect,))
    lower, upper = hypothesis.bounds
    sizes = (change.usual + change.spread * np.array(_SIZES)) / change.effect.parameters[0].scale
    deviation, best, start = comparison.layout.standard_deviation, math.inf, None
    for size in np.clip(sizes, lower[-1], upper[-1]).tolist():
        coordinates = np.r_[hypothesis.null[:-1], size]
        try:
            cost = float(np.sum((comparison.misfit(hypothesis.physics(coordinates)) / deviation) ** 2))
        except OutsideValidityError:
            continue
        if cost < best:
            best, start = cost, coordinates
    if start is None:
        return None
    try:
        return _Trial(change, fit(comparison, hypothesis, start))
    except OutsideValidityError:  # at the edge of what an axis can have
        return None


def _size(trial: _Trial, change: Change, axis: ReferenceAxis, scale: EvidenceScale) -> Estimate:
    r"""Return the size of a change, its uncertainty due to the noise and to the open directions of the axis.

    .. math::

        \sigma_v^2 = \frac{1}{f\, J_v^T J_v} + \sum_i \left( \frac{J_v^T J_i}{J_v^T J_v} \right)^2 + (c\, v)^2

    over the directions i, each with a standard deviation of one, and the coefficient c that the size rests on.
    """
    fitted, parameter = trial.fitted, change.effect.parameters[0]
    with_directions = Hypothesis(_axis_for(axis, change), (change.effect,))
    coordinates = np.r_[with_directions.null[:-1], fitted.coordinates[-1]]
    jacobian = replace(fitted, hypothesis=with_directions, coordinates=coordinates).jacobian[fitted.fitted]
    of_size, of_axis = jacobian[:, -1], jacobian[:, :-1]
    information = float(of_size @ of_size)
    moved = of_size @ of_axis / information
    value = fitted.hypothesis.values(fitted.coordinates)[change.effect.key][parameter.name]
    deviation = parameter.scale * math.sqrt(1.0 / (scale.factor * information) + float(moved @ moved))
    return Estimate(value, math.hypot(deviation, change.known_to * value))


def _log_evidence(trial: _Trial, size: Estimate | None, scale: EvidenceScale) -> float:
    """Return ln Z but for what all have in common."""
    of_fit = -0.5 * scale.factor * trial.fitted.cost
    if trial.change is None or size is None:
        return of_fit
    away = (size.value - trial.change.usual) / trial.change.spread
    return of_fit - 0.5 * away**2 - math.log(trial.change.spread / size.standard_uncertainty)


def _log_prior(causes: Sequence[Cause], *, warming_reported: bool) -> FloatArray:
    """Return ln of the probabilities beforehand, but for a constant.

    No change is as likely as all changes together, and each cause as likely as another. A temperature that windows
    report is as likely as no change.
    """
    expected = {Cause.NONE, Cause.TEMPERATURE} if warming_reported else {Cause.NONE}
    others = len(set(causes) - expected)
    return np.array([0.0 if cause in expected else -math.log(others * causes.count(cause)) for cause in causes])


def _tried(trial: _Trial, size: Estimate | None, none: _Trial, probability: float, scale: EvidenceScale) -> TriedChange:
    fitted = trial.fitted
    evidence = delta_bic(none.fitted, fitted, scale)
    if trial.change is None or size is None:
        return TriedChange(Cause.NONE, "none", None, "", True, fitted.gap, evidence, probability)
    change = trial.change
    return TriedChange(
        cause=change.cause,
        key=change.effect.key,
        size=size,
        unit=change.effect.parameters[0].unit,
        plausible=2.0 * size.standard_uncertainty < abs(size.value) < abs(change.usual) + _LARGEST * change.spread,
        gap=fitted.gap,
        delta_bic=evidence,
        probability=probability,
    )
