"""Priors as further data: the closed form of Gaussians, coverage, and which joints a model file frees."""

from dataclasses import dataclass

import numpy as np
import pytest

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.problem import Bounds, WithPriors, positive_parameter, stated_priors, with_priors
from monitor_core.fitting.solver.least_squares import fit_local


@dataclass(frozen=True)
class Readings:
    """Linear: repeated readings of a sum a + b and one of b alone, each with its standard uncertainty."""

    sums: FloatArray
    of_b: float
    uncertainty_of_sum: float = 0.5
    uncertainty_of_b: float = 0.2
    names: tuple[str, ...] = ("a", "b")

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        a, b = coordinates
        return np.append((a + b - self.sums) / self.uncertainty_of_sum, (b - self.of_b) / self.uncertainty_of_b)

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        of_sums = np.full((self.sums.size, 2), 1.0 / self.uncertainty_of_sum)
        return np.vstack([of_sums, [0.0, 1.0 / self.uncertainty_of_b]])


@dataclass(frozen=True)
class OneReading:
    """x ± u."""

    reading: float
    uncertainty: float
    names: tuple[str, ...] = ("x",)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        return (coordinates - self.reading) / self.uncertainty

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.array([[1.0 / self.uncertainty]])


def wide(n: int) -> Bounds:
    return Bounds(np.full(n, -100.0), np.full(n, 100.0))


@pytest.mark.parametrize(("reading", "u", "estimate", "u0"), [(3.0, 0.5, 2.0, 0.5), (3.0, 0.1, -4.0, 2.0)])
def test_reading_and_prior_combine_as_two_gaussians(reading: float, u: float, estimate: float, u0: float) -> None:
    problem = WithPriors(OneReading(reading, u), np.array([estimate]), np.array([u0]))
    fit = fit_local(problem, wide(1), np.zeros(1))
    weights = np.array([u**-2, u0**-2])
    assert fit.coordinates.values[0] == pytest.approx(weights @ [reading, estimate] / weights.sum(), rel=1e-9)
    assert fit.coordinates.standard_uncertainties[0] == pytest.approx(weights.sum() ** -0.5, rel=1e-9)
    # what is left of χ² is the distance of the two over the uncertainty of their difference
    assert fit.chi_squared == pytest.approx((reading - estimate) ** 2 / (u**2 + u0**2), rel=1e-9)


def test_prior_of_one_coordinate_reaches_the_other_through_their_sum() -> None:
    readings = Readings(np.array([4.9, 5.3, 5.0]), of_b=2.1)
    problem = WithPriors(readings, np.array([3.5, 0.0]), np.array([0.3, np.inf]))
    fit = fit_local(problem, wide(2), np.zeros(2))
    # Bayes for linear readings: covariance (AᵀV⁻¹A + P⁻¹)⁻¹, written out without the code under test
    design = np.array([[1.0, 1.0]] * 3 + [[0.0, 1.0], [1.0, 0.0]])
    weights = np.array([0.5, 0.5, 0.5, 0.2, 0.3]) ** -2
    covariance = np.linalg.inv(design.T @ (weights[:, None] * design))
    expected = covariance @ design.T @ (weights * [4.9, 5.3, 5.0, 2.1, 3.5])
    np.testing.assert_allclose(fit.coordinates.values, expected, rtol=1e-9)
    np.testing.assert_allclose(fit.coordinates.covariance, covariance, rtol=1e-8)
    assert fit.degrees_of_freedom == 3  # four readings and one prior, two coordinates


@pytest.mark.release
def test_intervals_of_a_fit_with_a_prior_cover() -> None:
    rng = np.random.default_rng(11)
    n, inside = 2000, np.zeros(2)
    for _ in range(n):
        truth = np.array([3.5 + 0.3 * rng.standard_normal(), 2.0])  # the prior speaks of where a comes from
        readings = Readings(truth.sum() + 0.5 * rng.standard_normal(3), of_b=truth[1] + 0.2 * rng.standard_normal())
        problem = WithPriors(readings, np.array([3.5, 0.0]), np.array([0.3, np.inf]))
        fit = fit_local(problem, wide(2), np.zeros(2))
        inside += np.abs(fit.coordinates.values - truth) <= 1.96 * fit.coordinates.standard_uncertainties
    # three standard errors of a share of 0.95 in 2000 trials
    np.testing.assert_allclose(inside / n, 0.95, atol=3.0 * np.sqrt(0.95 * 0.05 / n))


def test_derivatives_are_the_slopes_of_the_residuals() -> None:
    problem = WithPriors(Readings(np.array([1.0, 2.0]), 0.5), np.array([1.0, 2.0]), np.array([0.1, 0.4]))
    x, h = np.array([0.3, -0.7]), 1e-4
    slopes = [(problem.residuals(x + e) - problem.residuals(x - e)) / (2.0 * h) for e in h * np.eye(2)]
    np.testing.assert_allclose(problem.jacobian(x), np.transpose(slopes), rtol=1e-9, atol=1e-9)


def test_a_coordinate_that_nothing_is_known_of_adds_no_residual() -> None:
    readings = Readings(np.array([1.0]), 0.5)
    open_prior = WithPriors(readings, np.zeros(2), np.full(2, np.inf))
    np.testing.assert_array_equal(open_prior.residuals(np.ones(2)), readings.residuals(np.ones(2)))
    np.testing.assert_array_equal(open_prior.jacobian(np.ones(2)), readings.jacobian(np.ones(2)))
    assert with_priors(readings, None) is readings


def test_relative_prior_is_the_scatter_of_a_lognormal_joint() -> None:
    parameters = positive_parameter("bearing_stiffness", 4e7), positive_parameter("nut_stiffness", 7e8, 0.2)
    estimate, u = stated_priors(parameters)
    np.testing.assert_allclose(10.0**estimate, [4e7, 7e8], rtol=1e-12)
    assert np.isinf(u[0])
    drawn = 7e8 * np.exp(0.2 * np.random.default_rng(3).standard_normal(200_000))
    # standard error of a standard deviation from 200 000 draws is 0.16 %
    assert u[1] == pytest.approx(np.std(np.log10(drawn)), rel=6e-3)
    assert [parameter.transform.value(x) for parameter, x in zip(parameters, estimate, strict=True)] == pytest.approx(
        [4e7, 7e8]
    )


@pytest.mark.parametrize(
    ("estimate", "u", "complaint"),
    [
        ([0.0], [1.0, 1.0], "for each of 2 coordinates"),
        ([0.0, 0.0], [1.0], "for each of 2 coordinates"),
        ([0.0, 0.0], [1.0, 0.0], "must be positive; got 0.0"),
        ([0.0, 0.0], [-2.0, 1.0], "must be positive; got -2.0"),
        ([0.0, 0.0], [np.nan, 1.0], "must be positive; got nan"),
    ],
)
def test_priors_that_say_nothing_are_refused(estimate: list[float], u: list[float], complaint: str) -> None:
    with pytest.raises(OutsideValidityError, match=complaint):
        WithPriors(Readings(np.array([1.0]), 0.5), np.array(estimate), np.array(u))
