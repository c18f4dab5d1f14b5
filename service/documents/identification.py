"""Lay out identified joints: the JSON of ``preload identify`` and of a job of kind ``identification``."""

from monitor_core.identification import (
    Detectability,
    DroppedPeak,
    FitQuality,
    FromPositions,
    FurtherPosition,
    HeldOutErrors,
    IdentifiedJoint,
    IdentifiedJoints,
    KnownSum,
    PredictionError,
    Weighting,
)
from monitor_core.recordings.calibration_file import calibration_document
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.model_file import model_file_text
from service.documents.measurement import finite_or_null, members
from service.json_types import JsonObject

#: What the objective may be, by its names on the wire and on the command line.
OBJECTIVES = {"weighted": Weighting.UNCERTAINTY, "eq-26": Weighting.UNIT}


def identification_document(identified: IdentifiedJoints) -> JsonObject:
    """Lay out joints, verdicts and advice; a number that is not known is ``null``."""
    return finite_or_null({
        "parameters": {name: _parameter(joint) for name, joint in identified.joints.items()},
        "identifiable": {name: joint.identifiable for name, joint in identified.joints.items()},
        "not_identifiable": identified.not_identifiable,
        "sums": [_sum(known) for known in identified.sums],
        "correlations": {"names": list(identified.joints), "matrix": identified.correlations},
        "objective": _objective(identified.quality),
        "held_out": None if identified.held_out is None else _held_out(identified.held_out),
        "robustness": [_from_positions(each) for each in identified.robustness],
        "missing_modes": identified.missing_modes,
        "dropped_peaks": [_dropped(peak) for peak in identified.dropped_peaks],
        "next_positions": [_further(there) for there in identified.next_positions],
        "taken_as": identified.assumptions,
        "modes_to_monitor": [_mode_to_monitor(mode) for mode in identified.modes_to_monitor],
        "calibration": None if identified.calibration is None else calibration_document(identified.calibration),
        "model": model_file_text(identified.model),
    })  # fmt: skip


def _parameter(joint: IdentifiedJoint) -> dict[str, object]:
    interval = joint.interval
    return {
        **members(joint.estimate, "value", "standard_uncertainty"),
        "unit": joint.unit,
        "interval_95": None if interval is None else [interval.lower, interval.upper],
        "interval_kind": "profile of χ²" if joint.from_profile else "linear in the logarithm",
        **members(joint, "verdict", "at_limit"),
    }


def _sum(known: KnownSum) -> dict[str, object]:
    return members(known, "of", "unit") | members(known.estimate, "value", "standard_uncertainty")


def _objective(quality: FitQuality) -> dict[str, object]:
    return {
        **members(quality, "kind", "chi_squared", "degrees_of_freedom", "residual_standard_deviation", "lack_of_fit"),
        **members(quality, "starts", "starts_agreeing", "evaluations", "seed"),
        "positions_mm": [to_millimetres(position) for position in quality.positions],
        **({} if quality.paper_objective is None else {"eq_26": quality.paper_objective}),
    }


def _held_out(held_out: HeldOutErrors) -> dict[str, object]:
    worst = held_out.worst
    return {
        "kind": held_out_kind(held_out),
        "quantity": "frequency of the peak" if worst.mode is not None else "ln of the response, root mean square",
        "worst_percent": 100.0 * abs(worst.relative_error),
        "errors": [_prediction_error(error) for error in held_out.errors],
        "not_held_out_mm": [to_millimetres(position) for position in held_out.not_held_out],
    }


def _from_positions(each: FromPositions) -> dict[str, object]:
    return {
        "from_mm": [to_millimetres(position) for position in each.positions],
        "parameters": dict(each.joints),
        "errors": [_prediction_error(error) for error in each.errors],
    }


def held_out_kind(held_out: HeldOutErrors) -> str:
    """Say in a few words what was held out."""
    return "leave one position out" if held_out.leave_one_out else "positions not used"


def _prediction_error(error: PredictionError) -> dict[str, object]:
    return {
        "position_mm": to_millimetres(error.conditions.position),
        "preload_n": error.conditions.preload,
        "mode": error.mode,
        "measured_hz": error.measured,
        "predicted_hz": error.predicted,
        "error_percent": 100.0 * error.relative_error,
    }


def _dropped(peak: DroppedPeak) -> dict[str, object]:
    elsewhere = peak.elsewhere
    return {
        "position_mm": to_millimetres(peak.observation.conditions.position),
        "frequency_hz": peak.observation.frequency,
        "reason": peak.sentence,
        "mode": peak.mode,
        "mode_hz": peak.mode_frequency,
        "from_mm": None if elsewhere is None else to_millimetres(elsewhere.conditions.position),
        "moved_hz": peak.moved,
        "mode_moves_hz": None if elsewhere is None else peak.mode_moves,
    }


def _further(there: FurtherPosition) -> dict[str, object]:
    return {
        "position_mm": to_millimetres(there.position),
        "relative_standard_uncertainties": dict(there.relative_uncertainties),
    }


def _mode_to_monitor(mode: Detectability) -> dict[str, object]:
    return {
        "mode": mode.peak.mode,
        "position_mm": to_millimetres(mode.peak.conditions.position),
        "frequency_hz": mode.peak.frequency,
        "sensitivity": mode.peak.of_frequency,
        "relative_frequency_uncertainty": mode.relative_frequency_uncertainty,
        "minimum_detectable_preload_loss": mode.preload_loss,
    }
