"""What a report says in words: the verdict and what it rests on, bounds, places, steps, keys."""

import math
from dataclasses import replace

import pytest

from monitor_core.discrepancy import Dimension, Extent
from monitor_core.discrepancy.explanation import (
    Candidate,
    FoundParameter,
    Gap,
    GapPair,
    MisfitPlace,
    NextStep,
    Outcome,
    StepEffect,
    StepKind,
)
from monitor_core.uncertainty import Estimate
from service.documents.explanation import explanation_document
from service.documents.explanation_sentences import KEYS, NAMES, place_sentence, quoted_name, step_sentence
from service.documents.measurement import finite_or_null
from service.report.content import report_content
from service.report.markdown import explanation_markdown
from service.report.page import explanation_page
from service.report.rounding import bound, compared_with_stated, ratio_with_uncertainty, ratio_words
from service.report.verdict import asides, headline
from tests.service.explanation_examples import (
    CANDIDATES,
    EXAMPLES,
    FAR_BEARING,
    FAR_END,
    LEVEL,
    MODEL,
    ONE_PRELOAD,
    SUBJECT,
    TEMPERATURE,
    explanation,
    page_of,
)


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


def test_gap_that_does_not_fall_is_not_said_to_fall() -> None:
    worse = replace(EXAMPLES[Outcome.UNKNOWN], effects=(FAR_BEARING,), gap=Gap("Hz", 0.1, GapPair(2, 2), GapPair(1, 3)))
    assert "the gap does not fall, from 2.00 to 3.00 Hz" in page_of(worse).text()
