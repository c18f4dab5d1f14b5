"""Joints from measurements: a drive model and what was measured in, one document with verdicts and advice out."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.coordinates import ModelCoordinates, joint_coordinates
from monitor_core.fitting.joint_coordinates import JointCoordinates
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.priors import relative_priors
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.residuals.lines import ModelResponseProblem
from monitor_core.fitting.residuals.natural_frequencies import NaturalFrequencyProblem
from monitor_core.fitting.residuals.peaks import Weighting
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.fitting.sufficiency import unseen
from monitor_core.identification.advice import modes_to_monitor
from monitor_core.identification.cases import (
    Case,
    ResponseCase,
    peak_case,
    positions_of,
    require_positions,
)
from monitor_core.identification.identify import Identification, IdentificationSettings, identify
from monitor_core.identification.model_cases import ModelResponseCase, frequency_case
from monitor_core.models.parameters import name_in_file
from monitor_core.models.protocol import DriveModel, MotorEnd, ResponsePoint, motor_end_of
from monitor_core.models.published.receptance import ReceptanceModel, ReceptanceParameters
from monitor_core.models.published.receptance.parameters import JOINT_NAMES
from monitor_core.recordings.model_file import DriveModelFile, model_file_text
from service.documents.identification import identification_document, modes_to_monitor_document
from service.operations.discrepancy.accelerometer import PlacedAccelerometer, place_accelerometer
from service.operations.discrepancy.described_drive import described_drive
from service.operations.identification.predicted_calibration import PredictionRequest, predicted_calibration

#: Relative standard deviation of a joint while the accelerometer is placed.
_FAR_OFF = 0.5
#: Limits of a free joint of the receptance family without any stated: so many times less and more than the model says.
STIFFNESS_FACTOR, DAMPING_FACTOR = 30.0, 100.0
#: Tian's model knows joints best: derivatives in closed form, modes by their shapes, heights of peaks.
_RECEPTANCE = "receptance"
_RATING = "dynamic_load_rating_n"
#: What the objective may be, by its names on the wire and on the command line.
OBJECTIVES = {"weighted": Weighting.UNCERTAINTY, "eq-26": Weighting.UNIT}


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationRequest:
    """What is asked: whose joints, from what, judged on what."""

    model: DriveModelFile
    measured: tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...]
    hold_out: tuple[float, ...] = ()  # positions [m]
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # SI, by names of the model file
    weighting: Weighting = Weighting.UNCERTAINTY
    seed: int = 1
    prediction: PredictionRequest | None = None  # of a calibration from the joints
    accelerometer: str | None = None  # where that of a session is; without it where the model fits better
    taken_as: tuple[str, ...] = ()  # what was settled while measuring, in sentences


@dataclass(frozen=True, slots=True, eq=False)
class _Subject:
    """An axis whose joints are sought: what was measured of it, and which parameters of its model are free."""

    case: Case
    bounds: Bounds
    model_at: Callable[[FloatArray], DriveModel]  # from coordinates
    names: tuple[str, ...]  # of the free parameters, in files
    stated: bool  # whether the data state their uncertainties
    unseen: tuple[str, ...] = ()  # parameters that would be free if anything measured moved with them


def identify_joints(
    request: IdentificationRequest,
    *,
    map_function: MapFunction = map,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Return the joints with what is and is not known of them, as a JSON document.

    Raises
    ------
    NotIdentifiableError, OutsideValidityError
        As :func:`monitor_core.identification.identify.identify`; if a limit names no free joint; and if a calibration
        is to be predicted for a nut whose mass the model's natural frequencies have elsewhere.
    """
    _require_answer(_subject(request), request)  # before the accelerometer is placed, which takes seconds
    placed = _placed(request, map_function)
    request = replace(request, measured=placed.observations or request.measured)
    _require_poles_of_the_nut(request)
    subject = _subject(request)
    found = identify(
        subject.case,
        subject.bounds,
        IdentificationSettings(request.seed, uncertainties_stated=subject.stated),
        hold_out=request.hold_out,
        map_function=map_function,
        progress=progress,
    )
    values = (10.0**found.fit.coordinates.values).tolist()
    parameters = {**request.model.parameters, **dict(zip(subject.names, values, strict=True))}
    model = replace(request.model, parameters=parameters, uncertain={})  # what was uncertain rests on these data now
    screw_length = model.parameters["screw_length_m"]
    document = identification_document(found, subject.case, subject.names, screw_length)
    document["not_identifiable"] += [
        f"{name} moves nothing that was measured, and stays as the model states it" for name in subject.unseen
    ]
    return document | {
        "taken_as": [*placed.sentences, *request.taken_as],
        "modes_to_monitor": _modes_to_monitor(model, subject.case, request),
        "calibration": _calibration(request, subject, found),
        "model": model_file_text(model),
    }


def require_identifiable(request: IdentificationRequest) -> None:
    """Refuse at once what :func:`identify_joints` would refuse before it searches; raises as it does."""
    _require_answer(_subject(request), request)


def _require_answer(subject: _Subject, request: IdentificationRequest) -> None:
    """Ask the model as stated once: what it cannot answer, it cannot answer anywhere."""
    case, bounds = subject.case, subject.bounds
    require_positions(case, request.hold_out)
    problem = case.problem([one for one in positions_of(case) if one not in request.hold_out])
    stated = np.log10([request.model.parameters[name] for name in subject.names])
    problem.residuals(np.clip(stated, bounds.lower, bounds.upper))


def _subject(request: IdentificationRequest) -> _Subject:
    if request.model.effects:  # a fit that left them out in silence would be of another axis
        raise NotIdentifiableError(
            f"joints are identified in a model without effects; got the effect {next(iter(request.model.effects))!r}"
        )
    measured = _at_the_preload_of_the_nut(request)
    peaks = tuple(one for one in measured if isinstance(one, ModalObservation))
    responses = tuple(one for one in measured if isinstance(one, FrequencyResponseObservation))
    stated = request.weighting is not Weighting.UNIT and all(_states_its_uncertainties(one) for one in peaks)
    if request.weighting is Weighting.UNIT and (responses or request.model.family != _RECEPTANCE):
        raise NotIdentifiableError(
            "Eq. (26) compares peaks with a model of the receptance family; got "
            + ("whole responses" if responses else f"a {request.model.family} model")
        )
    if request.model.family == _RECEPTANCE:
        return _receptance_subject(request, peaks, responses, stated)
    drive = joint_coordinates(request.model.family, request.model.parameters, request.model.uncertain)
    free = tuple(request.model.uncertain) or drive.free
    if peaks:
        free = tuple(name for name in free if _moves_frequencies(name, request.model))
    drive = replace(drive, free=free)
    unseen = _unseen(drive, peaks, responses)
    drive = replace(
        drive,
        free=tuple(name for name in free if name not in unseen),
        uncertain={name: share for name, share in drive.uncertain.items() if name not in unseen},
    )
    bounds = drive.bounds(_known_limits(request, drive.free))
    case = ModelResponseCase(drive, responses) if responses else frequency_case(drive, peaks)
    return _Subject(case, bounds, drive.build, drive.free, stated, unseen)


def _placed(request: IdentificationRequest, map_function: MapFunction) -> PlacedAccelerometer:
    """Place the accelerometer while every joint may be far from what the model states."""
    model, measured = request.model, _at_the_preload_of_the_nut(request)
    responses = [one for one in measured if isinstance(one, FrequencyResponseObservation)]
    joints = {name: _FAR_OFF for name, value in model.parameters.items() if value > 0.0 and _is_joint(name)}
    subject = described_drive(replace(model, uncertain={**joints, **model.uncertain}))
    return place_accelerometer(responses, request.accelerometer, subject, map_function)


def _is_joint(name: str) -> bool:
    return "stiffness" in name or "damping" in name or name == "loss_factor"


def _require_poles_of_the_nut(request: IdentificationRequest) -> None:
    """Refuse to predict a calibration of a mode that the natural frequencies of the model would put elsewhere."""
    if request.prediction is not None and _has_another_nut(request):
        raise NotIdentifiableError(
            "a calibration is predicted from natural frequencies, in which the nut's mass moves with the table: "
            "expected responses of the table, or a model without nut_mass_kg; got an accelerometer on the nut"
        )


def _has_another_nut(request: IdentificationRequest) -> bool:
    """Tell whether the responses know a nut that moves by itself, which natural frequencies of the model do not."""
    at_nut = any(
        isinstance(one, FrequencyResponseObservation) and one.response_point is ResponsePoint.ACCELERATION_AT_NUT
        for one in request.measured
    )
    stated = request.model.parameters
    return at_nut and stated.get("nut_mass_kg", 0.0) > 0.0 and "bracket_stiffness_n_per_m" in stated


def _at_the_preload_of_the_nut(
    request: IdentificationRequest,
) -> tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...]:
    """Leave out a preload that all share where the nut does not follow it: its rigidity is that at this preload."""
    preloads = {one.conditions.preload for one in request.measured}
    if _RATING in request.model.parameters or len(preloads) > 1 or None in preloads:
        return request.measured
    without = [replace(one, conditions=replace(one.conditions, preload=None)) for one in request.measured]
    return cast(tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...], tuple(without))


def _unseen(
    drive: ModelCoordinates,
    peaks: tuple[ModalObservation, ...],
    responses: tuple[FrequencyResponseObservation, ...],
) -> tuple[str, ...]:
    """Return what does not move the data at all, as a coupling behind a measured torque; not all of it, though."""
    if responses:
        jacobian = ModelResponseProblem(drive, responses).jacobian(drive.start)
    else:
        jacobian = NaturalFrequencyProblem(drive, frequency_case(drive, peaks).peaks).jacobian(drive.start)
    names = unseen(drive, jacobian)
    return names if len(names) < len(drive.free) else ()


def _receptance_subject(
    request: IdentificationRequest,
    peaks: tuple[ModalObservation, ...],
    responses: tuple[FrequencyResponseObservation, ...],
    stated: bool,
) -> _Subject:
    """Free what the file calls uncertain, or else all the joints that it states."""
    model = request.model
    axis = ReceptanceParameters.from_file_names(model.parameters, model.family)
    present = [name for name in JOINT_NAMES if getattr(axis, name) > 0.0]
    stated_joints = [name_in_file(name) for name in present]
    foreign = sorted(set(model.uncertain) - set(stated_joints))
    if foreign:
        raise NotIdentifiableError(
            f"of a receptance model the joints that it states can be uncertain here, {', '.join(stated_joints)}; "
            f"leave out {foreign[0]}"
        )
    uncertain = {name: model.uncertain[name_in_file(name)] for name in present if name_in_file(name) in model.uncertain}
    joints = JointCoordinates(axis, tuple(uncertain or present))
    in_file = {name: name_in_file(name) for name in joints.free}
    limits = _known_limits(request, tuple(in_file.values()))
    bounds = joints.bounds(
        {name: limits.get(in_file[name]) or _wide(name, getattr(axis, name)) for name in joints.free}
    )
    priors = relative_priors(joints.free, {name: getattr(axis, name) for name in joints.free}, uncertain)
    if responses:
        case: Case = ResponseCase(joints, responses, priors)
    else:
        case = peak_case(joints, peaks, weighting=request.weighting, priors=priors)
    return _Subject(case, bounds, partial(_receptance_model, joints), tuple(in_file.values()), stated)


def _receptance_model(joints: JointCoordinates, coordinates: FloatArray) -> DriveModel:
    return ReceptanceModel(joints.parameters(coordinates))


def _calibration(request: IdentificationRequest, subject: _Subject, found: Identification) -> dict[str, Any] | None:
    if request.prediction is None:
        return None
    measured = positions_of(subject.case)
    span = measured[0], measured[-1]
    return predicted_calibration(request.prediction, subject.model_at, found.fit.coordinates, span)


def _states_its_uncertainties(one: ModalObservation) -> bool:
    amplitude_counts = one.amplitude is not None and one.amplitude_uncertainty is None
    return one.frequency_uncertainty is not None and not amplitude_counts


def _moves_frequencies(name: str, model: DriveModelFile) -> bool:
    """Damping moves a natural frequency in second order only: a fit would take it to where it stands for a spring."""
    return ("damping" not in name and name != "loss_factor") or name in model.uncertain


def _wide(name: str, value: float) -> tuple[float, float]:
    factor = STIFFNESS_FACTOR if name.endswith("stiffness") else DAMPING_FACTOR
    return value / factor, value * factor


def _known_limits(request: IdentificationRequest, free: tuple[str, ...]) -> Mapping[str, tuple[float, float]]:
    foreign = sorted(set(request.limits) - set(free))
    if foreign:
        raise NotIdentifiableError(f"a limit must be of a free joint, {', '.join(free)}; got {foreign[0]}")
    for name, (low, high) in request.limits.items():
        if not 0.0 < low < high < math.inf:
            raise OutsideValidityError(
                f"limits of {name} must be positive, finite and rising; got {low:g} and {high:g}"
            )
    return request.limits


def _modes_to_monitor(model: DriveModelFile, case: Case, request: IdentificationRequest) -> list[dict[str, Any]]:
    """Rank the peaks; only the receptance family knows how each answers to the nut."""
    if model.family != _RECEPTANCE or _has_another_nut(request):
        return []
    axis = ReceptanceParameters.from_file_names(model.parameters, model.family)
    first = request.measured[0]
    end = _motor_end(first)
    return modes_to_monitor_document(modes_to_monitor(axis, case.conditions, _measured_range(request), motor_end=end))


def _motor_end(one: ModalObservation | FrequencyResponseObservation) -> MotorEnd:
    """Return what held the motor end while it was measured; peaks are those of a force at the table of a free drive."""
    return (
        motor_end_of(one.excitation, MotorEnd.FREE) if isinstance(one, FrequencyResponseObservation) else MotorEnd.FREE
    )


def _measured_range(request: IdentificationRequest) -> tuple[float, float]:
    """Return the lowest and the highest frequency that was measured, with room for a peak on its edge."""
    ends: list[float] = []
    for one in request.measured:
        if isinstance(one, ModalObservation):
            ends += [0.8 * one.frequency, 1.25 * one.frequency]
        else:
            ends += [float(one.frequency[0]), float(one.frequency[-1])]
    return min(ends), max(ends)
