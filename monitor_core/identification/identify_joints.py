"""Identify the joints of a described axis from peaks or whole responses at several positions."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor_core.effects import DRIVE_EFFECTS, Effect
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.accelerometer import PlacedAccelerometer, place_accelerometer
from monitor_core.fitting.axis import AxisDescription, at_preload_of_nut
from monitor_core.fitting.coordinates import FreeParameters, free_joints, is_spring
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.residuals.lines import ResponseProblem
from monitor_core.fitting.residuals.natural_frequencies import NaturalFrequencyProblem
from monitor_core.fitting.residuals.peaks import Weighting
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.identification.answer import (
    IdentifiedJoints,
    further_positions,
    held_out_errors,
    joints_of_fit,
    known_sums,
    quality_of,
    robustness_of,
    what_is_not_identifiable,
)
from monitor_core.identification.cases import (
    Case,
    PeakCase,
    ResponseCase,
    assigned_frequencies,
    assigned_peaks,
    frequency_case,
    nearer,
    peak_case,
    positions_of,
    require_positions,
)
from monitor_core.identification.joint_fit import JointFit, JointFitSettings, fit_joints
from monitor_core.identification.predicted_calibration import PredictionRequest, predicted_calibration
from monitor_core.identification.sensitivity import Detectability, modes_to_monitor
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.parameters import name_in_file
from monitor_core.models.protocol import MotorEnd, ResponsePoint, motor_end_of
from monitor_core.models.published.receptance import JOINT_NAMES, ReceptanceParameters
from monitor_core.preload import Calibration

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


#: Relative standard deviation of a joint while the accelerometer is placed.
_FAR_OFF = 0.5


def identify(
    axis: AxisDescription,
    observations: Observations,
    options: IdentifyOptions | None = None,
    *,
    map_function: MapFunction = map,
    progress: Callable[[int, int], None] | None = None,
) -> IdentifiedJoints:
    """Find stiffness and damping of the joints, judge how well each is known, and predict what was held out.

    The axis is a drive of any family; effects that it states stay as they are. Free are the parameters that it calls
    uncertain, or else all its joints. Observations are peaks, or whole responses, at two positions or more.
    ``map_function`` spreads the work over processes, on which the answer does not depend; ``progress`` is called with
    (done, total).

    ``NotIdentifiableError`` if there are too few positions or data, no joint moves anything, every joint ended at a
    limit, a limit names no free joint, or a calibration is to be predicted for a nut whose mass the model's natural
    frequencies have elsewhere. ``OutsideValidityError`` if the model has no answer under one of the conditions, or
    limits do not rise.

    Examples
    --------
    From the peaks that Tian et al. measured, their Table 5 has 7.09e8 N/m for the nut.

    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> peaks = recordings.read_modal_table(Path("replay_data/published/tian_modal_table.csv"))
    >>> axis = recordings.read_model_file(Path("replay_data/models/receptance.toml"))
    >>> free = ("nut_stiffness_n_per_m", "bearing_stiffness_n_per_m", "far_bearing_stiffness_n_per_m")
    >>> found = mc.identify(replace(axis, uncertain=dict.fromkeys(free, 0.5)), [row.observation for row in peaks])
    >>> nut = found.joints["nut_stiffness_n_per_m"]
    >>> f"{1e-8 * nut.interval.lower:.1f} to {1e-8 * nut.interval.upper:.1f} e8 N/m, {nut.verdict}"
    '6.2 to 7.6 e8 N/m, determined'
    """
    options, axis = options or IdentifyOptions(), axis.with_corrected_parameters()
    question = _identifiable(axis, observations, options)  # before the accelerometer is placed, which takes seconds
    placed = _placed(axis, observations, options, map_function)
    if placed.observations:
        observations = placed.observations
        question = question_of(axis, observations, options)
    _require_poles_of_the_nut(axis, observations, options)
    fit = fit_joints(
        question.case,
        question.bounds,
        JointFitSettings(options.seed, uncertainties_stated=question.stated),
        hold_out=options.hold_out,
        map_function=map_function,
        progress=progress,
    )
    values = question.case.drive.values(fit.fit.coordinates.values)
    model = replace(axis, parameters=values, uncertain={})  # what was uncertain rests on these data now
    return IdentifiedJoints(
        joints=joints_of_fit(fit),
        correlations=fit.judged.correlations,
        not_identifiable=(*what_is_not_identifiable(fit), *map(_stays_as_stated, question.unseen)),
        sums=known_sums(fit),
        quality=quality_of(fit, question.case),
        held_out=held_out_errors(fit),
        robustness=robustness_of(question.case, fit),
        missing_modes=_missing_modes(question.case),
        dropped_peaks=question.case.assignment.dropped if isinstance(question.case, PeakCase) else (),
        next_positions=further_positions(question.case, fit, axis.parameters["screw_length_m"]),
        modes_to_monitor=_modes_to_monitor(model, question.case, observations),
        assumptions=(*placed.sentences, *options.assumptions),
        calibration=_calibration(options, question.case, fit),
        model=model,
    )


def require_identifiable(
    axis: AxisDescription, observations: Observations, options: IdentifyOptions | None = None
) -> None:
    """Refuse at once what :func:`identify` would refuse before it searches; raises as it does."""
    _identifiable(axis.with_corrected_parameters(), observations, options or IdentifyOptions())


def _identifiable(axis: AxisDescription, observations: Observations, options: IdentifyOptions) -> Question:
    question = question_of(axis, observations, options)
    case, bounds = question.case, question.bounds
    require_positions(case, options.hold_out)
    problem = case.problem([position for position in positions_of(case) if position not in options.hold_out])
    # the model as stated: what it cannot answer, it cannot answer anywhere
    problem.residuals(np.clip(case.drive.start, bounds.lower, bounds.upper))
    return question


def _placed(
    axis: AxisDescription, observations: Observations, options: IdentifyOptions, map_function: MapFunction
) -> PlacedAccelerometer:
    """Place the accelerometer while every joint may be far from what the model states."""
    _, responses = by_kind(at_one_preload(axis, observations))
    joints = {
        name: _FAR_OFF
        for name, value in axis.parameters.items()
        if value > 0.0 and ("stiffness" in name or not is_spring(name))
    }
    drive = replace(axis, uncertain={**joints, **axis.uncertain}).drive(options.table)
    return place_accelerometer(responses, options.accelerometer, drive, map_function)


def _require_poles_of_the_nut(axis: AxisDescription, observations: Observations, options: IdentifyOptions) -> None:
    """Refuse to predict a calibration of a mode that the natural frequencies of the model would put elsewhere."""
    if options.prediction is not None and _has_another_nut(axis, observations):
        raise NotIdentifiableError(
            "a calibration is predicted from natural frequencies, in which the nut's mass moves with the table: "
            "expected responses of the table, or a model without nut_mass_kg; got an accelerometer on the nut"
        )


def _has_another_nut(axis: AxisDescription, observations: Observations) -> bool:
    """Tell whether the responses know a nut that moves by itself, which natural frequencies of the model do not."""
    _, responses = by_kind(observations)
    at_nut = any(lines.response_point is ResponsePoint.ACCELERATION_AT_NUT for lines in responses)
    stated = axis.parameters
    return at_nut and stated.get("nut_mass_kg", 0.0) > 0.0 and "bracket_stiffness_n_per_m" in stated


def _stays_as_stated(name: str) -> str:
    return f"{name} moves nothing that was measured, and stays as the model states it"


def _missing_modes(case: Case) -> tuple[str, ...]:
    return tuple(peak.sentence for peak in case.assignment.missing) if isinstance(case, PeakCase) else ()


def _modes_to_monitor(model: AxisDescription, case: Case, observations: Observations) -> tuple[Detectability, ...]:
    """Rank the peaks; only the receptance family knows how each answers to the nut."""
    if not of_papers(model) or _has_another_nut(model, observations):
        return ()
    axis = ReceptanceParameters.from_file_names(model.parameters, model.family)
    first = observations[0]
    # peaks are those of a force at the table of a drive that turns freely
    excitation = first.excitation if isinstance(first, FrequencyResponseObservation) else None
    end = MotorEnd.FREE if excitation is None else motor_end_of(excitation, MotorEnd.FREE)
    return modes_to_monitor(axis, case.conditions, _measured_range(observations), motor_end=end)


def _measured_range(observations: Observations) -> tuple[float, float]:
    """Return the lowest and the highest frequency that was measured, with room for a peak on its edge."""
    ends: list[float] = []
    for each in observations:
        if isinstance(each, ModalObservation):
            ends += [0.8 * each.frequency, 1.25 * each.frequency]
        else:
            ends += [float(each.frequency[0]), float(each.frequency[-1])]
    return min(ends), max(ends)


def _calibration(options: IdentifyOptions, case: Case, fit: JointFit) -> Calibration | None:
    if options.prediction is None or fit.lack_of_fit:  # its covariance would not hold what the model leaves out
        return None
    measured = positions_of(case)
    span = measured[0], measured[-1]
    return predicted_calibration(options.prediction, case.drive.model, fit.fit.coordinates, span)
