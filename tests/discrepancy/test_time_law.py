"""What changes the nut is told from a preload that drifts while the settings are measured, or left open."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind_cases import Job, drawn
from monitor_core.discrepancy import AMPLITUDE_LAW, TIME_LAW, Outcome
from monitor_core.discrepancy.description.otherwise import OF_NUT, goes_with_time
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, Member
from monitor_core.discrepancy.verdict.next_steps import next_steps
from monitor_core.effects import PREFIX, Variable
from monitor_core.fitting.evidence import delta_bic, evidence_scale
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from service.documents.explanation_sentences import next_measurement, quoted_name
from tests.discrepancy.axes import LinearAxis, LinearComparison, effects_by_key, layout_of, quantity
from tests.hidden_effects.answered import answered, compared
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.machines import jittered, machine_named
from tests.hidden_effects.situations import Situation

PERIODIC = effects_by_key()["periodic-preload"]


@pytest.mark.release
@pytest.mark.parametrize(("truth", "left_open"), [("outside:preload-drift", True), ("periodic-preload", False)])
def test_a_drift_does_as_well_where_it_is_the_truth(truth, left_open) -> None:
    """The truth is of finite elements; a law of time is held against a periodic preload."""
    situation = Situation(machine=jittered(machine_named("bench"), np.random.default_rng(5)), design="rich")
    comparison, subject = compared(draw_case(truth, "large", 0.003, 31, situation=situation))
    plain = Hypothesis(subject)
    without = fit(comparison, plain, plain.null)
    hypothesis = plain.with_effect(PERIODIC)
    final = fit(comparison, hypothesis, hypothesis.carried_over(plain, without.coordinates))
    assert truth != PERIODIC.key or delta_bic(without, final, evidence_scale(final)) > 100.0
    said = list[str]()
    assert goes_with_time(without, final, 20.0, said.append) is left_open
    assert said[0] == "asking whether it changes with time"


def drifting(number, size, noise, plant, machine, disturbance, seed):  # noqa: PLR0917
    """Return a case of a preload that drifts, where settings scatter twice as much as is stated."""
    situation = ("receptance", plant, machine, "rich", "larger", disturbance)
    return drawn(Job(number, "outside:preload-drift", size, noise, *situation), seed)


@pytest.mark.release
def test_a_law_of_time_that_explains_more_than_a_name_leaves_that_open() -> None:
    """However much of what varies freely, or is missing, is errors of settings."""
    answer = answered(drifting(158, "medium", 0.01, "transmission line", "bench", "clean", 26585308))
    assert answer.outcome == Outcome.EQUIVALENT
    assert [(effect.key, effect.equivalent_to) for effect in answer.effects] == [(PERIODIC.key, (TIME_LAW,))]


@pytest.mark.release
def test_a_law_of_time_that_explains_most_is_described_in_the_place_of_a_name() -> None:
    """By as much as the cube root of the preload falls from the first setting to the last."""
    case = drifting(161, "large", 0.003, "finite elements", "mini", "hum", 759593450)
    answer = answered(case)
    assert (answer.outcome, answer.effects, answer.records) == (Outcome.DESCRIBED, (), ())
    (found,) = answer.described
    assert (found.place, found.parameter, found.law.variable) == ("nut", "nut_stiffness_n_per_m", Variable.ORDER)
    low, high = found.parameters["change"].interval_95
    assert low < (1.0 - case.truth["outside:preload-drift"]["share"]) ** (1.0 / 3.0) - 1.0 < high


def test_what_changes_the_nut_is_in_the_catalogue() -> None:
    assert {key for key in OF_NUT if not key.startswith(PREFIX)} <= effects_by_key().keys()


def test_another_axis_than_a_drive_has_no_nut_that_changes() -> None:
    layout = layout_of([20, 20], 1.0)
    comparison = LinearComparison(layout, np.ones((40, 1)), np.zeros(40), np.zeros((0, 40)))
    hypothesis = Hypothesis(LinearAxis({}, 1), (quantity(0),))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    assert not goes_with_time(fitted, fitted, 20.0, lambda _: None)


def test_what_is_left_open_to_time_says_what_to_measure() -> None:
    layout = layout_of([20, 20], 1.0, frequency=np.tile(np.geomspace(50.0, 500.0, 20), 2))
    comparison = LinearComparison(layout, np.ones((40, 1)), np.ones(40), np.zeros((0, 40)))
    hypothesis = Hypothesis(LinearAxis({}, 1), (quantity(0),))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    opened = EquivalenceClass(
        (Member(hypothesis.effects[0], fitted, 60.0, plausible=True),), (), 9.0, other_laws=(TIME_LAW,)
    )
    says = next_measurement(next_steps(SimpleNamespace(final=fitted), (opened,), Outcome.EQUIVALENT, ()))
    assert "measure the first settings once more at the end" in says
    assert "excitation" not in says
    assert (opened.others, opened.look_alikes) == ((TIME_LAW,), ())
    assert quoted_name(TIME_LAW) == "“Something that changes from one measurement to the next”"
    assert TIME_LAW != AMPLITUDE_LAW
