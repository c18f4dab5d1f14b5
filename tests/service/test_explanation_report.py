"""The report says what the record says: keys of the contract, its numbers, nothing from outside, nothing unescaped."""

import json
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest

from monitor_core.discrepancy import Dimension, Extent
from monitor_core.discrepancy.explanation import (
    Candidate,
    Described,
    Explanation,
    FoundEffect,
    FoundParameter,
    Gap,
    GapPair,
    Misfit,
    MisfitKind,
    MisfitMap,
    MisfitPlace,
    NextStep,
    Outcome,
    Step,
    StepEffect,
    StepKind,
    Untested,
    UntestedReason,
)
from monitor_core.effects import ConditionAxis, Form, Law, Variable, varying
from monitor_core.errors import OutsideValidityError
from monitor_core.shown import Panel
from monitor_core.uncertainty import Estimate
from service.documents.explanation import explanation_document
from service.documents.explanation_sentences import KEYS, NAMES, place_sentence, quoted_name, row_label, step_sentence
from service.documents.measurement import finite_or_null
from service.report.content import report_content
from service.report.explanation_files import write_report
from service.report.markdown import explanation_markdown
from service.report.page import explanation_page
from service.report.rounding import bound, compared_with_stated, ratio_with_uncertainty, ratio_words
from service.report.svg import element
from service.report.verdict import asides, headline
from tests.conftest import canary

SUBJECT = "x-axis.frf.h5 against hybrid.toml"
MODEL = 'family = "hybrid"\n\n[parameters]\ntable_mass_kg = 20.54\n\n[effects.added-mass]\nmass_kg = 0.81\n'
#: Names as a user's own file of effects might bring them.
HOSTILE = '"><script>alert(1)</script>&amp;|`*'
TEMPERATURE, LEVEL = ConditionAxis.TEMPERATURE, ConditionAxis.LEVEL
VOID = {"meta", "link", "br", "hr", "img", "input"}

FAR_BEARING = FoundEffect(
    key="far-bearing-stiffness",
    name="Stiffness of the far bearing",
    physics="The far end of the screw is held axially; the axis is stiffer there, and the more so the nearer the nut.",
    parameters={"stiffness_n_per_m": FoundParameter(Estimate(3.8e7, 1.0e6), "N/m", (3.6e7, 4.0e7), plausible=True)},
    equivalent_to=(),
    delta_bic=41.2,
    held_out_log_likelihood_gain=33.0,
)
ADDED_MASS = FoundEffect(
    key="added-mass",
    name="Mass that the description leaves out",
    physics="A mass moves with the table.",
    parameters={"mass_kg": FoundParameter(Estimate(-13.6, 0.4), "kg", (-14.4, -12.8), plausible=False)},
    equivalent_to=(),
    delta_bic=212.0,
    held_out_log_likelihood_gain=151.0,
)
CANDIDATES = (
    Candidate("thermal-preload", math.nan, math.nan, None, "N/K", Untested(UntestedReason.NOT_VARIED, (TEMPERATURE,))),
    Candidate("guide-friction", -6.2, -0.4, 14.0, "N"),
    Candidate("loss-factor", 2.4, 0.3, 0.0021, "-"),
    Candidate("base-compliance", -11.9, -2.0, 4.3e-10, "m/N"),
    Candidate("wrong-parameter:bearing_stiffness_n_per_m", -13.0, -2.1, math.log(5.0), "-"),
    Candidate("wrong-parameter:table_mass_kg", -14.0, -2.2, 0.04, "-"),
)
FAR_END = MisfitPlace((Extent(Dimension.POSITION, (0.5, 0.85)), Extent(Dimension.BAND, (150.0, 200.0))))
ONE_PRELOAD = MisfitPlace((Extent(Dimension.PRELOAD, (400.0, 400.0)), Extent(Dimension.BAND, (24.0, 60.0))))
LOCALISATION = (
    Misfit(FAR_END, 8.31, MisfitKind.STIFFNESS, 3.0e-9),
    Misfit(ONE_PRELOAD, 1.74, MisfitKind.UNCLEAR, 0.013),
)
SETTINGS = ("150 mm, 250 N", "300 mm, 250 N", "500 mm, 250 N", "700 mm, 250 N", "850 mm, 400 N, +6 kg, +15 K")
EDGES = (24.0, 60.0, 120.0, 150.0, 200.0, 400.0, 800.0, 1500.0)
BANDS = tuple(Extent(Dimension.BAND, ends) for ends in pairwise(EDGES))


def misfit_map() -> MisfitMap:
    """Return a map with its worst place at the far end around the first mode, and an empty cell."""
    rng = np.random.default_rng(1)
    after = 1.0 + 0.15 * rng.standard_normal((len(SETTINGS), len(BANDS)))
    before = after + 9.0 * np.outer(np.linspace(0.1, 1.0, len(SETTINGS)), np.exp(-((np.arange(7) - 3.0) ** 2)))
    before[0, 6] = after[0, 6] = np.nan
    rows = tuple(Extent(Dimension.SETTINGS, names=(name, name)) for name in SETTINGS)
    return MisfitMap(None, rows, BANDS, before, after)


def panels() -> tuple[Panel, ...]:
    """Return responses with a gap in the data, one held out, and a natural frequency over three positions."""
    f = np.linspace(24.0, 1500.0, 1477)
    rng = np.random.default_rng(2)

    def response(natural: float) -> np.ndarray:
        return np.abs(f**2 / (natural**2 - f**2 + 0.03j * natural * f)) / 20.0

    made = []
    for i, position in enumerate((150, 300, 500, 700, 850)):
        true = response(180.0 + 8.0 * i)
        measured = true * np.exp(0.02 * rng.standard_normal(f.size))
        measured[600:640] = np.nan
        models: Mapping[str, np.ndarray] = {"before": response(176.0), "after": true}
        made.append(
            Panel(
                f"{position} mm, 250 N", "frequency [Hz]", "|torque accelerance| [m/(N·m·s²)]", f, measured, models,
                logarithmic=True, held_out=i in {1, 3},
            )
        )  # fmt: skip
    x = np.array([300.0, 500.0, 700.0])
    frequency = np.array([176.0, 181.2, 190.4])
    models = {"before": frequency - [1.0, 4.0, 11.0], "after": frequency + 0.1}
    return (*made, Panel("first mode, 200 N", "position [mm]", "natural frequency [Hz]", x, frequency, models))


def explanation(outcome: Outcome) -> Explanation:
    """Return an example of each outcome."""
    named = Explanation(
        outcome=Outcome.NAMED,
        effects=(FAR_BEARING,),
        localisation=LOCALISATION,
        remainder=(),
        gap=Gap("sigma", 1.0, GapPair(12.1, 12.6), GapPair(1.02, 1.07)),
        steps=(Step(("far-bearing-stiffness",), GapPair(1.02, 1.07)),),
        candidates=CANDIDATES,
        pulls={"position": 0.93, "preload": 1.12, "gain": 0.71, "table_mass_kg": 0.2},
        least_delta_bic=50.0,
        next_steps=(NextStep(StepKind.KNOWN_MASS, ConditionAxis.PAYLOAD, values={"mass_kg": 6.0}),),
        ln_ratios={"table_mass_kg": 0.02},
        added={"far-bearing-stiffness": {"stiffness_n_per_m": 3.8e7}},
        panels=panels(),
        maps=(misfit_map(),),
        gap_by_channel={"acceleration-at-table, amplitude": (9.1, 1.04), "acceleration-at-table, phase": (14.5, 0.998)},
    )
    match outcome:
        case Outcome.NAMED:
            return named
        case Outcome.EQUIVALENT:
            alike = replace(FAR_BEARING, equivalent_to=("screw-axial-stiffness", "torsional-flexibility"))
            return replace(named, outcome=outcome, effects=(alike,))
        case Outcome.PARTIAL:
            return replace(
                named,
                outcome=outcome,
                effects=(FAR_BEARING, ADDED_MASS),
                remainder=LOCALISATION[1:],
                gap=Gap("Hz", 0.13, GapPair(63.3, 63.1), GapPair(2.7, 3.4)),
                steps=(
                    Step(("far-bearing-stiffness",), GapPair(7.27, 8.1)),
                    Step(("added-mass",), GapPair(2.7, 3.4)),
                ),
                pulls={**named.pulls, "preload": 4.8},
            )
        case Outcome.NONE:
            same = GapPair(1.01, 0.98)
            return replace(
                named, outcome=outcome, effects=(), localisation=(), gap=Gap("sigma", 1.0, same, same), steps=()
            )
        case Outcome.DESCRIBED:
            estimate = FoundParameter(Estimate(-0.31, 0.02), "-", (-0.35, -0.27), plausible=True)
            law = Law(Variable.EXCITATION, Form.POWER, reference=0.15, scale=0.4)
            softening = Described(
                place="nut",
                parameter="nut stiffness",
                law=law,
                parameters={"exponent": estimate},
                effects=(varying("joints", "nut_stiffness", law),),
                alternatives=(),
                share=0.97,
                delta_bic=312.0,
                held_out_log_likelihood_gain=84.0,
            )
            return replace(named, outcome=outcome, effects=(), steps=(), described=(softening,))
        case Outcome.UNKNOWN:
            same = GapPair(6.3, math.nan)
            return replace(named, outcome=outcome, effects=(), gap=Gap("%", 0.4, same, same), steps=(), pulls={})


EXAMPLES = {outcome: explanation(outcome) for outcome in Outcome}


def test_verdict_on_what_a_parameter_had_taken_up_says_which_and_how_far() -> None:
    same = GapPair(0.99, 0.98)
    eased = replace(
        EXAMPLES[Outcome.NAMED],
        gap=Gap("sigma", 1.0, same, same),
        pulls_before={"table_mass_kg": 0.4, "bracket_stiffness_n_per_m": -14.93},
        pulls={"bracket_stiffness_n_per_m": 0.1},
    )
    assert headline(eased).endswith(
        "with it the gap stays at 0.980 σ, on data that were not fitted (noise floor 1.00 σ), but without, "
        "the bracket stiffness would have to be 15 standard deviations from what is stated."
    )


def test_of_none_it_is_said_what_comes_nearest_and_how_much_speaks_for_it() -> None:
    """Evidence has no step: very strong evidence that is less than what is asked is said, chance is not."""
    none = EXAMPLES[Outcome.NONE]
    near, far = (replace(none, candidates=(replace(CANDIDATES[1], delta_bic=of),)) for of in (41.0, 9.0))
    assert asides(far) == asides(replace(none, candidates=()))
    (nearest,) = set(asides(near)) - set(asides(far))
    assert (
        nearest == "“Coulomb friction of the guides” comes nearest to a finding, with a ΔBIC of 41 where 50 is asked."
    )


@pytest.mark.parametrize(("pull", "is_said"), [(3.9, False), (6.8, True)])
def test_a_tolerance_that_is_strained_is_said_where_nothing_has_a_name(pull, is_said) -> None:
    strained = replace(
        EXAMPLES[Outcome.UNKNOWN], effects=(), described=(), unfinished=None, ln_ratios={"table_mass_kg": 0.3},
        pulls={"table_mass_kg": pull}, pulls_before={"table_mass_kg": pull},
    )  # fmt: skip
    assert ("the fit moves table mass by 6.8 of its tolerances" in headline(strained)) is is_said


def test_what_was_assumed_and_what_is_pulled_far_is_said_below_the_verdict() -> None:
    plain = replace(EXAMPLES[Outcome.PARTIAL], pulls=EXAMPLES[Outcome.NAMED].pulls)
    assert asides(plain) == ()
    (scattered,) = asides(EXAMPLES[Outcome.PARTIAL])
    assert scattered.startswith("What is stated as preload scatters by 4.8 times its tolerance")
    assert asides(replace(plain, assumptions=("It is on the nut.",))) == ("It is on the nut.",)
    pulled = replace(
        plain,
        pulls={"position": 11.0, "table_mass_kg": -71.6, "loss_factor": 2.4, "bracket_stiffness_n_per_m": 2.6},
        pulls_before={"table_mass_kg": -70.0, "loss_factor": 0.0, "bracket_stiffness_n_per_m": 4.9},
        ln_ratios={"table_mass_kg": math.log(0.7), "loss_factor": 0.9, "bracket_stiffness_n_per_m": math.log(1.5)},
    )
    scattered, far = asides(pulled)  # within 2.5 nothing is said of a parameter
    assert scattered.startswith("What is stated as position scatters by 11 times its tolerance")
    moved = (
        "The fit has table mass 30 % less than stated (72 standard deviations) and "
        "bracket stiffness 1.5 times what is stated (2.6 standard deviations)."
    )
    assert far.startswith(moved)
    for text in (explanation_page(pulled, "", "x"), explanation_markdown(pulled, "", "x")):
        assert moved in text


def test_agreement_that_a_parameter_had_to_move_for_is_said_in_the_verdict() -> None:
    softer = replace(
        EXAMPLES[Outcome.NONE],
        pulls={"bearing_stiffness_n_per_m": -3.0, "table_mass_kg": 1.0},
        pulls_before={"bearing_stiffness_n_per_m": -3.0, "table_mass_kg": 1.0},
        ln_ratios={"bearing_stiffness_n_per_m": math.log(0.4), "table_mass_kg": 0.01},
    )
    assert headline(softer).startswith(
        "Nothing is missing that these data would show, once bearing stiffness is as refitted: the gap is"
    )
    (moved,) = asides(softer)
    assert moved.startswith("The fit has bearing stiffness 0.40 times what is stated (3.0 standard dev")


def test_gap_of_a_model_that_was_bent_to_the_data_is_said_to_be_that() -> None:
    bent = replace(EXAMPLES[Outcome.NAMED], pulls={"youngs_modulus_pa": 0.4}, pulls_before={"youngs_modulus_pa": 85.0})
    assert asides(bent) == (
        "The gap before is that of a model whose parameters were moved far to fit the data, in standard deviations: "
        "Young's modulus 85.",
    )
    assert asides(replace(bent, pulls_before={"youngs_modulus_pa": 4.9})) == ()


class Page(HTMLParser):
    """What the tests ask of a page: is it well formed, which elements with which attributes, which text in which."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[tuple[str, ...], str]] = []
        self.data: list[tuple[float, str]] = []  # value and what is shown of it
        self.cells: list[str] = []  # of the maps
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f"left open: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((tuple(self._open), data))
        _, last = self.elements[-1] if self.elements else ("", {})
        if self._open[-1:] == ["data"]:
            self.data.append((float(str(last["value"])), data))
        if self._open[-1:] == ["text"] and str(last.get("class")).startswith("on-"):
            self.cells.append(data)

    def all(self, tag: str, **wanted: str) -> list[dict[str, str | None]]:
        """Return the attributes of the elements of a tag, `class_` and others as given."""
        names = {name.rstrip("_"): value for name, value in wanted.items()}
        return [found for name, found in self.elements if name == tag and names.items() <= found.items()]

    def text(self) -> str:
        return " ".join(" ".join(data for within, data in self.texts if "style" not in within).split())


def number_in(shown: str) -> float:
    """Read back what a person reads: a number, perhaps with an uncertainty and a power of ten."""
    found = re.match(r"\(?(-?[\d.]+)(?: ± [\d.]+\))?(?: × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", shown.replace("−", "-"))
    assert found is not None, shown
    return float(found[1]) * 10.0 ** int((found[2] or "0").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))


def page_of(example: Explanation) -> Page:
    return Page(explanation_page(example, MODEL, SUBJECT))


def hostile(example: Explanation) -> Explanation:
    """Return the example with such names in all places that a file of a user can fill."""
    effect = replace(
        example.effects[0], key=HOSTILE, name=HOSTILE, physics=HOSTILE, equivalent_to=(HOSTILE,), aliases=(HOSTILE,),
        parameters={HOSTILE: replace(ADDED_MASS.parameters["mass_kg"], unit=HOSTILE)},
    )  # fmt: skip
    hostile_extent = Extent(Dimension.CHANNEL, names=(HOSTILE,))
    panel = replace(example.panels[-1], title=HOSTILE, x_name=HOSTILE, y_name=HOSTILE)
    return replace(
        example,
        effects=(effect,),
        localisation=(replace(LOCALISATION[0], place=MisfitPlace((hostile_extent,))),),
        gap=replace(example.gap, unit=HOSTILE),
        steps=(Step((HOSTILE,), example.gap.after), Step((HOSTILE,), example.gap.after)),
        candidates=(
            Candidate(HOSTILE, 1.0, 1.0, 1.0, HOSTILE, Untested(UntestedReason.TIME_UP)),
            Candidate(HOSTILE, 1.0, 1.0, 1.0, HOSTILE),
        ),
        pulls={HOSTILE: 1.0},
        next_steps=(NextStep(StepKind.VARY, LEVEL, effects=(StepEffect(HOSTILE),)),),
        panels=(replace(panel, models={HOSTILE: panel.measured}),),
        gap_by_channel={HOSTILE: (1.0, 1.0), f"{HOSTILE} twice": (1.0, 1.0)},
        maps=(MisfitMap(None, (hostile_extent,), (hostile_extent,), np.array([[1.0]]), np.array([[np.nan]])),),
    )


# --- the document ----------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        ((math.log(16.0), math.inf), "at least 16 times as much"),
        ((-math.inf, math.log(0.05)), "at most 0.050 times as much"),
        ((-math.inf, math.log(0.88)), "at least 12 % less"),
        ((math.log(0.88), math.inf), "at most 12 % less"),
        ((-math.inf, math.log(1.1)), "at most 10 % more"),
        ((math.log(0.9), math.log(1.1)), ""),
    ],
)
def test_a_value_at_an_end_is_said_to_be_a_bound(interval, words) -> None:
    assert bound(*interval, ratio_words) == words


def test_a_bound_is_told_alike_on_the_page_in_the_sentence_and_in_the_document() -> None:
    size = FoundParameter(Estimate(3.0, math.inf), "-", (2.8, math.inf), plausible=False, at_end=True)
    example = EXAMPLES[Outcome.PARTIAL]
    wrong = replace(
        example.effects[0],
        key="wrong-parameter:bracket_stiffness_n_per_m",
        parameters={"ln_ratio": size},
        equivalent_to=(),
    )
    explanation = replace(example, effects=(wrong,), described=())
    (row,) = report_content(explanation).effects[0].parameters
    assert [cell.text for cell in row[1:3]] == ["at least 16 times as much"] * 2
    assert "bracket stiffness is at least 16 times what is stated" in report_content(explanation).headline
    stated = explanation_document(explanation, MODEL)["effects"][0]["parameters"]["ln_ratio"]
    assert finite_or_null(stated) == {
        "value": 3.0, "standard_uncertainty": None, "unit": "-", "interval_95": [2.8, None], "plausible": False,
        "at_end": True,
    }  # fmt: skip


def test_what_is_not_known_is_null() -> None:
    document = explanation_document(EXAMPLES[Outcome.UNKNOWN], MODEL)
    assert document["gap"]["before"]["held_out"] is None
    assert document["maps"][0]["before"][0][6] is None
    untestable = document["candidates"][0]
    assert (untestable["delta_bic"], untestable["held_out"], untestable["detection_limit"]) == (None, None, None)


# --- the page --------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("made", [explanation_page, explanation_markdown])
def test_report_says_from_what_evidence_and_what_size_on_an_effect_is_found(made) -> None:
    report = made(explanation(Outcome.NONE), MODEL, SUBJECT)
    assert "a ΔBIC of 50" in report
    assert "5.0 times what is stated" in report
    assert "4.1 % more or 3.9 % less than stated" in report


def test_what_is_not_believed_is_flagged() -> None:
    page = page_of(EXAMPLES[Outcome.PARTIAL])
    assert len(page.all("article")) == 2
    assert len(page.all("article", class_="stand-in")) == 1
    assert "a stand-in for something else: mass = -13.6 kg is beyond its plausible range" in page.text()
    assert "stand-in" not in page_of(EXAMPLES[Outcome.NAMED]).text()


def test_verdict_comes_first_and_says_what_it_rests_on() -> None:
    texts = {outcome: page_of(example).text() for outcome, example in EXAMPLES.items()}
    assert "the gap falls, from 12.6 to 1.07 σ, on data that were not fitted" in texts[Outcome.NAMED]
    assert "or “Axial stiffness of the screw” or 1 more, and these data cannot tell which" in texts[Outcome.EQUIVALENT]
    assert "and there is more that nothing in the catalogue explains" in texts[Outcome.PARTIAL]
    assert "What could still hide" in texts[Outcome.NONE]
    assert "untestable: temperature does not vary" in texts[Outcome.NONE]
    assert "the gap is 6.30 % on the data that were fitted, since none could be held out" in texts[Outcome.UNKNOWN]
    assert (
        "No name fits, but this holds: nut stiffness at the nut varies with the excitation" in texts[Outcome.DESCRIBED]
    )
    for outcome, text in texts.items():
        assert text.index(str(outcome)) < text.index("Gap before and after")


@pytest.mark.release
@pytest.mark.parametrize(
    ("outcome", "holds"),
    [(Outcome.NAMED, "holds on the data it was chosen by. It does not"),
     (Outcome.PARTIAL, "holds on the data it was chosen by, but does not close the gap")],
)  # fmt: skip
def test_what_was_not_held_out_is_not_spoken_of(outcome, holds) -> None:
    made = EXAMPLES[outcome]
    before, after = (replace(pair, held_out=math.nan) for pair in (made.gap.before, made.gap.after))
    without = replace(
        made,
        gap=replace(made.gap, before=before, after=after),
        effects=tuple(replace(effect, held_out_log_likelihood_gain=math.nan) for effect in made.effects),
        steps=tuple(replace(step, gap=replace(step.gap, held_out=math.nan)) for step in made.steps),
    )
    for text in (page_of(without).text(), explanation_markdown(without, "", "x")):
        assert holds in text
        assert "None could be held out; of five positions or more, two would be." in text
        assert "nothing was held out." in text
        for words in ("not used to choose it", "log-likelihood of held-out data", "Hatched"):
            assert words not in text
    for text in (page_of(made).text(), explanation_markdown(made, "", "x")):
        assert "holds on data that were not used to choose it" in text
        assert "better with it than without" in text
    assert "Hatched" in page_of(made).text()


def test_evidence_says_in_which_place_it_is_meant() -> None:
    rival = Candidate("loss-factor", 2.4, 0.3, 0.0021, "-", substitution_for="far-bearing-stiffness")
    other = Candidate("base-compliance", -11.9, math.nan, 4.3e-10, "m/N")
    made = replace(EXAMPLES[Outcome.NAMED], candidates=(rival, other))
    for text in (page_of(made).text(), explanation_markdown(made, "", "x")):
        assert "instead of Axial stiffness of the far bearing" in text
        assert "in addition" in text


def test_what_is_not_the_cause_is_not_called_found() -> None:
    with_effects = replace(EXAMPLES[Outcome.NAMED], outcome=Outcome.UNKNOWN)
    assert "What helped most, and is not named as the cause" in page_of(with_effects).text()
    assert "What was found" in page_of(EXAMPLES[Outcome.NAMED]).text()


@pytest.mark.parametrize(
    ("ln_ratio", "uncertainty", "words", "value"),
    [(0.12, 0.01, "13 % more than stated", "(12.7 ± 1.1) % more"),
     (-0.10, 0.01, "9.5 % less than stated", "(9.52 ± 0.90) % less"),
     (1.10, 0.05, "3.0 times what is stated", "(3.00 ± 0.15) times as much"),
     (-1.10, 0.05, "0.33 times what is stated", "(0.333 ± 0.017) times as much")],
)  # fmt: skip
def test_a_wrong_parameter_is_said_in_plain_words(ln_ratio, uncertainty, words, value) -> None:
    """Ratios by the calculator: e^0.12 = 1.1275, e^-0.1 = 0.9048, e^1.1 = 3.004."""
    assert compared_with_stated(ln_ratio) == words
    assert ratio_with_uncertainty(ln_ratio, uncertainty) == value
    interval = (ln_ratio - 1.96 * uncertainty, ln_ratio + 1.96 * uncertainty)
    found = FoundParameter(Estimate(ln_ratio, uncertainty), "1", interval, True)
    wrong = replace(
        FAR_BEARING,
        key="wrong-parameter:table_mass_kg",
        name="Wrong table_mass_kg",
        parameters={"ln_ratio": found},
    )
    named = replace(EXAMPLES[Outcome.NAMED], effects=(wrong,))
    assert headline(named).startswith(f"The table mass is {words}: with it the gap falls, from ")
    both = replace(named, effects=(FAR_BEARING, wrong))
    lacks = f"The model lacks “Stiffness of the far bearing”, and the table mass is {words}: with them the gap"
    assert headline(both).startswith(lacks)
    for text in (page_of(named).text(), explanation_markdown(named, "", "x")):
        assert value in text
        assert "ln_ratio" not in text


def test_keys_are_small_print() -> None:
    """What is missing is said by its name; the key stands once beside it, for whoever writes a model file."""
    unseen, warmer = ("thermal-preload", "thermal-stiffness"), {"warming_k": 15.0}
    wanted = replace(
        EXAMPLES[Outcome.EQUIVALENT],
        effects=(replace(FAR_BEARING, equivalent_to=("screw-axial-stiffness",)),),
        next_steps=(NextStep(StepKind.VARY, TEMPERATURE, effects=tuple(map(StepEffect, unseen)), values=warmer),),
    )
    for text in (page_of(wanted).text(), explanation_markdown(wanted, "", "x")):
        assert (
            "Vary the temperature by 15 K, without which “Preload that follows temperature”, “Springs that soften"
            in text
        )
        assert "Friction of the guides" in text or "Coulomb friction of the guides" in text
    page = page_of(wanted)
    keys = {"far-bearing-stiffness", "screw-axial-stiffness", "guide-friction", "stiffness_n_per_m"}
    inside = {text.strip(): within for within, text in page.texts if text.strip() in keys}
    assert set(inside) == keys
    assert all({"small", "code"} <= set(within) for within in inside.values())


def test_places_are_said_by_keys_to_programs_and_in_words_to_people() -> None:
    place = MisfitPlace((*FAR_END.extents[:1], *ONE_PRELOAD.extents))
    assert place_sentence(place, KEYS) == "position_mm 500..850, preload_n 400, band 24..60 Hz"
    assert place_sentence(place, NAMES) == "500 to 850 mm, 400 N, 24 to 60 Hz"
    channels = Extent(Dimension.CHANNEL, names=("acceleration-at-table, phase", "b"))
    mode = MisfitPlace((channels, Extent(Dimension.MODE, (176.0, 181.0))))
    assert place_sentence(mode, KEYS) == 'channel "acceleration-at-table, phase" and "b", mode 176..181 Hz'
    assert place_sentence(mode, NAMES) == "channel acceleration-at-table, phase and b, mode 176 to 181 Hz"
    everywhere = MisfitPlace(changing_with=(LEVEL, TEMPERATURE))
    assert place_sentence(everywhere, NAMES) == "everywhere, changing with excitation level and temperature"
    assert quoted_name("my-own-effect") == "my-own-effect"


def test_rows_of_a_map_are_not_cut() -> None:
    """Three levels of excitation differ in what stands last."""
    levels = tuple(Extent(Dimension.LEVEL, (level, level)) for level in (0.045, 0.15, 0.45))
    shown = MisfitMap(LEVEL, levels, BANDS[:2], np.ones((3, 2)), np.ones((3, 2)))
    page = page_of(replace(EXAMPLES[Outcome.NAMED], maps=(shown,)))
    labels = [text for within, text in page.texts if within[-1:] == ("text",)]
    assert {row_label(level) for level in levels} == {"level 0.045", "level 0.15", "level 0.45"} <= set(labels)


def test_every_step_has_a_sentence() -> None:
    """With all that a step can have; a condition that its kind speaks of."""
    values = dict.fromkeys(
        ("lowest_hz", "highest_hz", "lowest_n", "highest_n", "lowest_m", "highest_m", "lowest_kg",
         "highest_kg", "lowest_k", "highest_k", "lowest_level", "highest_level", "frequency_hz", "mass_kg", "warming_k",
         "factor_at_first", "factor_at_second", "pull",
         "pull_of_others", "scatter_over_stated", "slower_m_per_s", "faster_m_per_s", "n_positions"), 5.0,
    )  # fmt: skip
    effects = (StepEffect("added-mass", 2.0, "kg"), StepEffect("loss-factor", 4.0, "sigma"))
    for kind in StepKind:
        step = NextStep(
            kind, TEMPERATURE, "nut_stiffness_n_per_m", "nut", ("300 mm", "500 mm"), effects, values,
            ((5.0, 1.1), (4.0, 0.9), (6.0, 1.2)),
        )  # fmt: skip
        by_key, by_name = step_sentence(step, KEYS), step_sentence(step, NAMES)
        assert by_key == by_key.strip()
        assert "added-mass" not in by_name
        assert not set("{}") & {*by_key, *by_name}


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


def test_gap_that_does_not_fall_is_not_said_to_fall() -> None:
    worse = replace(EXAMPLES[Outcome.UNKNOWN], effects=(FAR_BEARING,), gap=Gap("Hz", 0.1, GapPair(2, 2), GapPair(1, 3)))
    assert "the gap does not fall, from 2.00 to 3.00 Hz" in page_of(worse).text()


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


# --- files -----------------------------------------------------------------------------------------------------------


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
