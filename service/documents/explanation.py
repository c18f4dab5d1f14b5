"""How an explanation is laid out: the JSON of ``preload explain``."""

from collections.abc import Mapping
from typing import Any

from monitor_core.discrepancy.explanation import (
    Candidate,
    Explanation,
    FoundEffect,
    FoundParameter,
    GapPair,
    Misfit,
    MisfitMap,
)
from service.documents.measurement import finite_or_null


def explanation_document(explanation: Explanation, model_text: str) -> dict[str, Any]:
    """Lay out the whole answer but its pictures; a number that is not known is ``null``.

    Parameters
    ----------
    explanation : Explanation
    model_text : str
        The augmented drive model, as TOML.
    """
    gap = explanation.gap
    document: Mapping[str, Any] = finite_or_null({
        "outcome": str(explanation.outcome),
        "effects": [_effect(one) for one in explanation.effects],
        "localisation": [_misfit(one) for one in explanation.localisation],
        "remainder": [_misfit(one) for one in explanation.remainder],
        "gap": {
            "unit": gap.unit,
            "noise_floor": float(gap.noise_floor),
            "before": _pair(gap.before),
            "after": _pair(gap.after),
        },
        "gap_by_channel": {
            name: {"before": float(before), "after": float(after)}
            for name, (before, after) in explanation.gap_by_channel.items()
        },
        "steps": [
            {
                "effect": one.effect,
                "gap_held_out": float(one.gap.held_out),
                "gap_fit": float(one.gap.fit),
            }
            for one in explanation.steps
        ],
        "candidates": [_candidate(one) for one in explanation.candidates],
        "least_delta_bic": float(explanation.least_delta_bic),
        "pulls": {name: float(pull) for name, pull in explanation.pulls.items()},
        "pulls_before": {name: float(pull) for name, pull in explanation.pulls_before.items()},
        "maps": [_map(one) for one in explanation.maps],
        "hidden_in_remainder": list(explanation.hidden_in_remainder),
        "taken_as": list(explanation.taken_as),
        "next_measurement": explanation.next_measurement,
        "model": model_text,
    })  # fmt: skip
    return dict(document)


def _effect(one: FoundEffect) -> dict[str, Any]:
    return {
        "key": one.key,
        "name": one.name,
        "physics": one.physics,
        "parameters": {name: _parameter(found) for name, found in one.parameters.items()},
        "equivalent_to": list(one.equivalent_to),
        "plausible": bool(one.plausible),
        "evidence": {
            "delta_bic": float(one.delta_bic),
            "held_out_log_likelihood_gain": float(one.held_out_log_likelihood_gain),
        },
        "remarks": list(one.remarks),
    }


def _parameter(found: FoundParameter) -> dict[str, Any]:
    return {
        "value": float(found.estimate.value),
        "standard_uncertainty": float(found.estimate.standard_uncertainty),
        "unit": found.unit,
        "interval_95": [float(end) for end in found.interval_95],
        "plausible": bool(found.plausible),
        "at_end": bool(found.at_end),
    }


def _misfit(one: Misfit) -> dict[str, Any]:
    return {"where": one.where, "misfit": float(one.size), "kind": str(one.kind), "p_value": float(one.p_value)}


def _pair(pair: GapPair) -> dict[str, float]:
    return {"fit": float(pair.fit), "held_out": float(pair.held_out)}


def _candidate(one: Candidate) -> dict[str, Any]:
    return {
        "key": one.key,
        "delta_bic": float(one.delta_bic),
        "held_out": float(one.held_out),
        "detection_limit": None if one.detection_limit is None else float(one.detection_limit),
        "detection_limit_unit": one.unit,
        "untestable_because": one.untestable_because,
    }


def _map(one: MisfitMap) -> dict[str, Any]:
    return {
        "title": one.title,
        "rows": list(one.rows),
        "columns": list(one.columns),
        "before": one.before.tolist(),
        "after": one.after.tolist(),
    }
