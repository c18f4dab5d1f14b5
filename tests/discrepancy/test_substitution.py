"""What would do in the place of something that was found: on linear data, where every rise of χ² is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.search.refits import substitute_effect, substitute_parameter
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity, wrong_quantity

N = 90
#: Three quantities: one uncertain, one that is there, one that looks nearly like it; a fourth is like neither.
TRUTH = np.array([0.1, 8.0, 0.0, 0.0])


def linear(uncertain=0.3, seed=0):
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((N, TRUTH.size))
    design[:, 2] = -0.5 * design[:, 1] + 0.02 * rng.standard_normal(N)
    comparison = LinearComparison(
        layout_of((30, 30, 30), 1.0), design, design @ TRUTH + rng.standard_normal(N), rng.standard_normal((1, N))
    )
    return comparison, LinearAxis({"a": uncertain}, TRUTH.size)


def fitted(comparison, subject, *effects):
    hypothesis = Hypothesis(subject, effects)
    return fit(comparison, hypothesis, np.full(hypothesis.n_coordinates, 0.5))


def test_rise_is_that_of_a_refit_with_the_other_effect() -> None:
    comparison, subject = linear()
    true, alike = quantity(1), quantity(2)
    found = fitted(comparison, subject, true)
    rise, start = substitute_effect(found, true, alike)
    refitted = fitted(comparison, subject, alike)
    # sizes are tried in steps of an eighth of an octave: at worst 4 % beside the best one, of 128 in χ² a percent
    steps = 0.04**2 * TRUTH[1] ** 2 * float(np.sum(comparison.design[:, 1] ** 2))
    assert refitted.cost - found.cost - 0.1 <= rise <= refitted.cost - found.cost + steps
    assert start[-1] == pytest.approx(refitted.coordinates[-1], rel=0.05)
    assert refitted.cost - found.cost < 25.0


def test_each_size_of_an_effect_is_tried() -> None:
    comparison, subject = linear()
    idle, like = quantity(3).parameters[0], quantity(2).parameters[0]
    two_sizes = replace(
        quantity(3),
        parameters=(idle, replace(like, name="other_size")),
        add=lambda theta, values: theta + np.array([0.0, 0.0, values["other_size"], values["size"]]),
    )
    found = fitted(comparison, subject, quantity(1))
    both, _ = substitute_effect(found, quantity(1), two_sizes)
    alone, _ = substitute_effect(found, quantity(1), quantity(2))
    assert both == pytest.approx(alone, rel=0.02)  # other sizes are tried where the range is another one
    with_its_own_frequency = replace(two_sizes, parameters=(idle, replace(like, name="frequency_hz", unit="Hz")))
    assert substitute_effect(found, quantity(1), with_its_own_frequency)[0] == math.inf


def test_what_is_not_alike_takes_no_ones_place() -> None:
    comparison, subject = linear()
    rise, _ = substitute_effect(fitted(comparison, subject, quantity(1)), quantity(1), quantity(3))
    assert rise > 1000.0


def test_an_effect_starts_in_the_place_of_the_parameter_that_is_pulled_furthest() -> None:
    """Without the second quantity the uncertain one, which looks the same, is pulled by 8/0.3 standard deviations."""
    comparison, subject = linear()
    comparison = replace(comparison, design=comparison.design[:, [1, 1, 2, 3]])
    pulled = fitted(comparison, subject)
    start = substitute_parameter(pulled, quantity(1))
    assert start is not None
    assert abs(pulled.coordinates[0]) > 20.0
    assert start[0] == 0.0
    assert start[1] == pytest.approx(TRUTH[1], rel=0.02)  # a valley is narrow: a twelfth beside it leads elsewhere
    assert substitute_parameter(fitted(*linear(uncertain=100.0)), quantity(1)) is None  # pulled by nothing


def test_a_parameter_without_its_tolerance_starts_in_the_place_of_another_one() -> None:
    """Two uncertain ones look the same, and together they are 2 off: between them they share it."""
    comparison, _ = linear()
    design = comparison.design[:, [1, 1, 2, 3]]
    comparison = replace(comparison, design=design, data=2.0 * design[:, 1])
    pulled = fitted(comparison, LinearAxis({"a": 0.4, "b": 0.3}, TRUTH.size))
    hypothesis = Hypothesis(pulled.hypothesis.axis, (wrong_quantity(1, "b"),))
    start = substitute_parameter(pulled, hypothesis.effects[0])
    assert abs(pulled.coordinates[0]) > 3.0
    assert hypothesis.uncertain == ("a",)
    assert start[0] == 0.0
    assert hypothesis.values(start)["wrong-parameter:b"]["ln_ratio"] == pytest.approx(2.0, rel=0.15)
