"""An answer that says two things which cannot both be true is caught; answers of the workflow are none."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.contradictions import contradictions
from monitor_core.discrepancy.explanation import (
    Candidate,
    Explanation,
    FoundEffect,
    FoundParameter,
    Gap,
    GapPair,
    Outcome,
)
from monitor_core.discrepancy.search.search import is_clean, strain
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.uncertainty import Estimate
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity

SIZE = FoundParameter(Estimate(2.0, 0.2), "-", (1.6, 2.4), True)
EFFECT = FoundEffect("a", "A", "It is.", {"size": SIZE}, (), 80.0, 30.0)
GAP = Gap("sigma", 1.0, GapPair(2.0, 2.1), GapPair(0.98, 0.99))
GOOD = Explanation(Outcome.NAMED, (EFFECT,), (), (), GAP, (), (), {"position": 1.0}, 50.0, "", {}, {}, ())
UNDER = replace(GAP, before=GapPair(0.6, 0.6), after=GapPair(0.6, 0.6))
RISING = replace(UNDER, before=GapPair(0.8, 0.545), after=GapPair(0.5, 0.778))
NO_SIZE = replace(SIZE, interval_95=(-0.1, 4.1))

WRONG = {
    "missing under the floor": replace(GOOD, outcome=Outcome.UNKNOWN, effects=(), gap=UNDER),
    "more than nothing": replace(GOOD, outcome=Outcome.PARTIAL),
    "a gap that does not fall": replace(GOOD, gap=RISING),
    "effects of none": replace(GOOD, outcome=Outcome.NONE),
    "named without a name": replace(GOOD, effects=()),
    "named of two": replace(GOOD, effects=(replace(EFFECT, equivalent_to=("b",)),)),
    "equivalent to nothing": replace(GOOD, outcome=Outcome.EQUIVALENT),
    "all and much left": replace(GOOD, gap=replace(GAP, after=GapPair(5.0, 2.0))),
    "found twice": replace(GOOD, effects=(EFFECT, EFFECT)),
    "found and not": replace(GOOD, candidates=(Candidate("a", 3.0, 1.0, 0.1, "-"),)),
    "of no size": replace(GOOD, effects=(replace(EFFECT, parameters={"size": NO_SIZE}),)),
}  # fmt: skip


def test_a_contradiction_is_said(subtests: pytest.Subtests) -> None:
    for what, case in WRONG.items():
        with subtests.test(what=what):
            assert len(contradictions(case)) == 1


@pytest.mark.parametrize("answer", [
    GOOD,
    replace(GOOD, outcome=Outcome.NONE, effects=(), gap=UNDER),
    replace(GOOD, outcome=Outcome.UNKNOWN, effects=(), gap=UNDER, pulls={"preload": 2.1}),
    replace(GOOD, outcome=Outcome.PARTIAL, gap=replace(GAP, after=GapPair(1.5, 1.6))),
])  # fmt: skip
def test_a_sound_answer_has_none(answer) -> None:
    assert contradictions(answer) == ()


def fits(data, columns, tolerance=1.0, *, sizes=None, directions=None):
    """Return the fits of data by an uncertain quantity alone, and with a second one that is an effect."""
    n = data.size
    axis = LinearAxis({"a": tolerance}, 2)
    layout = layout_of(sizes or (n,), 1.0)
    comparison = LinearComparison(layout, columns, data, np.zeros((0, n)) if directions is None else directions)
    every, plain, effect = np.ones(n, dtype=bool), Hypothesis(axis), quantity(1)
    fuller = plain.with_effect(effect)
    return fit(comparison, plain, plain.null, every), fit(comparison, fuller, fuller.null, every), effect


def test_a_name_that_strains_what_is_declared_for_little_is_none() -> None:
    """The two quantities all but cancel: each is far off, and a healthy axis leaves as much as their difference."""
    columns = np.array([[1.0, -0.97]] * 200 + [[0.0, 1.0]] * 5)
    data = np.r_[np.full(200, 0.2), np.full(5, 6.0)] + 0.3 * np.random.default_rng(2).standard_normal(205)
    without, fuller, effect = fits(data, columns)
    assert strain(without, fuller) > 3.5
    assert not is_clean(without, fuller, effect)
    assert is_clean(*fits(data - columns @ [5.0, 0.0], columns))


def test_what_was_as_far_off_before_is_not_strained_by_a_name() -> None:
    """A parameter that is 5 of its tolerances off, seen by itself, and an effect that pulls it by a hair further."""
    columns = np.array([[1.0, 0.01]] * 100 + [[0.0, 1.0]] * 100)
    without, fuller, effect = fits(columns @ [5.0, -2.0] + np.tile([1.0, -1.0], 100), columns)
    assert 4.5 < without.coordinates[0] < fuller.coordinates[0]
    assert strain(without, fuller) == 0.0
    assert is_clean(without, fuller, effect)


def test_a_name_has_a_size_of_three_standard_deviations() -> None:
    """Of 100 values with noise 1 a mean is known to 0.1: one of 0.2 is none, one of 0.5 is a size."""
    columns = np.array([[0.0, 1.0]] * 100)
    scatter = np.tile([1.0, -1.0], 50)
    assert not is_clean(*fits(scatter + 0.2, columns))
    assert is_clean(*fits(scatter + 0.5, columns))


@pytest.mark.parametrize(("size", "is_one"), [(2.0, False), (8.0, True)])
def test_what_settings_are_pulled_by_is_missing_too_and_a_name_may_strain_for_it(size, is_one) -> None:
    """An effect that forty settings have to either side; without it each of them would be off by as much.

    Beside it stands what is declared, which five values of another setting show less of with the effect.
    """
    side = np.repeat(np.tile([1.0, -1.0], 20), 5)
    columns = np.vstack([np.column_stack([np.zeros(200), side]), [[1.0, 1.0]] * 5])
    data = columns @ [-0.6 * size - 3.5, size] + 0.3 * np.random.default_rng(2).standard_normal(205)
    directions = np.r_[np.ones(200), np.zeros(5)][None]
    without, fuller, effect = fits(data, columns, sizes=(5,) * 41, directions=directions)
    assert strain(without, fuller) > 3.5
    assert is_clean(without, fuller, effect) is is_one
