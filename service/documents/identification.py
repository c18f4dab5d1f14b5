"""How an identification is laid out: the JSON of ``preload identify`` and of a job of kind ``identification``."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor_core.identification.advice import next_positions
from monitor_core.identification.cases import Case, PeakCase, PredictionError, ResponseCase
from monitor_core.identification.identifiability import CoordinateJudgement, Verdict
from monitor_core.identification.identify import Identification
from monitor_core.identification.model_cases import ModelResponseCase
from monitor_core.identification.sensitivity import Detectability
from monitor_core.models.parameters import PARAMETERS, name_in_file
from monitor_core.recordings.elements.units import to_millimetres

#: Units of what may be free, by its names in files.
_UNITS = {name_in_file(word.name): word.unit for word in PARAMETERS}
_NUT = "nut_stiffness_n_per_m"
#: Relative standard uncertainty up to which a sum is worth stating beside parts that are not told apart.
_WELL_KNOWN = 0.1
#: Share of the starts that must reach the optimum, or it is not to be relied on.
_LEAST_AGREEMENT = 1.0 / 3.0


def identification_document(
    found: Identification, case: Case, names: Sequence[str], screw_length: float
) -> dict[str, Any]:
    """Lay out joints, verdicts and advice.

    Parameters
    ----------
    found : Identification
    case : Case
        What it rests on.
    names : sequence of str
        Of the coordinates, in files.
    screw_length : float
        [m]
    """
    judged = dict(zip(found.fit.names, names, strict=True))
    relied_on = found.search.agreement() >= _LEAST_AGREEMENT
    inseparable = {name for pair in found.judged.pairs for name in (pair.first, pair.second)}
    return {
        "parameters": {judged[one.name]: _parameter(one, judged[one.name]) for one in found.judged.coordinates},
        "identifiable": {
            judged[one.name]: relied_on and one.verdict is not Verdict.NOT_DETERMINED and one.name not in inseparable
            for one in found.judged.coordinates
        },
        "not_identifiable": _sentences(found, judged),
        "sums": _sums(found, judged),
        "correlations": {"names": list(names), "matrix": found.judged.correlations.tolist()},
        "objective": _objective(case, found),
        "held_out": _held_out(found),
        "missing_modes": [one.sentence for one in case.assignment.missing] if isinstance(case, PeakCase) else [],
        "next_positions": _next_positions(case, found, names, screw_length),
    }


def _parameter(one: CoordinateJudgement, name: str) -> dict[str, Any]:
    value = 10.0**one.value
    lower, upper = one.interval.lower, one.interval.upper
    return {
        "value": value,
        "standard_uncertainty": value * np.log(10.0) * one.standard_uncertainty,
        "unit": _UNITS[name],
        "interval_95": [_power(lower), _power(upper)],
        "interval_kind": "linear in the logarithm" if one.profile is None else "profile of χ²",
        "verdict": str(one.verdict),
        "at_limit": one.at_bound,
    }


def _power(logarithm: float) -> float:
    return float(10.0 ** np.clip(logarithm, -300.0, 300.0))


def _sentences(found: Identification, names: Mapping[str, str]) -> list[str]:
    """Say what the data do not determine: single joints, pairs, and directions."""
    judged, agreement = found.judged, found.search.agreement()
    sentences = [
        f"{names[one.name]} is not determined by these data" + (": it ended at its limit" if one.at_bound else "")
        for one in judged.coordinates
        if one.verdict is Verdict.NOT_DETERMINED
    ]
    sentences += [
        f"{names[pair.first]} and {names[pair.second]} are not told apart: their correlation is {pair.correlation:.3f}"
        for pair in judged.pairs
    ]
    if agreement < _LEAST_AGREEMENT:
        sentences.append(
            f"only {agreement:.0%} of the starts reached this optimum: another seed may find a better one, and "
            "nothing of this one is to be relied on"
        )
    if found.lack_of_fit:
        sentences.append(
            "the model misses the data by more than their uncertainties; no interval holds what it leaves out"
        )
    if judged.better_exists:
        sentences.append("a better fit exists than the search found: search again with another seed")
    return sentences


def _sums(found: Identification, names: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the sums of stiffnesses, or of dampings, that are known better than their parts."""
    fit = found.fit
    sums = []
    for pair in found.judged.pairs:
        places = [fit.names.index(name) for name in (pair.first, pair.second)]
        if pair.correlation > 0.0 or _UNITS[names[pair.first]] != _UNITS[names[pair.second]]:
            continue
        values = 10.0 ** fit.coordinates.values[places]
        gradient = np.zeros(len(fit.names))
        gradient[places] = np.log(10.0) * values
        value, uncertainty = float(values.sum()), fit.standard_uncertainty_of(gradient)
        if uncertainty > _WELL_KNOWN * value:
            continue
        sums.append(
            {
                "of": [names[pair.first], names[pair.second]],
                "value": value,
                "standard_uncertainty": uncertainty,
                "unit": _UNITS[names[pair.first]],
            }
        )
    return sums


def _objective(case: Case, found: Identification) -> dict[str, Any]:
    fit = found.fit
    document: dict[str, Any] = {
        "kind": "whole responses" if isinstance(case, ResponseCase | ModelResponseCase) else "peaks",
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "residual_standard_deviation": float(np.sqrt(fit.chi_squared / max(fit.degrees_of_freedom, 1))),
        "lack_of_fit": found.lack_of_fit,
        "starts": len(found.search.fits) + len(found.search.failed),
        "starts_agreeing": found.search.agreement(),
        "evaluations": found.search.n_evaluations,
        "seed": found.seed,
        "positions_mm": [to_millimetres(one) for one in found.trained_on],
    }
    if isinstance(case, PeakCase):
        document["eq_26"] = case.paper_objective(fit.coordinates.values, found.trained_on)
    return document


def _held_out(found: Identification) -> dict[str, Any] | None:
    worst = found.worst_held_out
    if worst is None:
        return None
    return {
        "kind": "leave one position out" if found.leave_one_out else "positions not used",
        "quantity": "frequency of the peak" if worst.mode is not None else "ln of the response, root mean square",
        "worst_percent": 100.0 * abs(worst.relative_error),
        "errors": [_prediction_error(one) for one in found.held_out],
        "not_held_out_mm": [to_millimetres(one) for one in found.not_held_out],
    }


def _prediction_error(one: PredictionError) -> dict[str, Any]:
    return {
        "position_mm": to_millimetres(one.conditions.position),
        "preload_n": one.conditions.preload,
        "mode": one.mode,
        "measured_hz": one.measured,
        "predicted_hz": one.predicted,
        "error_percent": 100.0 * one.relative_error,
    }


def modes_to_monitor_document(ranked: Sequence[Detectability]) -> list[dict[str, Any]]:
    """Lay out which mode shows a loss of preload where, the best first."""
    return [
        {
            "mode": one.peak.mode,
            "position_mm": to_millimetres(one.peak.conditions.position),
            "frequency_hz": one.peak.frequency,
            "sensitivity": one.peak.of_frequency,
            "relative_frequency_uncertainty": one.relative_frequency_uncertainty,
            "minimum_detectable_preload_loss": one.preload_loss,
        }
        for one in ranked
    ]


def _next_positions(
    case: Case, found: Identification, names: Sequence[str], screw_length: float
) -> list[dict[str, Any]]:
    """Rank by the nut where it is free: it is what the axis is watched for."""
    scale = float(np.sqrt(found.fit.residual_variance)) * np.log(10.0)
    ranked = next_positions(case, found.fit, screw_length, names.index(_NUT) if _NUT in names else None)
    return [
        {
            "position_mm": to_millimetres(one.conditions.position),
            "relative_standard_uncertainties": dict(
                zip(names, (scale * one.standard_uncertainties).tolist(), strict=True)
            ),
        }
        for one in ranked
    ]
