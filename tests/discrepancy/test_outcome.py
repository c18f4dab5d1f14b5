"""What a search means, as a table; and the pulls of settings that nothing is wrong with."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from benchmarks.blind_cases import Job, drawn
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.discrepancy.localisation import ranks_of
from monitor_core.discrepancy.search.workspace import PULLS_OF_TOLERANCES, variances_of_pulls
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, Member
from monitor_core.discrepancy.verdict.outcome import (
    LEAST_SHARE,
    PULLS,
    Remainder,
    _chance_of_groups,
    _chance_of_order,
    explained_share,
    follow_conditions,
    outcome_of,
    remainder_of,
)
from monitor_core.effects import ConditionAxis
from monitor_core.fitting.hold_out import REMAINDER, JudgedGap, fitted_values
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity
from tests.hidden_effects.answered import answered

MOST = 1.2  # what a healthy axis may leave, in noise floors
#: Just within and just beyond what counts as nothing left, in noise floors.
AT_FLOOR, LEFT = 0.999 * MOST, 1.001 * MOST
QUIET = {"position": 0.5 * PULLS, "gain 1": 0.5 * PULLS}
PULLED = {"position": 1.1 * PULLS}
GAINS = {"position": 0.1, "gain 1": 20.0 * PULLS}


def found(*plausible, delta_bic=100.0):
    """Return a class with members that are plausible or not, the representative first."""
    members = tuple(Member(quantity(at), None, delta_bic, is_plausible) for at, is_plausible in enumerate(plausible))
    return EquivalenceClass(members, (), 50.0)


def remainder(in_floors, pulls):
    return Remainder(JudgedGap(math.nan, math.nan, in_floors, MOST), pulls, misfit=math.nan)


GOOD, TWO, STAND_IN = found(True), found(True, True), found(False)
TABLE = {
    "nothing found, nothing left": ((), AT_FLOOR, QUIET, Outcome.NONE),
    "nothing found, something left": ((), LEFT, QUIET, Outcome.UNKNOWN),
    "nothing found, settings drift": ((), AT_FLOOR, PULLED, Outcome.UNKNOWN),
    "nothing found, gains off": ((), AT_FLOOR, GAINS, Outcome.NONE),
    "found": ((GOOD,), AT_FLOOR, QUIET, Outcome.NAMED),
    "two effects found": ((GOOD, GOOD), AT_FLOOR, QUIET, Outcome.NAMED),
    "not told apart": ((GOOD, TWO), AT_FLOOR, QUIET, Outcome.EQUIVALENT),
    "a remainder": ((GOOD,), LEFT, QUIET, Outcome.PARTIAL),
    "a remainder, not told apart": ((TWO,), LEFT, QUIET, Outcome.UNKNOWN),
    "a remainder, one told apart": ((TWO, GOOD), LEFT, QUIET, Outcome.PARTIAL),
    "settings drift, not told apart": ((TWO,), AT_FLOOR, PULLED, Outcome.PARTIAL),
    "settings drift": ((GOOD,), AT_FLOOR, PULLED, Outcome.PARTIAL),
    "a stand-in alone": ((STAND_IN,), AT_FLOOR, QUIET, Outcome.UNKNOWN),
    "a stand-in beside an effect": ((GOOD, STAND_IN), AT_FLOOR, QUIET, Outcome.PARTIAL),
    "a stand-in that explains more": ((GOOD, found(False, delta_bic=101.0)), AT_FLOOR, QUIET, Outcome.UNKNOWN),
}  # fmt: skip


def judged(classes, in_floors, pulls, explained=1.0):
    return outcome_of(classes, remainder(in_floors, pulls), explained=explained)


def test_outcome(subtests: pytest.Subtests) -> None:
    for what, (classes, in_floors, pulls, expected) in TABLE.items():
        with subtests.test(what=what):
            assert judged(classes, in_floors, pulls) is expected


@pytest.mark.parametrize("left", [(LEFT, QUIET), (AT_FLOOR, PULLED)])
def test_what_explains_too_little_may_stand_for_something_else(left) -> None:
    least = LEAST_SHARE
    assert judged((GOOD,), *left, explained=least) is Outcome.PARTIAL
    assert judged((GOOD,), *left, explained=0.999 * least) is Outcome.UNKNOWN
    assert judged((GOOD,), AT_FLOOR, QUIET, explained=0.999 * least) is Outcome.NAMED  # nothing is left


def linear(data, effects=(), *, held_out=(), directions=None):
    """Return the fit of effects, each of which adds one column of an orthonormal design, to 4 values in 10 settings."""
    layout = layout_of([4] * 10, np.ones(40), held_out=held_out)
    directions = np.zeros((0, 40)) if directions is None else directions
    hypothesis = Hypothesis(LinearAxis({}, 3), tuple(quantity(index) for index in effects))
    return fit(LinearComparison(layout, DESIGN, data, directions), hypothesis, hypothesis.null, fitted_values(layout))


DESIGN = np.linalg.qr(np.random.default_rng(3).standard_normal((40, 3)))[0]


def test_remainder_is_the_misfit_beyond_that_of_healthy_axes() -> None:
    """A step of 40 that nothing takes up: χ² is 1600 over 40 values."""
    left = remainder_of(linear(DESIGN @ [0.0, 40.0, 0.0]))
    assert left.gap.fit == pytest.approx(math.sqrt(40.0), rel=1e-6)
    assert math.isnan(left.gap.held_out)
    assert left.gap.exceeds_healthy
    assert left.gap.in_floors == pytest.approx(left.gap.fit, rel=1e-9)
    limit = max(REMAINDER, math.sqrt(stats.chi2.ppf(0.99, 40) / 40))
    assert left.misfit == pytest.approx(1600.0 * (1.0 - (limit / left.gap.in_floors) ** 2), rel=1e-6)


def test_remainder_counts_what_settings_are_pulled_by() -> None:
    """Settings that err by ± 2 standard deviations leave residuals of the size of noise, but a variance of 4."""
    directions = np.full((1, 40), 10.0)
    data = 10.0 * np.repeat(2.0 * (-1.0) ** np.arange(10), 4)
    left = remainder_of(linear(data, directions=directions))
    assert not left.gap.exceeds_healthy
    assert left.is_pulled()
    assert left.misfit == pytest.approx(10 * (4.0 - 1.0), rel=0.01)
    assert left.misfit_under(PULLS) == left.misfit
    # or the tolerances are too small
    assert left.misfit_under(PULLS_OF_TOLERANCES) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("share", "outcome"), [(0.9, Outcome.UNKNOWN), (0.99, Outcome.PARTIAL)])
def test_a_declared_parameter_that_is_pulled_beside_what_was_found_is_left(share, outcome) -> None:
    """By 5 of its deviations; without what was found, too, and the residuals show nothing of it."""
    deviation, size = 0.1, 5.0 * math.sqrt(share / (1.0 - share))
    data = DESIGN @ [1e3 * 5.0 * deviation, size, 0.0]
    comparison = LinearComparison(layout_of([4] * 10, np.ones(40)), 1e3 * DESIGN, data, np.zeros((0, 40)))
    baseline, final = (
        fit(comparison, hypothesis, hypothesis.null)
        for hypothesis in (
            Hypothesis(LinearAxis({"stiffness": deviation}, 3), effects) for effects in ((), (quantity(1),))
        )
    )
    left = remainder_of(final, counts_strain=True)
    assert not left.gap.exceeds_healthy
    assert left.strain == pytest.approx(5.0, rel=1e-2)
    assert left.misfit == pytest.approx(25.0, rel=2e-2)
    explained = explained_share(baseline, final, left.misfit)
    assert explained == pytest.approx(share, abs=5e-3)
    assert outcome_of((GOOD,), left, explained=explained) is outcome
    nothing_found = remainder_of(baseline, counts_strain=True)
    assert nothing_found.strain == pytest.approx(5.0, rel=0.1)
    assert outcome_of((), nothing_found, explained=0.0) is Outcome.UNKNOWN  # and never *none*


def errors_of_settings(errors):
    """Return a fit of ten settings that err so, in standard deviations, three of them at another level."""
    fitted = linear(10.0 * np.repeat(errors, 4), directions=np.full((1, 40), 10.0))
    layout = fitted.comparison.layout
    settings = tuple(
        replace(setting, values={ConditionAxis.LEVEL: 3.0 if number in AT_ANOTHER_LEVEL else 1.0})
        for number, setting in enumerate(layout.settings)
    )
    comparison = replace(fitted.comparison, layout=replace(layout, settings=settings))
    return replace(fitted, comparison=comparison)


AT_ANOTHER_LEVEL = (2, 5, 8)


def test_settings_that_scatter_at_random_follow_nothing() -> None:
    """One draw in a few hundred does, of errors three times as large as is stated."""
    rng = np.random.default_rng(11)
    follow = sum(follow_conditions(errors_of_settings(3.0 * rng.standard_normal(10))) for _ in range(300))
    assert follow <= 3


@pytest.mark.release
def test_many_looks_at_settings_that_scatter_find_no_more_than_one() -> None:
    """Six looks: at time and at five conditions, each of which three other settings have otherwise."""
    rng = np.random.default_rng(13)
    axes = [ConditionAxis.POSITION, ConditionAxis.PRELOAD, ConditionAxis.PAYLOAD, ConditionAxis.TEMPERATURE]
    follow = 0
    for _ in range(1500):
        fitted = errors_of_settings(rng.standard_normal(10))
        others = {axis: rng.permutation(10) < len(AT_ANOTHER_LEVEL) for axis in axes}
        settings = tuple(
            replace(setting, values={**setting.values, **{axis: float(at[i]) for axis, at in others.items()}})
            for i, setting in enumerate(fitted.comparison.layout.settings)
        )
        layout = replace(fitted.comparison.layout, settings=settings)
        follow += follow_conditions(replace(fitted, comparison=replace(fitted.comparison, layout=layout)))
    assert 0 < follow <= 7  # of a thousandth: one in a thousand such tests finds more


@pytest.mark.release
@pytest.mark.parametrize(("number", "noise", "disturbance"), [(276, 0.01, "loop"), (362, 0.003, "clean")])
def test_a_healthy_axis_whose_settings_scatter_twice_as_much_as_stated_has_nothing_missing(
    number, noise, disturbance
) -> None:
    """Two warm settings of 31 were other than the rest with a probability of 0.0005, two at another level of 0.0004."""
    situation = ("receptance", "finite elements", "mini", "rich", "larger", disturbance)
    answer = answered(drawn(Job(number, "none", "medium", noise, *situation), 759593450))
    assert (answer.outcome, answer.effects) == (Outcome.NONE, ())


def test_errors_that_go_with_a_condition_or_with_time_are_seen() -> None:
    scatter = np.random.default_rng(12).standard_normal(10)
    by_level = np.array([8.0 if number in AT_ANOTHER_LEVEL else 0.0 for number in range(10)])
    assert follow_conditions(errors_of_settings(scatter + by_level))
    assert follow_conditions(errors_of_settings(0.1 * scatter + np.arange(10.0)))
    assert not follow_conditions(errors_of_settings(scatter))


def test_remainder_is_judged_where_it_is_larger() -> None:
    """A step on held-out values alone."""
    fold = np.arange(40) < 8
    left = remainder_of(linear(np.where(fold, 4.0, 0.0), held_out=(fold,)))
    assert left.gap.fit == pytest.approx(0.0, abs=1e-6)
    assert left.gap.in_floors == pytest.approx(left.gap.held_out, rel=1e-9)
    assert left.gap.exceeds_healthy


def test_share_explained() -> None:
    """Two steps, 30 and 10, of which the second fit has the first."""
    before, after = linear(DESIGN @ [30.0, 10.0, 0.0]), linear(DESIGN @ [30.0, 10.0, 0.0], effects=(0,))
    assert explained_share(before, after, 100.0) == pytest.approx(900.0 / (900.0 + 100.0), rel=1e-6)
    assert explained_share(before, before, 100.0) == 0.0


def test_variances_of_pulls_are_one_where_all_is_right() -> None:
    """Over draws of 40 settings, about their mean: χ² of 39 degrees of freedom (Kolmogorov and Smirnov at 1e-4)."""
    rng = np.random.default_rng(1)
    n_settings, n = 40, 240
    layout = layout_of([6] * n_settings, 0.5)
    directions = rng.standard_normal((2, n))
    subject = LinearAxis({}, 1)
    drawn = []
    for _ in range(400):
        errors = rng.standard_normal((n_settings, 2))
        data = 0.5 * rng.standard_normal(n) + np.sum(directions * errors[layout.setting].T, axis=0)
        comparison = LinearComparison(layout, np.zeros((n, 1)), data, directions)
        fitted = fit(comparison, Hypothesis(subject), np.zeros(0))
        drawn.append(variances_of_pulls(fitted))
    for name in ("error 1", "error 2"):
        values = n_settings * np.array([variances[name] for variances in drawn])
        assert stats.kstest(values, stats.chi2(n_settings - 1).cdf).pvalue > 1e-4


def test_settings_that_err_alike_are_no_drift() -> None:
    """A preload too high by three standard deviations at every setting is a matter of the nut, not of settings."""
    layout, directions = layout_of([6] * 10, 0.1), np.ones((1, 60))
    alike = LinearComparison(layout, np.zeros((60, 1)), np.full(60, 3.0), directions)
    drifting = replace(alike, data=np.repeat(np.linspace(-5.0, 5.0, 10), 6))
    for comparison, left in ((alike, 0.0), (drifting, np.var(np.linspace(-5.0, 5.0, 10)))):
        fitted = fit(comparison, Hypothesis(LinearAxis({}, 1)), np.zeros(0))
        assert variances_of_pulls(fitted)["error 1"] == pytest.approx(left, rel=0.02, abs=1e-9)


def test_errors_that_nothing_tells_of_are_not_judged() -> None:
    comparison = LinearComparison(layout_of([3], 1.0), np.zeros((3, 1)), np.ones(3), np.array([[1.0] * 3, [0.0] * 3]))
    fitted = fit(comparison, Hypothesis(LinearAxis({}, 1)), np.zeros(0))
    assert list(variances_of_pulls(fitted)) == ["error 1"]


def test_ranks_and_chances_are_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        values = np.round(rng.standard_normal(int(rng.integers(7, 20))), 1)
        np.testing.assert_array_equal(ranks_of(values), stats.rankdata(values))
        order = stats.spearmanr(np.arange(values.size), values).pvalue
        assert _chance_of_order(values) == pytest.approx(order, rel=1e-9)
        groups = [values[:3], values[3:4], values[4:] + 0.5]
        assert _chance_of_groups(groups) == pytest.approx(stats.f_oneway(*groups).pvalue, rel=1e-9)
