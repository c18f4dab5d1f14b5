"""The report says what the record says: keys of the contract, its numbers, nothing from outside, nothing unescaped."""

import json
import math
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy import Dimension, Extent
from monitor_core.discrepancy.explanation import (
    MisfitMap,
    Outcome,
)
from monitor_core.errors import OutsideValidityError
from service.documents.explanation import explanation_document
from service.documents.explanation_sentences import row_label
from service.report.explanation_files import write_report
from service.report.markdown import explanation_markdown
from service.report.page import explanation_page
from service.report.svg import element
from tests.conftest import canary
from tests.service.explanation_examples import (
    BANDS,
    EXAMPLES,
    HOSTILE,
    LEVEL,
    MODEL,
    SUBJECT,
    Page,
    explanation,
    hostile,
    number_in,
    page_of,
)


@pytest.mark.parametrize("outcome", Outcome)
def test_document_has_the_keys_of_the_contract_and_is_strict_json(outcome) -> None:
    document = explanation_document(EXAMPLES[outcome], MODEL)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["outcome"] in set(map(str, Outcome))
    assert {"effects", "localisation", "gap", "steps", "candidates", "next_measurement", "model"} <= set(document)
    for effect in document["effects"]:
        assert {"key", "name", "parameters", "equivalent_to", "plausible", "evidence"} <= set(effect)
        assert {"delta_bic", "held_out_log_likelihood_gain"} <= set(effect["evidence"])
        for parameter in effect["parameters"].values():
            assert {"value", "standard_uncertainty", "unit"} <= set(parameter)
    for place in document["localisation"]:
        assert {"where", "misfit", "kind"} <= set(place)
    assert set(document["gap"]) == {"unit", "noise_floor", "before", "after"}
    assert set(document["gap"]["before"]) == set(document["gap"]["after"]) == {"fit", "held_out"}
    assert all({"effect", "gap_held_out"} <= set(step) for step in document["steps"])
    for candidate in document["candidates"]:
        assert {"key", "delta_bic", "held_out", "detection_limit", "untestable_because"} <= set(candidate)


def test_document_says_what_the_record_says() -> None:
    document = explanation_document(EXAMPLES[Outcome.PARTIAL], MODEL)
    stiffness, mass = document["effects"]
    assert stiffness["parameters"]["stiffness_n_per_m"] == {
        "value": 3.8e7, "standard_uncertainty": 1.0e6, "unit": "N/m", "interval_95": [3.6e7, 4.0e7], "plausible": True,
        "at_end": False,
    }  # fmt: skip
    assert (stiffness["plausible"], mass["plausible"]) == (True, False)
    assert document["gap"]["after"] == {"fit": 2.7, "held_out": 3.4}
    assert document["gap_by_channel"]["acceleration-at-table, phase"] == {"before": 14.5, "after": 0.998}
    assert document["steps"][0] == {"effect": "far-bearing-stiffness", "gap_held_out": 8.1, "gap_fit": 7.27}
    assert document["localisation"][0]["kind"] == "stiffness"
    assert document["model"] == MODEL


def test_what_is_not_known_is_null() -> None:
    document = explanation_document(EXAMPLES[Outcome.UNKNOWN], MODEL)
    assert document["gap"]["before"]["held_out"] is None
    assert document["maps"][0]["before"][0][6] is None
    untestable = document["candidates"][0]
    assert (untestable["delta_bic"], untestable["held_out"], untestable["detection_limit"]) == (None, None, None)


@pytest.mark.parametrize("outcome", canary(Outcome))
def test_page_is_well_formed_and_needs_nothing_else(outcome) -> None:
    text = explanation_page(EXAMPLES[outcome], MODEL, SUBJECT)
    page = Page(text)
    assert not {"script", "link", "img", "iframe", "object", "base"} & {tag for tag, _ in page.elements}
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", text)
    for _, attributes in page.elements:
        assert not {"src", "href", "xlink:href", "srcset"} & set(attributes)
        assert not any(name.startswith("on") for name in attributes)
    assert "nan" not in " ".join(str(value) for _, found in page.elements for value in found.values()).split()


@pytest.mark.release
@pytest.mark.parametrize("outcome", Outcome)
def test_pictures_say_what_they_show(outcome) -> None:
    page = page_of(EXAMPLES[outcome])
    names = [found["id"] for _, found in page.elements if "id" in found]
    assert len(names) == len(set(names))
    pictures = page.all("svg", role="img")
    assert len(pictures) >= 2 + 2 + len(EXAMPLES[outcome].panels) - 1
    for picture in pictures:
        assert set(str(picture["aria-labelledby"]).split()) <= set(names)


@pytest.mark.parametrize("outcome", canary(Outcome))
def test_numbers_of_the_page_are_those_of_the_record(outcome) -> None:
    example = EXAMPLES[outcome]
    expected = [place.size for place in (*example.localisation, *(example.remainder if example.effects else ()))]
    expected += [gap for before_and_after in example.gap_by_channel.values() for gap in before_and_after]
    for effect in example.effects:
        expected += [found.estimate.value for found in effect.parameters.values()]
        expected += [effect.delta_bic, effect.held_out_log_likelihood_gain]
    for candidate in example.candidates:
        expected += [candidate.delta_bic, candidate.held_out]
        if candidate.detection_limit is not None:
            ratio = math.exp(candidate.detection_limit)
            of_parameter = 100.0 * (ratio - 1.0) if ratio < 1.5 else ratio
            is_ratio = candidate.key.startswith("wrong-parameter:")
            expected += [of_parameter if is_ratio else candidate.detection_limit]
    data = page_of(example).data
    assert sorted(value for value, _ in data) == sorted(value for value in expected if not math.isnan(value))
    for value, shown in data:
        assert value == pytest.approx(number_in(shown), rel=0.03, abs=0.05)  # two digits; a tenth of a ΔBIC


@pytest.mark.parametrize("outcome", Outcome)
def test_bars_are_as_long_as_the_gaps(outcome) -> None:
    gap = EXAMPLES[outcome].gap
    page = page_of(EXAMPLES[outcome])
    fitted = [float(str(bar["width"])) for bar in page.all("rect", class_="bar fitted")][:2]
    held_out = [float(str(bar["width"])) for bar in page.all("rect", class_="bar held-out")][:2]
    shown = np.array([*fitted, *held_out])
    true = np.array([gap.before.fit, gap.after.fit, gap.before.held_out, gap.after.held_out])
    scale = shown[0] / true[0]
    drawn = true[~np.isnan(true)]  # where nothing was held out there is no bar for it
    np.testing.assert_allclose(shown, drawn * scale, atol=0.1)  # drawn to a tenth of a unit


def test_map_shows_each_cell_in_a_number() -> None:
    example = EXAMPLES[Outcome.NAMED]
    cells = [*example.maps[0].before.ravel(), *example.maps[0].after.ravel()]
    assert page_of(example).cells == ["–" if math.isnan(cell) else f"{cell:.1f}" for cell in cells]


def test_responses_that_the_model_misses_most_come_first_and_other_panels_last() -> None:
    text = explanation_page(explanation(Outcome.NAMED), MODEL, SUBJECT)
    page = text[text.index("Measurement against both models") :]
    places = [page.index(f">{position} mm, 250 N") for position in (850, 700, 500, 300, 150)]
    assert sorted(places) == places
    assert page.index("first mode, 200 N") > places[-1]


def test_rows_of_a_map_are_not_cut() -> None:
    """Three levels of excitation differ in what stands last."""
    levels = tuple(Extent(Dimension.LEVEL, (level, level)) for level in (0.045, 0.15, 0.45))
    shown = MisfitMap(LEVEL, levels, BANDS[:2], np.ones((3, 2)), np.ones((3, 2)))
    page = page_of(replace(EXAMPLES[Outcome.NAMED], maps=(shown,)))
    labels = [text for within, text in page.texts if within[-1:] == ("text",)]
    assert {row_label(level) for level in levels} == {"level 0.045", "level 0.15", "level 0.45"} <= set(labels)


@pytest.mark.parametrize("outcome", Outcome)
def test_first_picture_shows_measurement_and_models_where_the_gap_is_largest(outcome) -> None:
    """Of the two that were held out, 300 and 700 mm, the farther one is missed more."""
    example = EXAMPLES[outcome]
    text = explanation_page(example, MODEL, SUBJECT)
    hero = text[text.index('<figure class="hero">') : text.index("What this means")]
    assert "700 mm, 250 N" in hero
    assert "held out: not used in the fit" in hero
    assert 'class="measured"' in hero
    assert ('class="model after"' in hero) is bool(example.steps)
    assert ("with what was found" in hero) is bool(example.steps)


def test_hostile_names_stay_names() -> None:
    page = page_of(hostile(EXAMPLES[Outcome.EQUIVALENT]))
    assert not page.all("script")
    assert page.text().count(HOSTILE) > 20
    assert "&lt;" not in page.text()  # nothing is escaped twice


def test_attributes_and_text_of_an_element_are_escaped() -> None:
    page = Page(element("g", element("title", HOSTILE), HOSTILE, class_=HOSTILE))
    assert page.elements == [("g", {"class": HOSTILE}), ("title", {})]
    assert page.text() == f"{HOSTILE} {HOSTILE}"


def test_hostile_names_keep_the_columns_of_markdown() -> None:
    text = explanation_markdown(hostile(EXAMPLES[Outcome.EQUIVALENT]), "a = '````'\n", SUBJECT)
    assert not re.search(r"(?<!\\)<script", text.replace(f"`{HOSTILE.replace('`', chr(39))}`", ""))
    tables = re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE)
    assert len(tables) == 6
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1
    assert "`````toml\na = '````'\n`````" in text


def test_report_is_four_files_that_agree(tmp_path) -> None:
    example = EXAMPLES[Outcome.EQUIVALENT]
    written = write_report(tmp_path / "new" / "report", example, MODEL, SUBJECT)
    assert [path.name for path in written] == ["explanation.json", "explanation.md", "explanation.html", "model.toml"]
    document, markdown, page, model = (path.read_text(encoding="utf-8") for path in written)
    assert json.loads(document) == explanation_document(example, MODEL)
    assert markdown.startswith(f"# {SUBJECT}\n\n**The model lacks “Stiffness of the far bearing” or ")
    assert page == explanation_page(example, MODEL, SUBJECT)
    assert model == MODEL
    fenced = re.search(r"```toml\n(.*?)```", markdown, flags=re.DOTALL)
    assert fenced is not None
    assert tomllib.loads(fenced[1]) == tomllib.loads(MODEL)


def test_map_of_another_shape_than_its_names_is_refused() -> None:
    with pytest.raises(OutsideValidityError, match=r"must have the shape \(1, 2\)"):
        MisfitMap(None, BANDS[:1], BANDS[:2], np.zeros((1, 2)), np.zeros((2, 1)))
