"""The search: against all subsets of a linear problem, what held-out data refute, physics that comes in pairs."""

import math
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg

from monitor_core.discrepancy.search.refits import rivals_at
from monitor_core.discrepancy.search.search import find_again, find_steps, judge_found
from monitor_core.discrepancy.search.workspace import SearchSettings, Workspace, in_same_minimum, is_near
from monitor_core.effects.effect import ConditionAxis, EffectParameter
from monitor_core.fitting.evidence import delta_bic
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit, resolved_at
from tests.discrepancy.axes import LinearAxis, LinearComparison, covariance_of, layout_of, quantity, wrong_quantity

N, SIZES = 160, (40,) * 4
UNCERTAIN = {"a": 0.5}
HELD_OUT = np.arange(N) >= 120


def comparison_of(truth, rng, *, columns=None, held_out=()):
    """Return linear data with noise and errors of settings; the first quantity is uncertain."""
    design = rng.standard_normal((N, len(truth))) if columns is None else columns
    directions = 0.3 * rng.standard_normal((1, N))
    layout = layout_of(SIZES, 1.0, held_out=held_out)
    of_settings = directions[0] * rng.standard_normal(4)[layout.setting]
    return LinearComparison(layout, design, design @ truth + rng.standard_normal(N) + of_settings, directions)


def found_in(comparison, candidates, **settings):
    subject = LinearAxis(UNCERTAIN, comparison.design.shape[1])
    workspace = Workspace(comparison, subject, tuple(candidates), SearchSettings(**settings))
    return judge_found(workspace, find_steps(workspace))


def keys(fitted):
    return {effect.key for effect in fitted.hypothesis.effects}


# --- against all subsets ---------------------------------------------------------------------------------------------


def best_subset(comparison, candidates, most):
    """Return the subset with the least χ² + k ln n of all, by dense least squares with the prior."""
    dense = covariance_of(comparison)
    weight = linalg.inv(dense)

    def criterion(subset):
        design = comparison.design[:, [0, *subset]]
        normal = design.T @ weight @ design
        normal[0, 0] += 0.5**-2
        data = comparison.data
        explained = data @ weight @ design @ linalg.solve(normal, design.T @ weight @ data)
        return data @ weight @ data - explained + len(subset) * math.log(N)

    return min((subset for size in range(most + 1) for subset in combinations(candidates, size)), key=criterion)


@pytest.mark.parametrize("seed", range(8))
def test_finds_the_best_of_all_subsets(seed) -> None:
    """Of eight quantities up to three are there, each several times what the evidence asks for."""
    rng = np.random.default_rng([seed, 1])
    present = rng.permutation(np.arange(1, 9))[: seed % 4]
    truth = np.zeros(9)
    truth[0] = 0.5 * rng.standard_normal()
    truth[present] = rng.choice((-1.0, 1.0), present.size) * rng.uniform(0.8, 2.0, present.size)
    comparison = comparison_of(truth, rng)
    found = found_in(comparison, [quantity(index) for index in range(1, 9)])
    expected = {f"quantity-{index}" for index in best_subset(comparison, range(1, 9), 4)}
    assert keys(found.final) == expected == {f"quantity-{index}" for index in present}
    assert {finding.effect.key for finding in found.accepted} == expected
    assert all(finding.delta_bic > comparison.least_delta_bic for finding in found.accepted)


def test_a_healthy_axis_lacks_nothing() -> None:
    """In none of 40 draws: eight candidates at ΔBIC > 10 are claimed once in a thousand."""
    rng = np.random.default_rng(2)
    for _ in range(40):
        comparison = comparison_of(np.r_[0.5 * rng.standard_normal(), np.zeros(8)], rng)
        found = found_in(comparison, [quantity(index) for index in range(1, 9)])
        assert found.accepted == ()
        assert found.final is found.baseline
        assert found.steps == ()


@pytest.mark.parametrize(("left", "found"), [(0.0, set()), (0.9, {"quantity-1"})])
def test_weak_evidence_suffices_only_where_something_is_left(left, found) -> None:
    """An effect of ΔBIC 13, one of eight that are looked at: 10 + 2 ln 8 = 14.2 is asked for where the rest is noise.

    What is left is one more column that nothing explains, as large as raises the gap beyond that of healthy axes.
    """
    rng = np.random.default_rng(11)
    columns = np.linalg.qr(rng.standard_normal((N, 10)))[0] * math.sqrt(N)
    noise = rng.standard_normal(N)
    noise -= columns @ (columns.T @ noise) / N
    noise *= math.sqrt(N / float(noise @ noise))
    size = math.sqrt((13.0 + math.log(N)) * (1.0 + left**2) / N)
    layout = layout_of(SIZES, 1.0)
    data = size * columns[:, 1] + left * columns[:, 9] + noise
    comparison = LinearComparison(layout, columns[:, :9], data, np.zeros((1, N)))
    answer = found_in(comparison, [quantity(index) for index in range(1, 9)])
    assert keys(answer.final) == found


def test_a_parameter_far_off_its_tolerance_is_found_wrong() -> None:
    """Eight standard deviations; at two nothing is amiss."""
    rng = np.random.default_rng(3)
    for size, expected in ((4.0, {"wrong-parameter:a"}), (1.0, set())):
        comparison = comparison_of(np.array([size, 0.0, 0.0]), rng)
        assert keys(found_in(comparison, [wrong_quantity(0, "a"), quantity(1)]).final) == expected


def test_a_parameter_pulled_beyond_belief_needs_no_more_evidence_than_chance_does() -> None:
    """At five tolerances it is worth less than what the form of a model may feign, here 50, and more than chance."""
    for size, expected in ((2.9, {"wrong-parameter:a"}), (1.9, set())):
        comparison = replace(comparison_of(np.array([size, 0.0, 0.0]), np.random.default_rng(3)), least_delta_bic=50.0)
        found = found_in(comparison, [wrong_quantity(0, "a"), quantity(1)])
        assert keys(found.final) == expected


# --- one after the other ---------------------------------------------------------------------------------------------


def test_what_stood_for_two_is_left_out_again() -> None:
    """Two effects together look like a third one, which is found first."""
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((N, 4))
    columns[:, 3] = columns[:, 1] + columns[:, 2] + rng.standard_normal(N)
    comparison = comparison_of(np.array([0.0, 3.0, 3.0, 0.0]), rng, columns=columns)
    found = found_in(comparison, [quantity(1), quantity(2), quantity(3)])
    assert keys(found.steps[0]) == {"quantity-3"}
    assert keys(found.final) == {"quantity-1", "quantity-2"}
    assert found.steps[-1] is found.final


def test_without_an_effect_a_fit_is_no_worse_than_with_still_fewer(monkeypatch) -> None:
    """Left where a fuller fit ended, a fit may stay in a false minimum: evidence would then be of that alone."""
    comparison = comparison_of(np.array([0.1, 3.0, 3.0]), np.random.default_rng(2))
    first, second = quantity(1), quantity(2)
    workspace = Workspace(comparison, LinearAxis(UNCERTAIN, 3), (first, second))
    hypothesis = Hypothesis(workspace.axis)
    plain = fit(comparison, hypothesis, hypothesis.null)
    workspace.remember(plain)
    fuller = hypothesis.with_effect(first).with_effect(second)
    both = fit(comparison, fuller, np.zeros(3))
    far_off = replace(both, coordinates=both.coordinates + np.array([40.0, 0.0, 0.0]))

    def stuck_where_it_is_far_off(of, hypothesis, start, chosen=None, **options):
        fitted = fit(of, hypothesis, start, chosen)
        return resolved_at(fitted, start) if abs(start[0]) > 20.0 else fitted

    monkeypatch.setattr("monitor_core.discrepancy.search.workspace.fit", stuck_where_it_is_far_off)
    without = workspace.without(far_off, second)
    assert keys(without) == {"quantity-1"}
    assert without.cost < plain.cost
    best = fit(comparison, hypothesis.with_effect(first), np.zeros(2))
    assert without.cost == pytest.approx(best.cost, rel=1e-6)


def test_rivals_are_refitted_once_in_each_minimum(monkeypatch) -> None:
    """However far the fits in it stopped from one another; a fit elsewhere has rivals of its own."""
    comparison = comparison_of(np.array([0.1, 3.0, 3.0]), np.random.default_rng(2))
    workspace = Workspace(comparison, LinearAxis(UNCERTAIN, 3), (quantity(1), quantity(2)))
    hypothesis = Hypothesis(workspace.axis).with_effect(quantity(1))
    there = fit(comparison, hypothesis, np.zeros(2))
    started = []

    def counted(*arguments, **options):
        started.append(arguments)
        return fit(*arguments, **options)

    monkeypatch.setattr("monitor_core.discrepancy.search.workspace.fit", counted)
    rivals = rivals_at(workspace, there)
    n_fits = len(started)
    assert [rival.effect.key for rival in rivals] == ["quantity-2"]
    assert rivals_at(workspace, resolved_at(there, there.coordinates + 1e-4)) is rivals
    assert len(started) == n_fits
    assert rivals_at(workspace, resolved_at(there, there.coordinates + 0.5)) is not rivals


def test_what_every_axis_has_is_fitted_anew_with_other_records() -> None:
    """Where it was all that was found, the search had no fit without any effect to begin from."""
    ordinary = replace(quantity(1), ordinary=10.0)
    found = found_in(comparison_of(np.array([0.1, 3.0]), np.random.default_rng(3)), [ordinary])
    assert (found.accepted, keys(found.baseline)) == ((), {"quantity-1"})
    others = comparison_of(np.array([0.1, 3.0]), np.random.default_rng(4))
    workspace = Workspace(others, LinearAxis(UNCERTAIN, 2), (ordinary,))
    steps = find_again(workspace, found)
    assert keys(steps[0]) == set()
    assert keys(steps[-1]) == {"quantity-1"}


def test_what_resonates_beyond_the_band_surpasses_no_rival() -> None:
    """It would explain all, and is nothing but a mass or a spring there; the other effect explains a tenth."""
    rng = np.random.default_rng(2)
    comparison = comparison_of(np.array([0.1, 30.0, 10.0]), rng)
    comparison = replace(comparison, layout=layout_of(SIZES, 1.0, frequency=np.linspace(50.0, 500.0, N)))
    own = EffectParameter("frequency_hz", "Hz", lower=800.0, upper=1000.0, scale=10.0, null=900.0)
    size = quantity(1).parameters[0]

    def add(theta, values):
        return theta + values["size"] * np.array([0.0, 1.0, 1.0 / 3.0])

    beyond = replace(quantity(1, "beyond"), parameters=(size, own), add=add)
    workspace = Workspace(comparison, LinearAxis(UNCERTAIN, 3), (beyond, quantity(2)))
    hypothesis = Hypothesis(workspace.axis)
    rivals = rivals_at(workspace, fit(comparison, hypothesis, hypothesis.null))
    assert [rival.effect.key for rival in rivals] == ["quantity-2"]


@pytest.mark.parametrize(
    ("cost", "size", "tolerance", "same"),
    [
        (1000.05, 5.0, 0.0, True),
        (1001.0, 2.0, 0.0, False),
        (1001.0, 2.02, 0.3, True),
        (1001.0, 2.5, 0.3, False),
        (1003.0, 2.0, 0.3, False),
    ],
)
def test_fits_far_from_the_data_end_in_one_minimum_where_cost_and_place_are_alike(cost, size, tolerance, same) -> None:
    """There a fit stops once its tolerance shrinks by no more than a thousandth; any place leaves about as much."""
    hypothesis = Hypothesis(LinearAxis(UNCERTAIN, 2)).with_effect(quantity(1))
    first, second = (
        SimpleNamespace(cost=at, coordinates=np.array([0.0, of]), tolerance=tolerance, hypothesis=hypothesis)
        for at, of in ((1000.0, 2.0), (cost, size))
    )
    assert in_same_minimum(first, second) is same


def test_what_only_leads_out_of_a_false_minimum_is_not_found(monkeypatch) -> None:
    """A parameter set free of its tolerance may pass by what a fit is caught in."""
    comparison = comparison_of(np.array([0.1, 0.0]), np.random.default_rng(4))

    caught = iter([True])

    def caught_at_first(of, hypothesis, start, chosen=None, **options):
        fitted = fit(of, hypothesis, start, chosen)
        return resolved_at(fitted, np.array([12.0])) if next(caught, False) else fitted

    monkeypatch.setattr("monitor_core.discrepancy.search.workspace.fit", caught_at_first)
    found = found_in(comparison, [wrong_quantity(0, "a")])
    assert not keys(found.final)
    assert (found.steps, found.accepted) == ((), ())
    hypothesis = found.final.hypothesis
    assert found.baseline.cost == pytest.approx(fit(comparison, hypothesis, hypothesis.null).cost, rel=1e-6)
    assert found.final is found.baseline


def test_no_more_effects_than_allowed() -> None:
    rng = np.random.default_rng(5)
    comparison = comparison_of(np.r_[0.0, np.full(4, 2.0)], rng)
    found = found_in(comparison, [quantity(index) for index in range(1, 5)], most_effects=2)
    assert len(found.final.hypothesis.effects) == 2


@pytest.mark.parametrize(("frequency", "n_found"), [(np.nan, 4), (np.linspace(50.0, 500.0, N), 3)])
def test_where_three_effects_are_still_far_from_responses_no_fourth_is_sought(frequency, n_found) -> None:
    """Forces in time may have so many: what makes the largest part of them comes first."""
    comparison = comparison_of(np.r_[0.0, np.full(4, 40.0)], np.random.default_rng(5))
    comparison = replace(comparison, layout=layout_of(SIZES, 1.0, frequency=frequency))
    found = found_in(comparison, [quantity(index) for index in range(1, 5)], most_effects=5)
    assert len(found.final.hypothesis.effects) == n_found


@pytest.mark.parametrize(("off", "near"), [(3.0, True), (8.0, False)])
def test_screening_is_not_relied_upon_where_settings_are_pulled_far(off, near) -> None:
    """All misfits are small: an error of each setting takes them up."""
    side = np.repeat([1.0, -1.0, 1.0, -1.0], 40)
    comparison = LinearComparison(layout_of(SIZES, 0.005), np.ones((N, 1)), 0.01 * off * side, np.full((1, N), 0.01))
    hypothesis = Hypothesis(LinearAxis(UNCERTAIN, 1))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    assert np.max(np.abs(fitted.misfit)) < 0.15
    assert is_near(fitted) is near


def test_effects_are_tried_only_where_they_may_be_seen() -> None:
    """One needs a payload that varies, another acts on what the axis lacks; both would explain all."""
    rng = np.random.default_rng(6)
    comparison = comparison_of(np.array([0.0, 3.0]), rng)
    unseen = replace(quantity(1), needs=frozenset({ConditionAxis.PAYLOAD}))
    absent = replace(quantity(1), applies=lambda theta: False)
    assert found_in(comparison, [unseen, absent]).accepted == ()
    assert keys(found_in(comparison, [replace(quantity(1), needs=frozenset({ConditionAxis.POSITION}))]).final)


def test_what_would_do_in_the_place_of_an_effect_is_kept_beside_it() -> None:
    """With its evidence against the fit without either."""
    rng = np.random.default_rng(7)
    columns = rng.standard_normal((N, 4))
    columns[:, 2] = columns[:, 1] + 0.1 * rng.standard_normal(N)
    comparison = comparison_of(np.array([0.0, 3.0, 0.0, 0.0]), rng, columns=columns)
    found = found_in(comparison, [quantity(1), quantity(2), quantity(3)])
    (accepted,) = found.accepted
    (rival,) = [alternative for alternative in accepted.rivals if alternative.effect.key != "quantity-3"]
    assert {accepted.effect.key, rival.effect.key} == {"quantity-1", "quantity-2"}
    alone = found_in(comparison, [rival.effect]).final
    assert rival.delta_bic == pytest.approx(delta_bic(found.baseline, alone, found.evidence_scale), abs=0.1)


def test_a_user_is_told_what_is_being_tried() -> None:
    rng = np.random.default_rng(8)
    comparison = comparison_of(np.array([0.0, 3.0]), rng)
    reported = []
    workspace = Workspace(comparison, LinearAxis(UNCERTAIN, 2), (quantity(1),), progress=reported.append)
    judge_found(workspace, find_steps(workspace))
    assert reported[:3] == [
        "0 effects found, screening 1 more", "screening quantity-1 (1 of 1)", "refitting with quantity-1 (1 of 1)"
    ]  # fmt: skip
    assert "1 effect found, screening 0 more" in reported


# --- held-out data ---------------------------------------------------------------------------------------------------


def held_out_case(there):
    """Return data in which a quantity of 2 is present where they are fitted, and as stated where they are not."""
    rng = np.random.default_rng(9)
    comparison = comparison_of(np.array([0.0, 2.0, 0.0]), rng, held_out=(HELD_OUT,))
    change = (there - 2.0) * comparison.design[:, 1] * HELD_OUT
    return replace(comparison, data=comparison.data + change)


@pytest.mark.parametrize(("there", "accepted"), [(2.0, True), (1.5, True), (0.0, False), (-2.0, False)])
def test_an_effect_that_held_out_data_contradict_is_refused(there, accepted) -> None:
    """Where it is somewhat smaller it is no other effect."""
    found = found_in(held_out_case(there), [quantity(1), quantity(2)])
    assert keys(found.final) == ({"quantity-1"} if accepted else set())


def test_a_parameter_beyond_its_tolerance_may_change_held_out_residuals_for_the_worse() -> None:
    """It gains by its prior alone, and residuals hardly move; but no evidence makes up for a contradiction."""
    comparison = comparison_of(np.array([6.0, 0.0, 0.0]), np.random.default_rng(3), held_out=(HELD_OUT,))
    worse = replace(comparison, data=comparison.data - 0.35 * comparison.design[:, 0] * HELD_OUT)
    wrong = [wrong_quantity(0, "a")]
    assert keys(found_in(worse, wrong).final) == {"wrong-parameter:a"}
    assert keys(found_in(worse, wrong, forgiven_share=0.0, least_held_out_share=1.0).final) == set()
    contradicted = replace(comparison, data=comparison.data - 6.0 * comparison.design[:, 0] * HELD_OUT)
    assert keys(found_in(contradicted, wrong).final) == set()


def test_gain_on_held_out_data_is_that_of_the_effect() -> None:
    comparison = held_out_case(2.0)
    (accepted,) = found_in(comparison, [quantity(1)]).accepted
    # ½ Σ (A θ)² of what it explains there, but for the noise
    assert accepted.held_out_gain == pytest.approx(0.5 * 4.0 * np.sum(comparison.design[HELD_OUT, 1] ** 2), rel=0.25)


def test_a_rival_of_a_refused_effect_is_held_to_the_same() -> None:
    """It acts almost as the refused one does, and the same data contradict it."""
    comparison = held_out_case(-2.0)
    rng = np.random.default_rng(10)
    comparison.design[:, 2] = comparison.design[:, 1] + 0.2 * rng.standard_normal(N)
    found = found_in(comparison, [quantity(1), quantity(2)])
    assert found.accepted == ()


# --- strong physics in pairs -----------------------------------------------------------------------------------------


def pair(known):
    """Return two effects that all but cancel; alone either makes things hardly better."""
    rng = np.random.default_rng(11)
    columns = rng.standard_normal((N, 4))
    columns[:, 1] *= 30.0
    columns[:, 2] = columns[:, 3] - columns[:, 1]
    comparison = comparison_of(np.array([0.0, 1.0, 1.0, 0.0]), rng, columns=columns)
    comparison = replace(comparison, least_delta_bic=30.0)
    effects = [replace(quantity(index), textbook={"size": 1.0} if known else None) for index in (1, 2)]
    return found_in(comparison, effects)


def test_textbook_physics_is_switched_on_together() -> None:
    """Where a greedy search finds nothing, since each of the two alone is worth next to nothing."""
    assert keys(pair(known=False).final) == set()
    found = pair(known=True)
    assert keys(found.final) == {"quantity-1", "quantity-2"}
    assert keys(found.steps[0]) == {"quantity-1", "quantity-2"}
    np.testing.assert_allclose(found.final.coordinates[1:], 1.0, atol=0.2)


@pytest.mark.parametrize(("size", "scale", "has_rivals"), [(1.0, 30.0, False), (1.0, 3.0, True), (1.5, 30.0, True)])
def test_textbook_physics_without_which_the_data_are_far_has_no_rivals(size, scale, has_rivals) -> None:
    """Two effects do the same, and one of them is in the textbook, at the value found where that is 1."""
    rng = np.random.default_rng(12)
    columns = rng.standard_normal((N, 3))
    columns[:, 2] = columns[:, 1] = scale * columns[:, 1]
    comparison = comparison_of(np.array([0.0, size, 0.0]), rng, columns=columns)
    effects = [replace(quantity(1), textbook={"size": 1.0}), quantity(2)]
    (accepted,) = found_in(comparison, effects).accepted
    assert accepted.effect.key == "quantity-1" or has_rivals  # of two that do the same, rounding says which comes first
    assert bool(accepted.rivals) is has_rivals
