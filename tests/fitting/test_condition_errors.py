"""Errors that all values of a setting share: the whitening against the dense covariance matrix."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import linalg, stats

from monitor_core.fitting.comparison import CommonErrors
from monitor_core.fitting.solver.linearised import whitening

SIZES = (7, 1, 12, 3)
SETTING = np.repeat(np.arange(len(SIZES)), SIZES)
N = SETTING.size


def case(n_errors=3, size=1.0, seed=0):
    """Return deviations of values, directions of errors, and the dense covariance of both together."""
    rng = np.random.default_rng(seed)
    deviation = rng.uniform(0.5, 3.0, N)
    directions = size * rng.standard_normal((n_errors, N))
    same = SETTING[:, None] == SETTING
    return deviation, directions, np.diag(deviation**2) + same * (directions.T @ directions)


@pytest.mark.parametrize("n_errors", [0, 1, 3])
def test_residuals_are_those_of_the_symmetric_root_of_the_covariance(n_errors) -> None:
    deviation, directions, dense = case(n_errors)
    scaled = dense / np.outer(deviation, deviation)
    root = linalg.inv(linalg.sqrtm(scaled)).real / deviation
    misfit = np.random.default_rng(1).standard_normal(N)
    np.testing.assert_allclose(whitening(deviation, directions, SETTING)(misfit), root @ misfit, rtol=1e-10, atol=1e-12)


@given(st.floats(-8.0, 3.0), st.integers(0, 1000))
def test_sum_of_squares_is_that_of_the_dense_covariance(decades, seed) -> None:
    """Also where errors of settings are far below the noise, or outgrow it a thousand times (condition 1e7)."""
    deviation, directions, dense = case(size=10.0**decades, seed=seed)
    misfit = np.random.default_rng(seed).standard_normal(N) * deviation
    found = np.sum(whitening(deviation, directions, SETTING)(misfit) ** 2)
    assert found == pytest.approx(misfit @ linalg.solve(dense, misfit, assume_a="pos"), rel=1e-7)


def test_several_misfits_are_whitened_one_by_one() -> None:
    deviation, directions, _ = case()
    whitened = whitening(deviation, directions, SETTING)
    misfits = np.random.default_rng(2).standard_normal((4, N))
    np.testing.assert_allclose(whitened(misfits), [whitened(misfit) for misfit in misfits], rtol=1e-12)


def test_logarithm_of_the_determinant() -> None:
    """All settings, and the last two of them; without the deviations of the values."""
    deviation, directions, dense = case()
    whitened = whitening(deviation, directions, SETTING)
    scaled = dense / np.outer(deviation, deviation)
    assert whitened.log_determinant(np.ones(N, bool)) == pytest.approx(np.linalg.slogdet(scaled)[1])
    chosen = SETTING >= 2
    assert whitened.log_determinant(chosen) == pytest.approx(np.linalg.slogdet(scaled[np.ix_(chosen, chosen)])[1])


def test_most_likely_errors_are_the_mean_of_the_posterior() -> None:
    """Of e ~ N(0, I) and r = −Sᵀ e + noise, by dense algebra over all settings at once: cov(e, r) V⁻¹ r."""
    deviation, directions, dense = case()
    misfit = np.random.default_rng(3).standard_normal(N) * deviation
    errors = whitening(deviation, directions, SETTING).errors(misfit)
    weighted = linalg.solve(dense, misfit, assume_a="pos")
    for number in range(len(SIZES)):
        at = number == SETTING
        np.testing.assert_allclose(errors[number], -directions[:, at] @ weighted[at], rtol=1e-9)


def test_share_of_errors_is_what_they_change() -> None:
    deviation, directions, _ = case()
    errors = np.random.default_rng(4).standard_normal((len(SIZES), 3))
    by_hand = [float(directions[:, value] @ errors[SETTING[value]]) for value in range(N)]
    np.testing.assert_allclose(whitening(deviation, directions, SETTING).share_of(errors), by_hand, rtol=1e-12)


def test_residuals_and_pulls_are_standard_normal_over_draws() -> None:
    """Drawn as the covariance says; Kolmogorov and Smirnov at one in ten thousand."""
    deviation, directions, _ = case()
    whitened = whitening(deviation, directions, SETTING)
    rng = np.random.default_rng(5)
    residuals, pulls = [], []
    for _ in range(1500):
        errors = rng.standard_normal((len(SIZES), 3))
        misfit = deviation * rng.standard_normal(N) + np.sum(directions * errors[SETTING].T, axis=0)
        residuals.append(whitened(misfit))
        pulls.append(whitened.pulls(misfit))
    np.testing.assert_allclose(np.cov(np.transpose(residuals)), np.eye(N), atol=5.0 * np.sqrt(2.0 / 1500))
    for column in np.reshape(pulls, (1500, -1)).T:
        assert stats.kstest(column, "norm").pvalue > 1e-4


def test_an_error_of_which_the_values_say_nothing_has_no_pull() -> None:
    deviation, directions, _ = case()
    directions[1, SETTING == 2] = 0.0
    pulls = whitening(deviation, directions, SETTING).pulls(np.ones(N))
    unknown = np.zeros((len(SIZES), 3), bool)
    unknown[2, 1] = True
    np.testing.assert_array_equal(np.isnan(pulls), unknown)


def test_errors_that_values_of_different_settings_share() -> None:
    """By the symmetric root of the covariance as well; value by value a deviation of its own, some share nothing."""
    deviation, _, _ = case()
    rng = np.random.default_rng(7)
    group, share = rng.integers(0, 5, N), rng.uniform(0.0, 3.0, N)
    share[group == 4] = 0.0
    dense = np.diag(deviation**2) + (group[:, None] == group) * np.outer(share, share)
    scaled = dense / np.outer(deviation, deviation)
    root = linalg.inv(linalg.sqrtm(scaled)).real / deviation
    whitened = whitening(deviation, np.zeros((0, N)), SETTING, CommonErrors(group, share))
    misfits = rng.standard_normal((2, N))
    np.testing.assert_allclose(whitened(misfits), misfits @ root.T, rtol=1e-9, atol=1e-12)


def test_settings_may_be_numbered_with_gaps() -> None:
    """Those of a part of the data keep their numbers."""
    deviation, directions, _ = case()
    misfit = np.random.default_rng(6).standard_normal(N)
    np.testing.assert_array_equal(
        whitening(deviation, directions, 3 * SETTING + 5)(misfit), whitening(deviation, directions, SETTING)(misfit)
    )
