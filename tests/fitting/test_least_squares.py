"""Local least squares against certified regressions, closed forms of straight lines, and laws."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.solver.least_squares import FitSettings, LocalFit, Patience, fit_local
from tests.fitting.strd import MODELS, agreed_digits, certified, regression

SCATTER = FitSettings(uncertainties_stated=False, patience=Patience(5000, flat=1e-16))


def everywhere(n: int) -> Bounds:
    return Bounds(np.full(n, -np.inf), np.full(n, np.inf))


@dataclass(frozen=True)
class Linear:
    """r = (X b − y)/σ, of which everything is known."""

    design: FloatArray
    response: FloatArray
    sigma: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"b{i}" for i in range(self.design.shape[1]))

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        return (self.design @ coordinates - self.response) / self.sigma

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return self.design / self.sigma


def line(sigma: float = 0.5) -> Linear:
    x = np.array([0.0, 1.0, 2.0, 4.0, 7.0])
    return Linear(np.column_stack([np.ones(5), x]), np.array([1.1, 1.4, 2.2, 2.9, 4.7]), sigma)


def test_certified_values_and_standard_deviations_of_all_27_regressions(subtests: pytest.Subtests) -> None:
    for start, name in itertools.product([0, 1], sorted(MODELS)):
        with subtests.test(start=start, name=name):
            expected = certified(name)
            fit = fit_local(regression(name), everywhere(expected.values.size), expected.starts[start], SCATTER)
            assert fit.converged
            # The file of Rat43 prints 9 degrees of freedom for 15 observations and 4 parameters; its s is that of 11.
            printed = 11 if name == "Rat43" else expected.degrees_of_freedom
            assert fit.degrees_of_freedom == fit.coordinates.degrees_of_freedom == printed
            assert agreed_digits(fit.coordinates.values, expected.values) >= 6.0
            # Lanczos1 is exact but for the fourteenth digit of its data: the rest is rounding of the data in the
            # computer, and with it the standard deviations, in which two or three digits are all that there are.
            digits = 2.0 if name == "Lanczos1" else 6.0
            assert agreed_digits(fit.coordinates.standard_uncertainties, expected.standard_deviations) >= digits
            scatter = np.array([fit.chi_squared, math.sqrt(fit.residual_variance)])
            expected_scatter = np.array([expected.residual_sum_of_squares, expected.residual_standard_deviation])
            assert agreed_digits(scatter, expected_scatter) >= digits


def test_covariance_of_a_line_is_the_textbooks_with_stated_and_with_estimated_scatter() -> None:
    problem = line()
    x = problem.design[:, 1]
    spread = np.sum((x - x.mean()) ** 2)
    stated = fit_local(problem, everywhere(2), np.zeros(2))
    assert stated.coordinates.standard_uncertainties[1] == pytest.approx(0.5 / math.sqrt(spread), rel=1e-12)
    assert stated.coordinates.standard_uncertainties[0] == pytest.approx(
        0.5 * math.sqrt(1 / 5 + x.mean() ** 2 / spread), rel=1e-12
    )
    assert stated.uncertainties_stated
    assert stated.coordinates.degrees_of_freedom == math.inf
    assert stated.residual_variance == 1.0

    estimated = fit_local(problem, everywhere(2), np.zeros(2), SCATTER)
    s = math.sqrt(np.sum((problem.design @ estimated.coordinates.values - problem.response) ** 2) / 3)
    assert estimated.coordinates.standard_uncertainties[1] == pytest.approx(s / math.sqrt(spread), rel=1e-12)
    assert not estimated.uncertainties_stated
    assert estimated.coordinates.degrees_of_freedom == 3


def test_a_bound_is_reached_exactly_named_and_the_rest_is_fitted_there() -> None:
    problem = line()
    free = fit_local(problem, everywhere(2), np.zeros(2))
    slope = 0.8 * free.coordinates.values[1]
    held = fit_local(problem, Bounds(np.array([-10.0, -10.0]), np.array([10.0, slope])), np.zeros(2))
    assert held.at_upper == ("b1",)
    assert held.at_lower == ()
    assert held.coordinates.values[1] == slope
    assert held.coordinates.values[0] == pytest.approx(np.mean(problem.response - slope * problem.design[:, 1]))
    assert held.converged
    # A bound is no measurement: the covariance is that of the data.
    assert held.coordinates.covariance == pytest.approx(free.coordinates.covariance)


def test_units_of_the_coordinates_change_nothing_but_their_own() -> None:
    problem = line()
    factor = np.array([1e6, 1e-5])
    scaled = Linear(problem.design / factor, problem.response, problem.sigma)
    unscaled, other = (fit_local(p, everywhere(2), np.zeros(2)) for p in (problem, scaled))
    assert other.chi_squared == pytest.approx(unscaled.chi_squared, rel=1e-12)
    assert other.coordinates.values == pytest.approx(unscaled.coordinates.values * factor, rel=1e-9)
    assert other.coordinates.standard_uncertainties == pytest.approx(
        unscaled.coordinates.standard_uncertainties * factor, rel=1e-9
    )


def only_the_sum() -> tuple[Linear, LocalFit]:
    x = np.array([1.0, 2.0, 3.0])
    problem = Linear(np.column_stack([x, x, np.zeros(3)]), np.array([2.1, 3.9, 6.0]), sigma=0.1)
    return problem, fit_local(problem, Bounds(np.full(3, -10.0), np.full(3, 10.0)), np.zeros(3))


def test_what_is_seen_keeps_its_uncertainty_beside_what_is_not() -> None:
    _, fit = only_the_sum()
    assert fit.converged
    assert fit.coordinates.values[:2].sum() == pytest.approx(np.dot([1, 2, 3], [2.1, 3.9, 6.0]) / 14)  # Σxy/Σx²
    assert (fit.coordinates.standard_uncertainties > 1e6).all()
    assert fit.standard_uncertainty_of(np.array([1.0, 1.0, 0.0])) == pytest.approx(0.1 / math.sqrt(14.0), rel=1e-9)
    assert fit.standard_uncertainty_of(np.array([1.0, -1.0, 0.0])) > 1e6
    # An unseen coordinate stays where it started: it is not sent to a bound for nothing.
    assert fit.coordinates.values[2] == 0.0


def test_too_few_residuals_are_refused() -> None:
    two_points = Linear(np.array([[1.0, 0.0], [1.0, 1.0]]), np.array([1.0, 2.0]))
    assert fit_local(two_points, everywhere(2), np.zeros(2)).chi_squared == pytest.approx(0.0, abs=1e-20)
    with pytest.raises(NotIdentifiableError, match="2 coordinates need at least 3 residuals; got 2"):
        fit_local(two_points, everywhere(2), np.zeros(2), SCATTER)
    one_point = Linear(np.array([[1.0, 0.0]]), np.array([1.0]))
    with pytest.raises(NotIdentifiableError, match="2 coordinates need at least 2 residuals; got 1"):
        fit_local(one_point, everywhere(2), np.zeros(2))


def test_a_flat_objective_and_wrong_starts_are_refused() -> None:
    with pytest.raises(NotIdentifiableError, match="flat"):
        fit_local(Linear(np.zeros((3, 2)), np.ones(3)), everywhere(2), np.zeros(2))
    with pytest.raises(OutsideValidityError, match="within the bounds"):
        fit_local(line(), Bounds(np.zeros(2), np.ones(2)), np.array([0.5, 2.0]))
    with pytest.raises(OutsideValidityError, match="one value per coordinate; got 3 and 2 for 2"):
        fit_local(line(), everywhere(2), np.zeros(3))


@dataclass(frozen=True)
class Walled:
    """r = log c − log 2, with no answer from the model below c = 1."""

    how: str
    names: tuple[str, ...] = ("c",)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        if coordinates[0] < 1.0:
            if self.how == "raises":
                raise OutsideValidityError("no mode there")
            return np.full(2, np.nan)
        return np.log(coordinates[0] / np.array([2.0, 2.0])) * 5.0

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.full((2, 1), 5.0 / coordinates[0])


@pytest.mark.parametrize("how", ["raises", "is not finite"])
def test_a_step_to_where_the_model_has_no_answer_is_shortened(how: str) -> None:
    # From 8 the linearised step is 8 (1 − ln 4) = −3.1: beyond the wall.
    fit = fit_local(Walled(how), Bounds(np.array([-50.0]), np.array([50.0])), np.array([8.0]))
    assert fit.coordinates.values[0] == pytest.approx(2.0, rel=1e-6)
    with pytest.raises(OutsideValidityError):
        fit_local(Walled(how), Bounds(np.array([-50.0]), np.array([50.0])), np.array([0.5]))


def test_a_fit_that_was_cut_short_says_so() -> None:
    expected = certified("MGH10")
    short = FitSettings(uncertainties_stated=False, patience=Patience(5, flat=1e-16))
    fit = fit_local(regression("MGH10"), everywhere(3), expected.starts[0], short)
    assert not fit.converged
    assert fit.chi_squared > 2.0 * expected.residual_sum_of_squares
    assert fit.expected_decrease > 0.0
