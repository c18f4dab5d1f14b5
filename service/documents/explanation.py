"""Write an explanation as JSON: the answer of ``preload explain``."""

from dataclasses import asdict

from monitor_core.discrepancy import (
    Candidate,
    Described,
    Explanation,
    FoundEffect,
    FoundParameter,
    Misfit,
    MisfitMap,
    Place,
    WrongRecord,
)
from service.documents.explanation_sentences import (
    KEYS,
    alternative_sentence,
    assumption_sentences,
    extent_by_key,
    map_title,
    next_measurement,
    place_sentence,
    remarks,
    step_sentence,
    unfinished_sentence,
    untested_sentence,
)
from service.documents.measurement import finite_or_null
from service.json_types import JsonObject


def explanation_document(explanation: Explanation, model_text: str) -> JsonObject:
    """Return the whole answer except its pictures, with the augmented drive model as TOML.

    A number that is not known is ``null``.
    """
    gap, unfinished = explanation.gap, explanation.unfinished
    return finite_or_null({
        "outcome": str(explanation.outcome),
        "effects": [_effect(found) for found in explanation.effects],
        "localisation": [_misfit(misfit) for misfit in explanation.localisation],
        "remainder": [_misfit(misfit) for misfit in explanation.remainder],
        "gap": {
            "unit": gap.unit,
            "noise_floor": float(gap.noise_floor),
            "before": asdict(gap.before),
            "after": asdict(gap.after),
        },
        "gap_by_channel": {
            name: {"before": float(before), "after": float(after)}
            for name, (before, after) in explanation.gap_by_channel.items()
        },
        "steps": [
            {
                "effect": " + ".join(step.effects),
                "gap_held_out": float(step.gap.held_out),
                "gap_fit": float(step.gap.fit),
            }
            for step in explanation.steps
        ],
        "candidates": [_candidate(candidate) for candidate in explanation.candidates],
        "least_delta_bic": float(explanation.least_delta_bic),
        "pulls": {name: float(pull) for name, pull in explanation.pulls.items()},
        "pulls_before": {name: float(pull) for name, pull in explanation.pulls_before.items()},
        "maps": [_map(shown) for shown in explanation.maps],
        "described": [_described(found) for found in explanation.described],
        "hidden_in_remainder": list(explanation.hidden_in_remainder),
        "records": [_record(record) for record in explanation.records],
        "taken_as": list(assumption_sentences(explanation)),
        "unfinished": None if unfinished is None else unfinished_sentence(unfinished, KEYS),
        "next_measurement": next_measurement(explanation.next_steps),
        "next_steps": [
            asdict(step) | {"sentence": step_sentence(step, KEYS)} for step in explanation.next_steps
        ],
        "model": model_text,
    })  # fmt: skip


def _effect(effect: FoundEffect) -> JsonObject:
    return {
        "key": effect.key,
        "name": effect.name,
        "physics": effect.physics,
        "parameters": {name: _parameter(parameter) for name, parameter in effect.parameters.items()},
        "equivalent_to": list(effect.equivalent_to),
        "plausible": bool(effect.plausible),
        "evidence": {
            "delta_bic": float(effect.delta_bic),
            "held_out_log_likelihood_gain": float(effect.held_out_log_likelihood_gain),
        },
        "remarks": list(remarks(effect, KEYS)),
    }


def _described(described: Described) -> JsonObject:
    """Return what was described; ``varies_with`` and ``form`` say what the parameter is multiplied by.

    Without a law it is an impedance, with its own ``parameters``, or has no form: ``factors`` are of each setting.
    """
    parameters, law = {name: _parameter(value) for name, value in described.parameters.items()}, described.law
    return {
        "place": "screw" if described.place == Place.SCREW_END else described.place,
        "parameter": described.parameter,
        "varies_with": "none" if law is None else str(law.variable),
        "law": None if law is None else {
            "form": str(law.form),
            "parameters": parameters,
            "reference": float(law.reference),
            "scale": float(law.scale),
        },
        "parameters": parameters if law is None else {},
        "factors": {name: float(factor) for name, factor in described.factors.items()},
        "frequency_hz": described.frequency_hz,
        "mass_kg": described.mass_kg,
        "inertia_kg_m2": described.inertia_kg_m2,
        "not_distinguished_from": [alternative_sentence(other, KEYS) for other in described.alternatives],
        "share_of_free_variation": float(described.share),
        "effects": [effect.key for effect in described.effects],
        "evidence": {
            "delta_bic": float(described.delta_bic),
            "held_out_log_likelihood_gain": float(described.held_out_log_likelihood_gain),
        },
    }  # fmt: skip


def _parameter(parameter: FoundParameter) -> JsonObject:
    return {
        "value": float(parameter.estimate.value),
        "standard_uncertainty": float(parameter.estimate.standard_uncertainty),
        "unit": parameter.unit,
        "interval_95": [float(end) for end in parameter.interval_95],
        "plausible": bool(parameter.plausible),
        "at_end": bool(parameter.at_end),
    }


def _misfit(misfit: Misfit) -> JsonObject:
    return {
        "where": place_sentence(misfit.place, KEYS),
        "misfit": float(misfit.size),
        "kind": str(misfit.kind),
        "p_value": float(misfit.p_value),
    }


def _record(record: WrongRecord) -> JsonObject:
    return {
        "record": f"conditions/{record.observations[0]:04d}",
        "number": record.number,
        "responses": list(record.observations),
        "setting": record.setting,
        "kind": str(record.fault),
        "stated": float(record.stated),
        "found": float(record.found),
        "standard_uncertainty": float(record.standard_uncertainty),
        "unit": record.unit,
        "delta_bic": float(record.delta_bic),
        "misfit": float(record.misfit),
    }


def _candidate(candidate: Candidate) -> JsonObject:
    return {
        "key": candidate.key,
        "delta_bic": float(candidate.delta_bic),
        "held_out": float(candidate.held_out),
        "detection_limit": None if candidate.detection_limit is None else float(candidate.detection_limit),
        "detection_limit_unit": candidate.unit,
        "untestable_because": None if candidate.untested is None else untested_sentence(candidate.untested),
    }


def _map(shown: MisfitMap) -> JsonObject:
    return {
        "title": map_title(shown.over),
        "rows": [extent_by_key(row) for row in shown.rows],
        "columns": [extent_by_key(column) for column in shown.columns],
        "before": shown.before.tolist(),
        "after": shown.after.tolist(),
    }
