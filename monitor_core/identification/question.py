"""Pose the question of an identification: which parameters are free, within which limits, and what was measured."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from monitor_core.effects import DRIVE_EFFECTS, Effect
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.coordinates import FreeParameters, free_joints, is_spring
from monitor_core.fitting.description import AxisDescription, at_preload_of_nut
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.residuals.lines import ResponseProblem
from monitor_core.fitting.residuals.natural_frequencies import NaturalFrequencyProblem
from monitor_core.fitting.residuals.peaks import Weighting
from monitor_core.identification.cases import (
    Case,
    ResponseCase,
    assigned_frequencies,
    assigned_peaks,
    frequency_case,
    nearer,
    peak_case,
)
from monitor_core.identification.predicted_calibration import PredictionRequest
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.parameters import name_in_file
from monitor_core.models.published.receptance import JOINT_NAMES

Observations = Sequence[ModalObservation] | Sequence[FrequencyResponseObservation]

#: Limits of a free joint of the receptance family without any stated: so many times less and more than the model says,
#: or than a table leads to that numbers its modes.
STIFFNESS_FACTOR, DAMPING_FACTOR = 30.0, 100.0
#: Tian's model knows joints best: modes by their shapes, heights of peaks.
RECEPTANCE = "receptance"


@dataclass(frozen=True, slots=True, eq=False)
class IdentifyOptions:
    """What is asked besides: judged on what, within which limits, and what is to follow from the joints."""

    hold_out: tuple[float, ...] = ()  # positions that the fit does not see; without any each in turn [m]
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # SI, by names of the model file
    weighting: Weighting = Weighting.UNCERTAINTY
    seed: int = 1  # of the search
    prediction: PredictionRequest | None = None  # of a calibration from the joints
    accelerometer: str | None = None  # where that of a session is; without it where the model fits better
    assumptions: tuple[str, ...] = ()  # what was settled while measuring, in sentences
    effects: tuple[Effect[AxisPhysics], ...] = ()  # of the user's own, which the model may state

    @property
    def table(self) -> tuple[Effect[AxisPhysics], ...]:
        """What the keys of the model's effects may mean."""
        return (*DRIVE_EFFECTS, *self.effects)


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """An axis whose joints are sought: what was measured of it, and which parameters of its model are free."""

    case: Case
    bounds: Bounds
    stated: bool  # whether the data state their uncertainties
    unseen: tuple[str, ...] = ()  # parameters that would be free if anything measured moved with them


def question_of(axis: AxisDescription, observations: Observations, options: IdentifyOptions) -> Question:
    """Return the case, the limits and the free parameters of an identification.

    Raises NotIdentifiableError or OutsideValidityError as :func:`monitor_core.identification.identify_joints.identify`.
    """
    peaks, responses = by_kind(at_one_preload(axis, observations))
    stated = options.weighting is not Weighting.UNIT and all(_states_its_uncertainties(peak) for peak in peaks)
    if options.weighting is Weighting.UNIT and (responses or not of_papers(axis)):
        got = f"one with the effect {next(iter(axis.effects))!r}" if axis.effects else f"a {axis.family} model"
        raise NotIdentifiableError(
            "Eq. (26) compares peaks with a model of the receptance family; got "
            + ("whole responses" if responses else got)
        )
    drive = replace(_freed(axis, peaks), effects=axis.effects, table=options.table)
    near = _near(drive, peaks)
    drive, unseen = _seen(drive, near, peaks, responses)
    near = replace(near, free=drive.free)
    bounds = drive.bounds({**_default_limits(drive, near), **_known_limits(options, drive.free)})
    if responses:
        return Question(ResponseCase(drive, responses, drive.priors), bounds, stated, unseen)
    if of_papers(axis):
        return Question(peak_case(drive, peaks, near=near, weighting=options.weighting), bounds, stated, unseen)
    return Question(frequency_case(drive, peaks, near), bounds, stated, unseen)


def _near(drive: FreeParameters, peaks: tuple[ModalObservation, ...]) -> FreeParameters:
    """Return the drive as stated, or nearer to a table that numbers its modes; nothing is known of its joints there."""
    assign = assigned_peaks if of_papers(drive) else assigned_frequencies
    parameters = nearer(drive, peaks, lambda near: assign(near, peaks)) if peaks else drive.parameters
    return replace(drive, parameters=parameters, uncertain={})


def of_papers(drive: AxisDescription | FreeParameters) -> bool:
    """Tell whether a drive is Tian's as published, whose modes are known by their shapes and peaks by their heights."""
    return drive.family == RECEPTANCE and not drive.effects


def _freed(axis: AxisDescription, peaks: Sequence[ModalObservation]) -> FreeParameters:
    """Free what the description calls uncertain, or else all the joints that it states."""
    if axis.family == RECEPTANCE:
        return _freed_receptance(axis)
    drive = free_joints(axis.family, axis.parameters, axis.uncertain)
    free = tuple(axis.uncertain) or drive.free
    if peaks:  # damping moves a natural frequency in second order only: a fit would take it for a spring
        free = tuple(name for name in free if is_spring(name) or name in axis.uncertain)
    return replace(drive, free=free)


def _freed_receptance(axis: AxisDescription) -> FreeParameters:
    joints = [name_in_file(name) for name in JOINT_NAMES if axis.parameters.get(name_in_file(name), 0.0) > 0.0]
    foreign = sorted(set(axis.uncertain) - set(joints))
    if foreign:
        raise NotIdentifiableError(
            f"of a receptance model the joints that it states can be uncertain here, {', '.join(joints)}; "
            f"leave out {foreign[0]}"
        )
    free = tuple(name for name in joints if name in axis.uncertain) or tuple(joints)
    return FreeParameters(axis.family, axis.parameters, free, {name: axis.uncertain[name] for name in axis.uncertain})


def _seen(
    drive: FreeParameters,
    near: FreeParameters,
    peaks: tuple[ModalObservation, ...],
    responses: tuple[FrequencyResponseObservation, ...],
) -> tuple[FreeParameters, tuple[str, ...]]:
    """Leave out what does not move the data at all, as a coupling behind a measured torque; not all of it, though."""
    if responses:
        jacobian = ResponseProblem(drive, responses).jacobian(drive.start)
    elif of_papers(drive):
        return drive, ()
    else:
        jacobian = NaturalFrequencyProblem(near, assigned_frequencies(near, peaks)).jacobian(near.start)
    unseen = drive.unseen(jacobian)
    if not unseen or len(unseen) == len(drive.free):
        return drive, ()
    free = tuple(name for name in drive.free if name not in unseen)
    uncertain = {name: share for name, share in drive.uncertain.items() if name not in unseen}
    return replace(drive, free=free, uncertain=uncertain), unseen


def _default_limits(drive: FreeParameters, near: FreeParameters) -> dict[str, tuple[float, float]]:
    """Return limits around what a receptance model states, and what is near; other families have the vocabulary's."""
    if drive.family != RECEPTANCE:
        return {}
    limits = {}
    for name in drive.free:
        ends = drive.parameters[name], near.parameters[name]
        factor = STIFFNESS_FACTOR if "stiffness" in name else DAMPING_FACTOR
        limits[name] = (min(ends) / factor, max(ends) * factor)
    return limits


def _known_limits(options: IdentifyOptions, free: tuple[str, ...]) -> Mapping[str, tuple[float, float]]:
    foreign = sorted(set(options.limits) - set(free))
    if foreign:
        raise NotIdentifiableError(f"a limit must be of a free joint, {', '.join(free)}; got {foreign[0]}")
    for name, (low, high) in options.limits.items():
        if not 0.0 < low < high < math.inf:
            raise OutsideValidityError(
                f"limits of {name} must be positive, finite and rising; got {low:g} and {high:g}"
            )
    return options.limits


def at_one_preload(axis: AxisDescription, observations: Observations) -> Observations:
    """Leave out a preload that all share where the nut does not follow it."""
    preloads = {observation.conditions.preload for observation in observations}
    peaks, responses = by_kind(observations)
    if len(preloads) > 1:
        return observations
    return at_preload_of_nut(peaks, axis) if peaks else at_preload_of_nut(responses, axis)


def by_kind(
    observations: Observations,
) -> tuple[tuple[ModalObservation, ...], tuple[FrequencyResponseObservation, ...]]:
    """Return the peaks and the responses among observations."""
    return (
        tuple(each for each in observations if isinstance(each, ModalObservation)),
        tuple(each for each in observations if isinstance(each, FrequencyResponseObservation)),
    )


def _states_its_uncertainties(peak: ModalObservation) -> bool:
    amplitude_counts = peak.amplitude is not None and peak.amplitude_uncertainty is None
    return peak.frequency_uncertainty is not None and not amplitude_counts
