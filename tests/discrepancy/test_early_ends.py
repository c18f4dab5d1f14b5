"""A search ends where going on would change nothing of the answer."""

import numpy as np
import pytest

from benchmarks.blind_cases import Job, drawn
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.fitting.machine_sizes import sizes_of_drive
from tests.hidden_effects import frf_file
from tests.hidden_effects.answered import compared
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.machines import jittered, machine_named
from tests.hidden_effects.situations import Situation
from tests.hidden_effects.truth import transmission_line


def told(kind, seed):
    """Return the answer to a case of a centre at 21 settings, and what was said on the way."""
    centre = machine_named("centre")
    situation = Situation(machine=jittered(centre, np.random.default_rng([seed, 1])), design="usual")
    case = draw_case(kind, "large", 0.003, seed, respond=transmission_line.respond, situation=situation)
    return told_of(case)


def told_of(case):
    """Return the answer to a case, by an axis whose sizes are known, and what was said on the way."""
    comparison, drive = compared(case)
    sizes = sizes_of_drive(drive.physics({}), frf_file.observations(case))
    said = list[str]()
    return explain_comparison(comparison, drive, drive.candidates(sizes), sizes=sizes, progress=said.append), said


@pytest.mark.release
@pytest.mark.parametrize("kind", ["outside:screw-end-absorber", "outside:rotor-absorber"])
def test_what_has_no_name_is_asked_for_after_the_first_effect(kind) -> None:
    answer, said = told(kind, 41)
    assert answer.outcome == "described"
    assert not any(sentence.startswith("1 effect found") for sentence in said)


@pytest.mark.release
def test_what_has_no_name_and_explains_as_much_again_as_the_first_effect_is_asked_for_there_too() -> None:
    """Noise of 1 % leaves more of χ² than a tenth; further names beside an absorber on the nut took a minute."""
    situation = ("receptance", "transmission line", "bench", "rich", "assumed", "pink")
    answer, said = told_of(drawn(Job(182, "outside:rotor-absorber", "small", 0.01, *situation), 26585308))
    assert answer.outcome == "described"
    assert [found.place for found in answer.described] == ["motor"]
    assert not any(sentence.startswith("1 effect found") for sentence in said)


@pytest.mark.release
def test_of_a_pair_of_the_catalogue_the_search_goes_on() -> None:
    answer, said = told("added-mass+far-bearing-stiffness", 42)
    assert {effect.key for effect in answer.effects} == {"added-mass", "far-bearing-stiffness"}
    assert any(sentence.startswith("1 effect found") for sentence in said)
