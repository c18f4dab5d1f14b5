"""A record of a machine of the plants that is not what its tag says is named, and what it hides is found."""

import pytest

from monitor_core.discrepancy.explanation import RecordFault
from tests.hidden_effects.answered import answered
from tests.hidden_effects.cases import NONE, draw_case
from tests.hidden_effects.machines import BENCH, machine_named
from tests.hidden_effects.situations import Situation, WrongRecord
from tests.hidden_effects.truth import finite_elements, transmission_line


def explained(kind, wrong, plant, seed, machine=BENCH):
    """Return the case and what the workflow makes of it with all of its candidates."""
    situation = Situation(machine=machine, design="usual", wrong=WrongRecord(*wrong))
    case = draw_case(kind, "large", seed=seed, respond=plant.respond, situation=situation)
    return case, answered(case)


@pytest.mark.release
@pytest.mark.parametrize("plant", [finite_elements, transmission_line], ids=["elements", "waves"])
def test_of_two_warm_records_the_one_that_was_cold_is_named_and_the_effect_is_found_in_the_other(plant) -> None:
    case, answer = explained("thermal-stiffness", ("temperature-tag", 1), plant, 610)
    (record,) = answer.records
    assert (record.number - 1, record.fault) == (case.wrong_setting, RecordFault.TEMPERATURE)
    assert record.stated == 15.0
    assert record.found == pytest.approx(0.0, abs=4.0 * record.standard_uncertainty)
    (effect,) = answer.effects
    assert effect.key == "thermal-stiffness"
    true = case.truth["thermal-stiffness"]["relative_change_per_k"]
    assert effect.parameters["relative_change_per_k"].estimate.value == pytest.approx(true, rel=0.1)


@pytest.mark.release
def test_a_wrong_preload_that_an_effect_of_all_preloads_would_half_explain_is_named_and_no_such_effect() -> None:
    machine = machine_named("mini")
    case, answer = explained("guide-stiffness", ("preload-tag", 2), transmission_line, 640, machine)
    assert [record.number - 1 for record in answer.records] == [case.wrong_setting]
    assert [effect.key for effect in answer.effects] == ["guide-stiffness"]


@pytest.mark.release
@pytest.mark.parametrize("seed", [620, 621])
def test_a_wrong_preload_is_named_where_the_fit_bends_to_it(seed) -> None:
    case, answer = explained(NONE, ("preload-tag", 2), finite_elements, seed)
    assert [record.number - 1 for record in answer.records] == [case.wrong_setting]
    assert answer.effects == ()
