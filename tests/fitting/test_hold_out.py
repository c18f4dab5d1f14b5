"""Held-out values: who sees what, leave-one-out in closed form, and what a gain on them is worth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.hold_out import expected_gain, fitted_values, gain, gap_of
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.fitting.solver.hypothesis_fit import HeldOut, fit
from monitor_core.models.families import build_model
from monitor_core.recordings.model_file import parse_model
from tests.discrepancy.axes import LinearAxis, LinearComparison, layout_of, quantity
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.frf_file import observations
from tests.hidden_effects.situations import Situation
from tests.hidden_effects.truth import transmission_line

N = 24


def regression(folds, seed=0):
    """Return the fit of three quantities to values that each have a setting of their own, with its hat matrix."""
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((N, 3))
    deviation = rng.uniform(0.5, 2.0, N)
    data = design @ [1.0, -2.0, 0.5] + deviation * rng.standard_normal(N)
    comparison = LinearComparison(layout_of([1] * N, deviation, held_out=folds), design, data, np.zeros((0, N)))
    hypothesis = Hypothesis(LinearAxis({}, 3), tuple(quantity(index) for index in range(3)))
    fitted = fit(comparison, hypothesis, np.full(3, 0.5), fitted_values(comparison.layout))
    weighted = design / deviation[:, None]
    return fitted, weighted @ linalg.pinv(weighted)


def singly():
    return tuple(np.arange(N) == index for index in range(N))


def test_leaving_out_one_after_the_other_is_known_in_closed_form() -> None:
    """The residual of a value that the fit did not see is r/(1 − h) (Allen, 1974)."""
    fitted, hat = regression(singly())
    held = fitted.held_out
    assert np.all(held.chosen)
    expected = fitted.standardised / (1.0 - np.diag(hat))
    np.testing.assert_allclose(held.standardised, expected, atol=2e-3)
    np.testing.assert_allclose(held.misfit, expected * fitted.comparison.layout.standard_deviation, atol=4e-3)


def test_folds_of_several_values() -> None:
    """(I − H)⁻¹ r of each fold; a value that no fold leaves out is not judged."""
    folds = tuple((np.arange(N) // 6 == number) for number in range(3))
    fitted, hat = regression(folds)
    held = fitted.held_out
    np.testing.assert_array_equal(held.chosen, np.arange(N) < 18)
    for fold in folds:
        expected = linalg.solve((np.eye(N) - hat)[np.ix_(fold, fold)], fitted.standardised[fold])
        np.testing.assert_allclose(held.standardised[fold], expected, atol=2e-3)


def test_of_responses_a_fold_left_out_by_one_step_is_that_of_a_whole_fit() -> None:
    """Each of four preloads in turn, at three positions: the gap is the same, whether a step was enough or not."""
    case = draw_case("none", seed=31, respond=transmission_line.respond, situation=Situation(design="poor"))
    measured, file = observations(case), parse_model(case.baseline, "none")
    drive = DescribedDrive(build_model(file.family, file.parameters).parameters, dict(file.uncertain), {})
    comparison = compare_responses(measured, held_out=default_folds(each.conditions for each in measured))
    hypothesis = Hypothesis(drive)
    fitted = fit(comparison, hypothesis, hypothesis.null)
    assert len(comparison.layout.held_out) == 4
    for fold in comparison.layout.held_out:
        alone = fit(comparison, hypothesis, fitted.coordinates, ~fold)
        expected = comparison.gap(alone.misfit, alone.standardised, fold)
        found = comparison.gap(fitted.held_out.misfit, fitted.held_out.standardised, fold)
        assert found == pytest.approx(expected, rel=0.01)
        seen = comparison.gap(fitted.misfit, fitted.standardised, fold)
        assert found > seen  # what a fit has seen it meets better


def test_a_single_fold_is_never_fitted() -> None:
    """Whatever its values are, the fit is the same."""
    fold = np.arange(N) >= 18
    fitted, _ = regression((fold,))
    np.testing.assert_array_equal(fitted_values(fitted.comparison.layout), ~fold)
    comparison = replace(fitted.comparison, data=np.where(fold, 100.0, fitted.comparison.data))
    other = fit(comparison, fitted.hypothesis, np.full(3, 0.5), ~fold)
    np.testing.assert_array_equal(other.coordinates, fitted.coordinates)
    held = other.held_out
    np.testing.assert_array_equal(held.chosen, fold)
    deviation = comparison.layout.standard_deviation
    expected = (comparison.design @ other.coordinates - comparison.data) / deviation
    np.testing.assert_allclose(held.standardised[fold], expected[fold])


def test_folds_in_turn_are_all_fitted() -> None:
    fitted, _ = regression(singly())
    assert np.all(fitted_values(fitted.comparison.layout))


def test_without_folds_nothing_is_held_out() -> None:
    fitted, _ = regression(())
    assert np.all(fitted_values(fitted.comparison.layout))
    assert fitted.held_out is None
    assert math.isnan(gap_of(fitted.comparison, None))


def test_gap_is_that_of_the_held_out_values_alone() -> None:
    fitted, _ = regression((np.arange(N) >= 18,))
    found = gap_of(fitted.comparison, fitted.held_out)
    assert found == pytest.approx(np.sqrt(np.mean(fitted.standardised[18:] ** 2)))


def test_gain_is_the_difference_of_log_likelihoods() -> None:
    """Of independent normal residuals, all variances times s² and one value worth its share."""
    rng = np.random.default_rng(1)
    chosen = np.arange(10) < 7
    before, after = (HeldOut(chosen, rng.standard_normal(10), rng.standard_normal(10)) for _ in range(2))
    by = EvidenceScale(2.0, 0.25, 10)

    def log_likelihood(held):
        return sum(-0.5 * residual**2 / 2.0 for residual in held.standardised[:7]) * (0.75 / 1.25)

    assert gain(before, after, by) == pytest.approx(log_likelihood(after) - log_likelihood(before))


def test_promise_is_kept_on_average_by_the_truth() -> None:
    """Over draws from the second hypothesis: its mean, and the scatter √(2·promise) that the search allows for."""
    rng = np.random.default_rng(2)
    chosen = np.arange(50) < 30
    difference = rng.standard_normal(50)
    by = EvidenceScale(1.0, 0.0, 50)
    gains = []
    for _ in range(4000):
        noise = rng.standard_normal(50)
        before, after = HeldOut(chosen, noise, noise + difference), HeldOut(chosen, noise, noise)
        gains.append(gain(before, after, by))
    promised = expected_gain(before, after, by)
    assert promised == pytest.approx(0.5 * np.sum(difference[:30] ** 2))
    scatter = math.sqrt(2.0 * promised)
    assert np.mean(gains) == pytest.approx(promised, abs=4.0 * scatter / math.sqrt(4000))
    assert np.std(gains) == pytest.approx(scatter, rel=4.0 / math.sqrt(2 * 4000))
