"""What goes with the amplitude is told from another law of it at three levels of excitation, and at no fewer."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind_cases import Job, drawn
from monitor_core.discrepancy import AMPLITUDE_LAW, Outcome
from monitor_core.discrepancy.verdict.classes import (
    EquivalenceClass,
    Member,
    indistinguishable_law,
    n_levels,
)
from monitor_core.discrepancy.verdict.next_steps import next_steps
from monitor_core.discrepancy.verdict.outcome import outcome_of, remainder_of
from monitor_core.effects import DRIVE_EFFECTS, PREFIX, Variable
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Setting
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from service.documents.explanation_sentences import next_measurement, quoted_name
from service.report.verdict import described_sentence
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity
from tests.hidden_effects.answered import answered
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.machines import jittered, machine_named
from tests.hidden_effects.situations import Situation

CUBIC, FRICTION, MASS, EXPONENT = (
    next(effect for effect in DRIVE_EFFECTS if effect.key == key)
    for key in ("cubic-stiffness", "guide-friction", "added-mass", "preload-exponent")
)
SOFTER_NUT, SOFTER_BEARING = (
    replace(quantity(0), key=f"{PREFIX}{name}") for name in ("nut_stiffness_n_per_m", "bearing_stiffness_n_per_m")
)
N_LINES = 20


def layout_at(*levels, n_lines=N_LINES):
    """Return a layout with a setting at each of these levels; None states nothing."""
    stated = [{} if level is None else {ConditionAxis.LEVEL: level} for level in levels]
    frequency = np.tile(np.geomspace(50.0, 500.0, n_lines), len(levels))
    settings = tuple(Setting(f"{n}", {ConditionAxis.POSITION: 0.1, **each}) for n, each in enumerate(stated))
    return replace(layout_of([n_lines] * len(levels), 1.0, frequency=frequency), settings=settings)


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ((None, None), 1),
        ((2.0, 2.0, 2.0), 1),
        ((2.0, None, 6.0), 2),
        ((2.0, 2.1, 1.9, 6.0, 6.3), 2),  # as a shaker repeats them
        ((6.0, 0.6, 2.0), 3),
        ((1.0, 1.4, 1.9), 2),  # a slow rise is no step to another level until it has come far enough
    ],
)
def test_levels_are_those_that_are_far_enough_apart(levels, expected) -> None:
    assert n_levels(layout_at(*levels)) == expected


@pytest.mark.parametrize("effect", [CUBIC, FRICTION, SOFTER_NUT])
def test_what_goes_with_the_amplitude_is_told_from_another_law_at_three_levels(effect) -> None:
    assert indistinguishable_law(effect, 60.0, layout_at(2.0, 2.0)) == AMPLITUDE_LAW
    assert indistinguishable_law(effect, 60.0, layout_at(2.0, 6.0)) == AMPLITUDE_LAW
    assert indistinguishable_law(effect, 260.0, layout_at(0.6, 2.0, 6.0)) == ""
    assert indistinguishable_law(effect, 60.0, layout_at(2.0, 6.0, n_lines=2)) == ""  # natural frequencies


def test_two_levels_are_enough_where_another_law_would_leave_a_tenth_of_much() -> None:
    """But not of a nut that is softer at both: it may have been softer still at a weaker excitation, or harder."""
    assert [indistinguishable_law(CUBIC, gain, layout_at(2.0, 6.0)) for gain in (990.0, 1010.0)] == [AMPLITUDE_LAW, ""]
    assert indistinguishable_law(CUBIC, 1e4, layout_at(2.0, 2.0)) == AMPLITUDE_LAW
    assert indistinguishable_law(SOFTER_NUT, 1e4, layout_at(2.0, 6.0)) == AMPLITUDE_LAW


def test_three_levels_are_enough_where_another_law_would_leave_a_fifth_of_much() -> None:
    """A contact that opens, drawn by the blind benchmark on 22 kg, was named a cubic stiffness with a gain of 192."""
    three = layout_at(0.6, 2.0, 6.0)
    assert [indistinguishable_law(CUBIC, gain, three) for gain in (192.0, 240.0, 260.0)] == [AMPLITUDE_LAW] * 2 + [""]
    assert not indistinguishable_law(SOFTER_NUT, 60.0, three)


def test_what_follows_the_preload_at_one_level_may_go_with_the_amplitude_unless_much_speaks_for_it() -> None:
    """A nut that opens, of a contact loss drawn by the blind benchmark, was named so with a gain of 90."""
    assert indistinguishable_law(EXPONENT, 90.0, layout_at(2.0, 2.0)) == AMPLITUDE_LAW
    assert indistinguishable_law(EXPONENT, 1010.0, layout_at(2.0, 2.0)) == ""
    assert indistinguishable_law(EXPONENT, 90.0, layout_at(2.0, 6.0)) == ""


@pytest.mark.parametrize("effect", [MASS, SOFTER_BEARING])
def test_other_effects_leave_no_law_open(effect) -> None:
    assert indistinguishable_law(effect, 60.0, layout_at(2.0, 2.0)) == ""


def test_what_is_left_open_is_equivalent_and_says_what_to_measure() -> None:
    layout = layout_at(2.0, 2.0)
    values = np.random.default_rng(4).standard_normal(layout.n_values)
    comparison = LinearComparison(layout, np.ones((layout.n_values, 1)), values, np.zeros((0, layout.n_values)))
    hypothesis = Hypothesis(LinearAxis({}, 1), (SOFTER_NUT,))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    named = EquivalenceClass((Member(SOFTER_NUT, fitted, 60.0, plausible=True),), (), 9.0)
    opened = replace(named, other_laws=(AMPLITUDE_LAW,))
    outcomes = [outcome_of([each], remainder_of(fitted), explained=1.0) for each in (named, opened)]
    assert outcomes == [Outcome.NAMED, Outcome.EQUIVALENT]
    assert (named.others, opened.others, opened.look_alikes) == ((), (AMPLITUDE_LAW,), ())
    found = SimpleNamespace(final=fitted)
    says = next_measurement(next_steps(found, (opened,), Outcome.EQUIVALENT, (CUBIC,)))
    assert "at a third of the usual excitation and at three times as much" in says
    unseen = "without which cubic-stiffness cannot be seen"
    assert unseen in next_measurement(next_steps(found, (named,), Outcome.EQUIVALENT, (CUBIC,)))
    assert unseen not in says  # of the same measurement nothing is said twice
    assert next_steps(found, (named,), Outcome.NAMED, (CUBIC,)) == ()


def test_the_law_has_a_name_in_sentences() -> None:
    assert quoted_name(AMPLITUDE_LAW) == "“Something that goes with the excitation by a law of its own”"


@pytest.mark.release
@pytest.mark.parametrize(
    ("machine", "design", "left_open"), [("bench", "usual", True), ("bench", "rich", True), ("gantry", "rich", False)]
)
def test_a_cubic_stiffness_is_named_alone_where_three_levels_show_much_of_it(machine, design, left_open) -> None:
    """The truth is of finite elements, its nut a spring that is stepped through time; on 22 kg its gain is 194."""
    situation = Situation(machine=jittered(machine_named(machine), np.random.default_rng(5)), design=design)
    answer = answered(draw_case("cubic-stiffness", "large", 0.01, 31, situation=situation))
    (effect,) = answer.effects
    assert effect.key == "cubic-stiffness"
    assert (AMPLITUDE_LAW in effect.equivalent_to) is left_open
    assert answer.outcome == (Outcome.EQUIVALENT if left_open else Outcome.NAMED)


@pytest.mark.release
def test_a_play_that_passes_for_a_cubic_stiffness_is_left_open() -> None:
    situation = Situation(machine=jittered(machine_named("mill"), np.random.default_rng(5)), design="usual")
    answer = answered(draw_case("outside:backlash", "large", 0.01, 31, situation=situation))
    assert answer.outcome == Outcome.EQUIVALENT
    assert all(AMPLITUDE_LAW in effect.equivalent_to for effect in answer.effects)


@pytest.mark.release
@pytest.mark.parametrize(("size", "seed"), [("medium", 199), ("large", 202)])
def test_a_play_that_other_names_leave_nothing_of_is_described_where_its_law_explains_more(size, seed) -> None:
    """A cubic stiffness leaves no more than a healthy axis does; nothing is sought beside it, no record is wrong."""
    situation = Situation(machine=jittered(machine_named("mini"), np.random.default_rng([seed, 1])), design="usual")
    said = list[str]()
    answer = answered(draw_case("outside:backlash", size, 0.003, seed, situation=situation), progress=said.append)
    assert (answer.outcome, answer.effects, answer.records) == (Outcome.DESCRIBED, (), ())
    (found,) = answer.described
    assert (found.place, found.parameter, found.law.variable) == ("nut", "nut_stiffness_n_per_m", Variable.EXCITATION)
    assert [words for words in said if "found, screening" in words] == ["0 effects found, screening 43 more"]


@pytest.mark.release
def test_a_law_that_explains_as_much_again_as_the_first_name_is_the_answer() -> None:
    """It leaves 1.12 floors, and a friction 1.7; further names beside that took two minutes, and came to nothing."""
    situation = ("receptance", "finite elements", "bench", "rich", "larger", "clipped")
    answer = answered(drawn(Job(169, "outside:backlash", "large", 0.003, *situation), 957558161))
    assert (answer.outcome, answer.effects, answer.records) == (Outcome.DESCRIBED, (), ())
    (found,) = answer.described
    assert (found.place, found.parameter, found.law.variable) == ("nut", "nut_stiffness_n_per_m", Variable.EXCITATION)
    assert answer.gap.after.held_out < 1.2 * answer.gap.noise_floor < 1.2 * answer.gap.before.held_out / 2.0
    assert [name for name, value in found.parameters.items() if value.at_end] == ["change"]
    assert "its change would go beyond what is searched" in described_sentence(found)
