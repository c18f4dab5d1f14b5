"""Read and write a calibration as a JSON document, with the unit of every number in its key.

Numbers that follow from others (``moving_mass_kg``, ``minimum_detectable_loss_n``) are written for people and scripts
and not read back; unknown keys are left alone. ``prior`` names what k1…k4 rest on besides the readings; only then may
``n_readings`` be 0, the residuals null, and ``degrees_of_freedom`` null, which stands for infinite.
"""

import json
import math
from pathlib import Path

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.modal import PhaseReference
from monitor_core.preload.calibration import (
    COEFFICIENT_NAMES,
    INVERSE_MOVING_MASS,
    TEMPERATURE_COEFFICIENT,
    Calibration,
    PositionError,
    ValidRange,
    Weighting,
    minimum_detectable_loss,
)
from monitor_core.preload.verification import verify_calibration
from monitor_core.preload.witnesses import TERMS, Witness, WitnessName
from monitor_core.recording import ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.recordings.elements.fields import Fields, json_list, json_numbers, json_object, json_table
from monitor_core.recordings.elements.files import naming, read_text
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.recordings.session_hdf5 import EXCITATION_UNIT
from monitor_core.uncertainty import Estimate, VectorEstimate

FORMAT, VERSION = "preload-calibration", 1
#: k1…k4 with their units, by name.
COEFFICIENT_KEYS = dict(zip(COEFFICIENT_NAMES, ("k1_s2_per_m2", "k2_s2_per_m", "k3_s2_n13", "k4_s2"), strict=True))
_INFLUENCE_KEYS = {
    INVERSE_MOVING_MASS: "inverse_moving_mass_per_kg",
    TEMPERATURE_COEFFICIENT: "temperature_coefficient_s2_per_k",
}
_PARAMETER_KEYS = {**COEFFICIENT_KEYS, **_INFLUENCE_KEYS}
_PARAMETER_NAMES = {key: name for name, key in _PARAMETER_KEYS.items()}
EXCITATION_LEVEL_UNITS: dict[ExcitationQuantity | None, str | None] = {
    None: None, **{quantity: f"{unit}/Hz^0.5" for quantity, unit in EXCITATION_UNIT.items()},
}  # fmt: skip


def calibration_document(calibration: Calibration) -> dict[str, object]:
    """Lay out a calibration as a document of finite numbers, texts, lists and ``None``.

    It is ready for :func:`json.dumps`, and :func:`calibration_from_document` reads it back. ``OutsideValidityError`` if
    it does not answer within its calibrated ranges (:mod:`monitor_core.preload.verification`).
    """
    verify_calibration(calibration)
    values = dict(zip(calibration.parameter_names, calibration.parameters.values.tolist(), strict=True))
    mass, phase = calibration.moving_mass, calibration.phase_reference
    position, temperature = calibration.position, calibration.temperature
    friction = calibration.friction
    dof, mass_dof = calibration.parameters.degrees_of_freedom, calibration.moving_mass_dof
    return {
        "format": FORMAT,
        "version": VERSION,
        "coefficients": {key: values[name] for name, key in COEFFICIENT_KEYS.items()},
        **{key: values.get(name) for name, key in _INFLUENCE_KEYS.items()},
        "covariance": calibration.parameters.covariance.tolist(),
        "covariance_order": [_PARAMETER_KEYS[name] for name in calibration.parameter_names],
        "degrees_of_freedom": dof if math.isfinite(dof) else None,
        "declared": [_PARAMETER_KEYS[name] for name in calibration.declared],
        "moving_mass_kg": mass.value if mass else None,
        "moving_mass_standard_uncertainty_kg": mass.standard_uncertainty if mass else None,
        "moving_mass_degrees_of_freedom": mass_dof if math.isfinite(mass_dof) else None,
        "reference_payload_kg": calibration.reference_payload,
        "reference_temperature_c": calibration.reference_temperature,
        "residual_rms_hz": calibration.residual_rms,
        "residual_max_hz": calibration.residual_max,
        "residual_sd_hz": calibration.residual_sd,
        "reproducibility_hz": calibration.reproducibility,
        "condition_number": calibration.condition_number,
        "minimum_detectable_loss_n": minimum_detectable_loss(calibration),
        "leave_one_position_out": [
            {
                "position_mm": to_millimetres(error.position),
                "frequency_error_rms_hz": error.frequency_error_rms,
                "preload_error_rms_n": error.preload_error_rms,
            }
            for error in calibration.leave_one_position_out
        ],
        "weighting": calibration.weighting.value,
        "n_readings": calibration.n_readings,
        "valid_range": {
            "position_mm": [to_millimetres(position.lower), to_millimetres(position.upper)],
            "preload_n": [calibration.preload.lower, calibration.preload.upper],
            "payload_kg": [calibration.payload.lower, calibration.payload.upper],
            "temperature_c": None if temperature is None else [temperature.lower, temperature.upper],
        },
        "excitation_source": calibration.excitation_source,
        "excitation_quantity": calibration.excitation_quantity,
        "response_quantity": calibration.response_quantity,
        "maximum_modes": calibration.maximum_modes,
        "phase_reference": None if phase is None else {"polarity": phase.polarity, "delay_s": phase.delay},
        "uncertainty_stated": calibration.uncertainty_stated,
        "excitation_level": calibration.excitation_level,
        "excitation_level_unit": EXCITATION_LEVEL_UNITS[calibration.excitation_quantity],
        "prior": calibration.prior,
        "witnesses": [_witness_document(witness) for witness in calibration.witnesses],
        "friction_coefficient_s2_per_nm": friction.value if friction else None,
        "friction_coefficient_standard_uncertainty_s2_per_nm": friction.standard_uncertainty if friction else None,
        "between_sessions_relative": calibration.between_sessions,
        "payload_stated": calibration.payload_stated,
        "trace_polarity": calibration.trace_polarity,
    }


def _witness_document(witness: Witness) -> dict[str, object]:
    """Lay out what is usual of a witness: the regression of its logarithm (``preload.witnesses``)."""
    dof = witness.coefficients.degrees_of_freedom
    return {
        "name": witness.name.value,
        "unit_of_value": "SI",
        "terms": list(witness.terms),
        "coefficients": witness.coefficients.values.tolist(),
        "covariance": witness.coefficients.covariance.tolist(),
        "degrees_of_freedom": dof,
        "scatter": witness.scatter,
    }


def calibration_from_document(document: object, where: str = "calibration") -> Calibration:
    """Read what :func:`calibration_document` wrote, from a parsed JSON document that messages call ``where``.

    The calibration is the one written, up to the rounding of millimetres; ``RecordingFormatError`` if anything does not
    fit, in one sentence. That it answers is verified when it comes in (:func:`read_calibration`) or is written: one
    that is stored already stays readable.
    """
    top = json_object(document, where)
    top.require_format(FORMAT, VERSION)
    with naming(where):
        return _calibration(top)


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration as a JSON file."""
    path.write_text(json.dumps(calibration_document(calibration), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_calibration(path: Path) -> Calibration:
    """Read a calibration that :func:`write_calibration` or ``preload calibrate --json`` wrote.

    ``RecordingFormatError`` if the file is no JSON document, does not fit, or holds a calibration that does not answer
    within its own ranges (:mod:`monitor_core.preload.verification`).
    """
    text = read_text(path)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecordingFormatError(f"{path.name}: expected a JSON document; {error}") from error
    calibration = calibration_from_document(document, path.name)
    with naming(path.name):
        verify_calibration(calibration)
    return calibration


def _calibration(top: Fields) -> Calibration:
    coefficients, ranges = json_table(top, "coefficients"), json_table(top, "valid_range")
    values = {key: coefficients.number(key, "SI") for key in COEFFICIENT_KEYS.values()}
    values.update({key: top.number(key, "SI") for key in _INFLUENCE_KEYS.values() if key in top})
    order = _keys(top, "covariance_order")
    if sorted(order) != sorted(values):
        raise RecordingFormatError(
            f"{top.where}, covariance_order: expected {', '.join(values)}; got {', '.join(order)}"
        )
    position = _range(ranges, "position_mm", "mm")
    on_prior = "prior" in top
    without_readings = on_prior and top.number("n_readings", "-") == 0.0
    return Calibration(
        parameters=VectorEstimate(
            np.array([values[key] for key in order]),
            _covariance(top, len(order)),
            math.inf if on_prior and "degrees_of_freedom" not in top else top.positive("degrees_of_freedom", "-"),
        ),
        parameter_names=tuple(_PARAMETER_NAMES[key] for key in order),
        declared=tuple(_PARAMETER_NAMES[key] for key in _keys(top, "declared")),
        reproducibility=top.not_negative("reproducibility_hz", "Hz"),
        residual_sd=top.not_negative("residual_sd_hz", "Hz"),
        residual_rms=None if without_readings else top.not_negative("residual_rms_hz", "Hz"),
        residual_max=None if without_readings else top.not_negative("residual_max_hz", "Hz"),
        condition_number=top.positive("condition_number", "-"),
        leave_one_position_out=_position_errors(top),
        weighting=top.choice("weighting", Weighting),
        n_readings=0 if without_readings else top.count("n_readings"),
        position=ValidRange(metres(position.lower), metres(position.upper)),
        preload=_range(ranges, "preload_n", "N"),
        payload=_range(ranges, "payload_kg", "kg"),
        temperature=_range(ranges, "temperature_c", "°C") if "temperature_c" in ranges else None,
        reference_payload=top.not_negative("reference_payload_kg", "kg"),
        reference_temperature=top.optional_number("reference_temperature_c", "°C"),
        excitation_source=top.optional_choice("excitation_source", ExcitationSource),
        excitation_quantity=top.optional_choice("excitation_quantity", ExcitationQuantity),
        response_quantity=top.optional_choice("response_quantity", ResponseQuantity),
        maximum_modes=top.count("maximum_modes"),
        phase_reference=_phase_reference(top),
        moving_mass_dof=top.optional_number("moving_mass_degrees_of_freedom", "-") or math.inf,
        uncertainty_stated=top.values["uncertainty_stated"] is True if "uncertainty_stated" in top else True,
        excitation_level=top.optional_number("excitation_level", "its unit"),
        prior=top.text("prior") if on_prior else None,
        witnesses=_witnesses(top),
        friction=_friction(top),
        between_sessions=top.not_negative("between_sessions_relative", "-")
        if "between_sessions_relative" in top
        else 0.0,
        payload_stated=top.values.get("payload_stated") is True,
        trace_polarity=_trace_polarity(top),
    )


def _trace_polarity(top: Fields) -> int | None:
    """Read which way the torque drove the position trace; earlier versions did not look."""
    polarity = top.optional_number("trace_polarity", "-")
    if polarity not in (None, -1.0, 1.0):
        raise RecordingFormatError(f"{top.where}, trace_polarity: expected 1, -1 or null; got {polarity:g}")
    return None if polarity is None else int(polarity)


def _witnesses(top: Fields) -> tuple[Witness, ...]:
    """Read what is usual of each witness; earlier versions wrote none."""
    if "witnesses" not in top:
        return ()
    return tuple(_witness(json_object(value, f"{top.where}, witnesses")) for value in json_list(top, "witnesses"))


def _witness(fields: Fields) -> Witness:
    terms = tuple(str(term) for term in json_list(fields, "terms"))
    if not terms or (unknown := [term for term in terms if term not in TERMS]):
        got = repr(unknown[0]) if terms else "none"
        raise RecordingFormatError(f"{fields.where}, terms: expected some of {', '.join(TERMS)}; got {got}")
    values = json_numbers(json_list(fields, "coefficients"), len(terms), f"{fields.where}, coefficients")
    return Witness(
        fields.choice("name", WitnessName),
        terms,
        VectorEstimate(np.array(values), _covariance(fields, len(terms)), fields.positive("degrees_of_freedom", "-")),
        fields.positive("scatter", "-"),
    )


def _friction(top: Fields) -> Estimate | None:
    if "friction_coefficient_s2_per_nm" not in top:
        return None
    uncertainty = top.not_negative("friction_coefficient_standard_uncertainty_s2_per_nm", "s²/(N·m)")
    return Estimate(top.number("friction_coefficient_s2_per_nm", "s²/(N·m)"), uncertainty)


def _keys(fields: Fields, name: str) -> list[str]:
    keys = [str(key) for key in json_list(fields, name)]
    if unknown := [key for key in keys if key not in _PARAMETER_NAMES]:
        raise RecordingFormatError(
            f"{fields.where}, {name}: expected some of {', '.join(_PARAMETER_NAMES)}; got {unknown[0]!r}"
        )
    return keys


def _covariance(fields: Fields, n: int) -> FloatArray:
    rows, place = json_list(fields, "covariance"), f"{fields.where}, covariance"
    if len(rows) != n:
        raise RecordingFormatError(f"{place}: expected {n} rows as in covariance_order; got {len(rows)}")
    matrix = np.array([json_numbers(row, n, place) for row in rows])
    # what is fixed has no variance, and so no covariance either: over the smallest scale any would be too large
    scale = np.maximum(np.sqrt(np.abs(np.diag(matrix))), np.finfo(np.float64).tiny)
    with np.errstate(over="ignore"):
        correlation = np.clip(matrix / scale / scale[:, np.newaxis], -1e9, 1e9)
    asymmetry, least = float(np.ptp([correlation, correlation.T], axis=0).max()), np.linalg.eigvalsh(correlation)[0]
    # rounding of a nearly dependent fit leaves eigenvalues a little below zero
    if asymmetry > 1e-5 or least < -1e-9:
        raise RecordingFormatError(
            f"{place}: expected a symmetric matrix without negative variances; got correlations that differ by "
            f"{asymmetry:.2g} across the diagonal, with {least:.2g} as the smallest eigenvalue"
        )
    return matrix


def _range(fields: Fields, name: str, unit: str) -> ValidRange:
    lower, upper = json_numbers(json_list(fields, name), 2, f"{fields.where}, {name}")
    if lower > upper:
        raise RecordingFormatError(f"{fields.where}, {name}: expected [lower, upper]; got [{lower}, {upper}] {unit}")
    return ValidRange(lower, upper)


def _position_errors(top: Fields) -> tuple[PositionError, ...]:
    name = "leave_one_position_out"
    entries = [json_object(value, f"{top.where}, {name}") for value in json_list(top, name)]
    return tuple(
        PositionError(
            metres(entry.number("position_mm", "mm")),
            entry.not_negative("frequency_error_rms_hz", "Hz"),
            entry.optional_number("preload_error_rms_n", "N"),
        )
        for entry in entries
    )


def _phase_reference(top: Fields) -> PhaseReference | None:
    if "phase_reference" not in top:
        return None
    fields = json_table(top, "phase_reference")
    return PhaseReference(int(fields.number("polarity", "-")), fields.number("delay_s", "s"))
