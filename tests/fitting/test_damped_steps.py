"""Test the search for a minimum within bounds against SciPy and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from monitor_core.fitting.solver.least_squares import Patience, minimum
from tests.fitting.strd import MODELS, agreed_digits, certified, regression

ANYWHERE = np.array([-np.inf, -np.inf]), np.array([np.inf, np.inf])
EXACT = Patience(most_evaluations=500, flat=1e-14)


def test_a_linear_problem_ends_where_the_normal_equations_do() -> None:
    rng = np.random.default_rng(1)
    slopes, wanted = rng.standard_normal((30, 4)) * [1.0, 1e3, 1e-4, 10.0], rng.standard_normal(30)
    found = minimum(
        lambda x: slopes @ x - wanted, lambda _: slopes, np.zeros(4), (np.full(4, -np.inf), np.full(4, np.inf)), EXACT
    )
    np.testing.assert_allclose(found, np.linalg.lstsq(slopes, wanted, rcond=None)[0], rtol=1e-6)


def test_certified_values_are_found_from_the_nearer_start(subtests: pytest.Subtests) -> None:
    """Of all 27 nonlinear regressions of the National Institute of Standards and Technology."""
    for name in sorted(MODELS):
        with subtests.test(name=name):
            expected, problem = certified(name), regression(name)
            anywhere = np.full(expected.values.size, -np.inf), np.full(expected.values.size, np.inf)
            found = minimum(problem.residuals, problem.jacobian, expected.starts[1], anywhere, EXACT)
            assert agreed_digits(found, expected.values) >= 4.0


@pytest.mark.parametrize("upper", [np.inf, 0.5])
def test_a_curved_valley_is_followed_to_its_end_or_its_bound(upper) -> None:
    """Rosenbrock's: the minimum is at (1, 1), and with x below ½ at (½, ¼)."""
    found = minimum(
        lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        lambda x: np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]),
        np.array([-1.2, 1.0]), (ANYWHERE[0], np.array([upper, np.inf])), EXACT,
    )  # fmt: skip
    np.testing.assert_allclose(found, [min(1.0, upper), min(1.0, upper) ** 2], atol=1e-6)


def test_bounded_problems_end_where_scipy_does(subtests: pytest.Subtests) -> None:
    """Some start on a bound, some end there; coordinates differ by orders of magnitude."""
    for seed in range(20):
        with subtests.test(seed=seed):
            assert_the_end_is_that_of_scipy(seed)


def assert_the_end_is_that_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slopes, curved = rng.standard_normal((2, 12, 5))
    wanted, scale = rng.standard_normal(12), 10.0 ** rng.uniform(-3.0, 3.0, 5)
    bounds = np.where(rng.random(5) < 0.5, 0.0, -np.inf), np.where(rng.random(5) < 0.3, 0.3 / scale, np.inf)

    def residuals(x):
        return slopes @ (scale * x) + 0.1 * (curved @ (scale * x)) ** 2 - wanted

    def jacobian(x):
        return (slopes + 0.2 * (curved @ (scale * x))[:, None] * curved) * scale

    expected = scipy.optimize.least_squares(
        residuals,
        np.clip(np.zeros(5), *bounds) + 1e-3 / scale,
        jacobian,
        bounds,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-12,
    )
    found = minimum(residuals, jacobian, np.zeros(5), bounds, EXACT)
    assert np.all((found >= bounds[0]) & (found <= bounds[1]))
    assert np.sum(residuals(found) ** 2) <= (1.0 + 1e-6) * 2.0 * expected.cost


def test_a_search_keeps_away_from_where_there_is_no_answer() -> None:
    """Of ln x there is none below null, where whole steps from far above lead."""
    asked = []

    def residuals(x):
        asked.append(x[0])
        return np.array([np.log(x[0]) if x[0] > 0.0 else np.inf])

    found = minimum(
        residuals,
        lambda x: np.array([[1.0 / x[0]]]),
        np.array([50.0]),
        (np.full(1, -np.inf), np.full(1, np.inf)),
        EXACT,
    )
    assert min(asked) <= 0.0
    assert found[0] == pytest.approx(1.0, abs=1e-6)


def test_derivatives_are_asked_for_only_where_a_step_is_taken_from() -> None:
    asked = {"residuals": [], "jacobian": []}

    def residuals(x):
        asked["residuals"].append(x.copy())
        return np.array([np.exp(x[0]) - 3.0, 1.0])

    def jacobian(x):
        asked["jacobian"].append(x.copy())
        return np.array([[np.exp(x[0])], [0.0]])

    bounds = np.full(1, -np.inf), np.full(1, np.inf)
    for most in (2, 3, 60):
        for calls in asked.values():
            calls.clear()
        found = minimum(residuals, jacobian, np.full(1, 2.0), bounds, Patience(most, flat=1e-5))
        assert len(asked["jacobian"]) < len(asked["residuals"]) <= most
        assert all(found[0] != x[0] for x in asked["jacobian"])


def test_a_search_that_only_fails_where_little_is_foretold_ends() -> None:
    """Derivatives of a minimum elsewhere: no step of theirs leads down, however short it is."""
    asked = []

    def residuals(x):
        asked.append(x[0])
        return np.array([100.0, x[0]])

    found = minimum(
        residuals,
        lambda _: np.array([[-0.01], [0.0]]),
        np.zeros(1),
        (np.full(1, -np.inf), np.full(1, np.inf)),
        replace(EXACT, for_nothing=1e-3),
    )
    assert found[0] == 0.0
    assert 3 < len(asked) < 10
