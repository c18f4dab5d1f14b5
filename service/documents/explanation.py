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
    against_screw_sentence,
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
from service.documents.measurement import finite_or_null, members
from service.json_types import JsonObject


def explanation_document(explanation: Explanation, model_text: str) -> JsonObject:
    """Return the whole answer except its pictures, with the augmented drive model as TOML.

    A number that is not known is ``null``.
    """
    unfinished, against = explanation.unfinished, explanation.against_screw
    return finite_or_null({
        "outcome": explanation.outcome,
        "effects": [_effect(effect) for effect in explanation.effects],
        "localisation": [_misfit(misfit) for misfit in explanation.localisation],
        "remainder": [_misfit(misfit) for misfit in explanation.remainder],
        "gap": asdict(explanation.gap),
        "gap_by_channel": {
            name: {"before": before, "after": after} for name, (before, after) in explanation.gap_by_channel.items()
        },
        "steps": [
            {"effect": " + ".join(step.effects), "gap_held_out": step.gap.held_out, "gap_fit": step.gap.fit}
            for step in explanation.steps
        ],
        "candidates": [_candidate(candidate) for candidate in explanation.candidates],
        **members(explanation, "least_delta_bic", "pulls", "pulls_before"),
        "maps": [_map(shown) for shown in explanation.maps],
        "described": [_described(description) for description in explanation.described],
        "against_screw": against
        and {**members(against, "objection", "values"), "sentence": against_screw_sentence(against)},
        "records": [_record(record) for record in explanation.records],
        "taken_as": list(assumption_sentences(explanation)),
        "unfinished": None if unfinished is None else unfinished_sentence(unfinished, KEYS),
        "next_measurement": next_measurement(explanation.next_steps),
        "next_steps": [
            asdict(step) | {"sentence": step_sentence(step, KEYS)} for step in explanation.next_steps
        ],
        "model": model_text,
    })  # fmt: skip


def _effect(effect: FoundEffect) -> dict[str, object]:
    return {
        **members(effect, "key", "name", "physics"),
        "parameters": {name: _parameter(parameter) for name, parameter in effect.parameters.items()},
        **members(effect, "equivalent_to", "plausible"),
        "evidence": members(effect, "delta_bic", "held_out_log_likelihood_gain"),
        "remarks": list(remarks(effect, KEYS)),
    }


def _described(described: Described) -> dict[str, object]:
    """Return what was described; ``varies_with`` and ``form`` say what the parameter is multiplied by.

    Without a law it is an impedance, with its own ``parameters``, or has no form: ``factors`` are of each setting.
    """
    parameters, law = {name: _parameter(value) for name, value in described.parameters.items()}, described.law
    return {
        "place": "screw" if described.place == Place.SCREW_END else described.place,
        "parameter": described.parameter,
        "varies_with": "none" if law is None else law.variable,
        "law": law and {"form": law.form, "parameters": parameters, **members(law, "reference", "scale", "knots")},
        "parameters": parameters if law is None else {},
        **members(described, "factors", "frequency_hz", "mass_kg", "inertia_kg_m2"),
        "not_distinguished_from": [alternative_sentence(other, KEYS) for other in described.alternatives],
        "share_of_free_variation": described.share,
        "effects": [effect.key for effect in described.effects],
        "evidence": members(described, "delta_bic", "held_out_log_likelihood_gain"),
    }


def _parameter(parameter: FoundParameter) -> dict[str, object]:
    return {
        **members(parameter.estimate, "value", "standard_uncertainty"),
        **members(parameter, "unit", "interval_95", "plausible", "at_end"),
    }


def _misfit(misfit: Misfit) -> dict[str, object]:
    where = place_sentence(misfit.place, KEYS)
    return {"where": where, "misfit": misfit.size, **members(misfit, "kind", "p_value")}


def _record(record: WrongRecord) -> dict[str, object]:
    return {
        "record": f"conditions/{record.observations[0]:04d}",
        "number": record.number,
        "responses": record.observations,
        "setting": record.setting,
        "kind": record.fault,
        **members(record, "stated", "found", "standard_uncertainty", "unit", "delta_bic", "misfit"),
    }


def _candidate(candidate: Candidate) -> dict[str, object]:
    return {
        **members(candidate, "key", "delta_bic", "held_out", "detection_limit"),
        "detection_limit_unit": candidate.unit,
        "untestable_because": None if candidate.untested is None else untested_sentence(candidate.untested),
    }


def _map(shown: MisfitMap) -> dict[str, object]:
    return {
        "title": map_title(shown.over),
        "rows": [extent_by_key(row) for row in shown.rows],
        "columns": [extent_by_key(column) for column in shown.columns],
        **members(shown, "before", "after"),
    }
