"""A nut that goes with the amplitude gets no other name where the excitation does not vary."""

import numpy as np
import pytest

from benchmarks.blind_cases import Job, drawn
from service.documents.explanation_sentences import next_measurement
from tests.hidden_effects.answered import answered
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.machines import jittered, machine_named
from tests.hidden_effects.situations import Situation


def poor(machine, seed):
    """Return a situation of twelve settings, whose excitation is one."""
    return Situation(machine=jittered(machine_named(machine), np.random.default_rng([seed, 1])), design="poor")


def is_left_open(answer) -> bool:
    """Return whether nothing is named, or the law of the amplitude is in the class of every name."""
    return answer.outcome == "unknown" or (
        answer.outcome == "equivalent" and all("amplitude-law" in effect.equivalent_to for effect in answer.effects)
    )


@pytest.mark.release
@pytest.mark.parametrize(
    ("kind", "size", "machine", "seed"),
    [("outside:contact-loss", "small", "gantry", 664844176), ("outside:nut-softening", "large", "mini", 664844156)],
)
def test_what_a_nut_that_hardens_would_explain_as_well_is_left_open(kind, size, machine, seed) -> None:
    """Softening and loss of contact, which pass for an exponent of the preload."""
    answer = answered(draw_case(kind, size, 0.003, seed, situation=poor(machine, seed)))
    assert is_left_open(answer)
    assert "excitation" in next_measurement(answer.next_steps)


@pytest.mark.release
@pytest.mark.parametrize("machine", ["gantry", "bench"])
def test_an_exponent_of_the_preload_keeps_its_name(machine) -> None:
    """A class of two at most, where a nut that goes with the amplitude would do as well."""
    answer = answered(draw_case("preload-exponent", "large", 0.003, 77, situation=poor(machine, 77)))
    (found,) = answer.effects
    assert found.key == "preload-exponent"
    assert set(found.equivalent_to) <= {"amplitude-law"}


@pytest.mark.release
def test_what_it_would_do_alone_in_the_place_of_all_leaves_every_name_open() -> None:
    """A softening passed for a compliant base beside an exponent; a cubic stiffness alone explains more than both."""
    situation = ("receptance", "finite elements", "mini", "poor", "uniform")
    answer = answered(drawn(Job(152, "outside:nut-softening", "large", 0.003, *situation), 957558161))
    assert is_left_open(answer)
    assert "excitation" in next_measurement(answer.next_steps)
