"""Identify the joints of a described axis from peaks or whole responses at several positions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.accelerometer import PlacedAccelerometer, place_accelerometer
from monitor_core.fitting.coordinates import is_spring
from monitor_core.fitting.description import AxisDescription
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.identification.answer import (
    IdentifiedJoints,
    further_positions,
    held_out_errors,
    joints_of_fit,
    known_sums,
    quality_of,
    what_is_not_identifiable,
)
from monitor_core.identification.cases import (
    Case,
    PeakCase,
    positions_of,
    require_positions,
)
from monitor_core.identification.joint_fit import JointFit, JointFitSettings, fit_joints
from monitor_core.identification.predicted_calibration import predicted_calibration
from monitor_core.identification.question import (
    IdentifyOptions,
    Observations,
    Question,
    at_one_preload,
    by_kind,
    of_papers,
    question_of,
)
from monitor_core.identification.sensitivity import Detectability, modes_to_monitor
from monitor_core.models.protocol import MotorEnd, ResponsePoint, motor_end_of
from monitor_core.models.published.receptance import ReceptanceParameters
from monitor_core.preload import Calibration

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
    """
    options, axis = options or IdentifyOptions(), axis.with_corrected_parameters()
    question = _identifiable(axis, observations, options)  # before the accelerometer is placed, which takes seconds
    placed = _placed(axis, observations, options, map_function)
    if placed.observations:
        observations = placed.observations
        question = question_of(axis, observations, options)
    _require_poles_of_the_nut(axis, observations, options)
    found = fit_joints(
        question.case,
        question.bounds,
        JointFitSettings(options.seed, uncertainties_stated=question.stated),
        hold_out=options.hold_out,
        map_function=map_function,
        progress=progress,
    )
    values = question.case.drive.values(found.fit.coordinates.values)
    model = replace(axis, parameters=values, uncertain={})  # what was uncertain rests on these data now
    return IdentifiedJoints(
        joints=joints_of_fit(found),
        correlations=found.judged.correlations,
        not_identifiable=(*what_is_not_identifiable(found), *map(_stays_as_stated, question.unseen)),
        sums=known_sums(found),
        quality=quality_of(found, question.case),
        held_out=held_out_errors(found),
        missing_modes=_missing_modes(question.case),
        next_positions=further_positions(question.case, found, axis.parameters["screw_length_m"]),
        modes_to_monitor=_modes_to_monitor(model, question.case, observations),
        assumptions=(*placed.sentences, *options.assumptions),
        calibration=_calibration(options, question.case, found),
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


def _calibration(options: IdentifyOptions, case: Case, found: JointFit) -> Calibration | None:
    if options.prediction is None or found.lack_of_fit:  # its covariance would not hold what the model leaves out
        return None
    measured = positions_of(case)
    span = measured[0], measured[-1]
    return predicted_calibration(options.prediction, case.drive.model, found.fit.coordinates, span)
