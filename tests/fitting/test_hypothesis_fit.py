"""The fit: closed form of a linear misfit, joint optimum with the errors of settings, ill starts, refusals."""

import contextlib
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import linalg, optimize

from monitor_core.effects import wrong_parameter
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver import hypothesis_fit
from monitor_core.fitting.solver.hypothesis_fit import GivenUpError, Pace, fit
from monitor_core.fitting.solver.least_squares import Patience
from monitor_core.fitting.solver.linearised import linearise
from monitor_core.models.extended import physics_of
from tests.discrepancy.axes import (
    AXIS,
    TOLERANCES,
    LinearAxis,
    LinearComparison,
    compared,
    covariance_of,
    effects_by_key,
    layout_of,
    measured,
    quantity,
    settings,
    subject,
    true_subject,
)

EFFECTS = effects_by_key()
SIZES = (30, 20, 30, 20)
DEVIATIONS = np.array([0.5, 2.0])  # priors of the first two quantities


def linear(seed=0, n_errors=2, size=4, noise=1.0):
    """Return a linear comparison, drawn from its own statement, with its subject."""
    rng = np.random.default_rng(seed)
    n = sum(SIZES)
    design = rng.standard_normal((n, size))
    deviation = rng.uniform(0.5, 2.0, n)
    directions = rng.standard_normal((n_errors, n))
    layout = layout_of(SIZES, deviation)
    theta = np.r_[DEVIATIONS * rng.standard_normal(2), 3.0 * rng.standard_normal(size - 2)]
    errors = rng.standard_normal((len(SIZES), n_errors))
    of_settings = np.sum(directions * errors[layout.setting].T, axis=0)
    data = design @ theta + noise * (deviation * rng.standard_normal(n) + of_settings)
    subject_ = LinearAxis({"a": DEVIATIONS[0], "b": DEVIATIONS[1]}, size)
    return LinearComparison(layout, design, data, directions), subject_


def closed_form(comparison, chosen):
    """Return posterior mean of θ and its covariance by generalised least squares with priors, dense."""
    dense = covariance_of(comparison)[np.ix_(chosen, chosen)]
    design, data = comparison.design[chosen], comparison.data[chosen]
    prior = np.zeros(design.shape[1])
    prior[:2] = DEVIATIONS**-2.0
    covariance = linalg.inv(design.T @ linalg.solve(dense, design) + np.diag(prior))
    return covariance @ design.T @ linalg.solve(dense, data), covariance


@pytest.mark.parametrize("last", [100, 80])
def test_linear_misfit_is_fitted_as_in_closed_form(last) -> None:
    """With all settings, and with one left out."""
    comparison, subject_ = linear()
    chosen = np.arange(100) < last
    hypothesis = Hypothesis(subject_, (quantity(2), quantity(3)))
    fitted = fit(comparison, hypothesis, hypothesis.null, chosen)
    expected, covariance = closed_form(comparison, chosen)
    deviations = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((fitted.physics() - expected) / deviations, 0.0, atol=1e-3)

    dense = covariance_of(comparison)[np.ix_(chosen, chosen)]
    misfit = (comparison.design @ expected - comparison.data)[chosen]
    chi_squared = misfit @ linalg.solve(dense, misfit) + np.sum((expected[:2] / DEVIATIONS) ** 2)
    own = np.sum(np.log(comparison.layout.standard_deviation[chosen] ** 2))
    assert fitted.cost == pytest.approx(chi_squared + np.linalg.slogdet(dense)[1] - own, abs=1e-3)


def test_derivatives_and_residuals_are_those_of_the_whitened_problem() -> None:
    comparison, subject_ = linear()
    hypothesis = Hypothesis(subject_, (quantity(2, scale=0.1), quantity(3)))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    dense = covariance_of(comparison)
    design = comparison.design * np.array([*DEVIATIONS, 0.1, 1.0])
    np.testing.assert_allclose(
        fitted.jacobian.T @ fitted.jacobian, design.T @ linalg.solve(dense, design), rtol=1e-6, atol=1e-6
    )
    residual = comparison.design @ fitted.physics() - comparison.data
    assert np.sum(fitted.standardised**2) == pytest.approx(residual @ linalg.solve(dense, residual))


def test_a_far_start_comes_to_the_same_end() -> None:
    comparison, subject_ = linear()
    hypothesis = Hypothesis(subject_, (quantity(2), quantity(3)))
    near, far = (fit(comparison, hypothesis, np.array(start)) for start in ([0.0] * 4, [5.0, -5.0, 40.0, -40.0]))
    np.testing.assert_allclose(near.coordinates, far.coordinates, atol=1e-3)


def test_no_step_is_linearised_twice(monkeypatch) -> None:
    """From a far start, through a tolerance."""
    comparison, subject_ = linear()
    hypothesis = Hypothesis(subject_, (quantity(2), quantity(3)))
    linearised, linearise_at = [], hypothesis_fit.linearise_at_likely_errors

    def watched(comparison, hypothesis, errors, deviation, coordinates, **estimated_by):
        linearised.append((errors.tobytes(), deviation.tobytes(), coordinates.tobytes()))
        return linearise_at(comparison, hypothesis, errors, deviation, coordinates, **estimated_by)

    monkeypatch.setattr(hypothesis_fit, "linearise_at_likely_errors", watched)
    fit(comparison, hypothesis, np.array([5.0, -5.0, 40.0, -40.0]))
    assert len({deviation for _, deviation, _ in linearised}) > 1
    assert len(linearised) == len(set(linearised))


def test_bounds_hold() -> None:
    """The data want the other sign."""
    comparison, subject_ = linear()
    (free,) = fit(comparison, Hypothesis(subject_, (quantity(2),)), np.zeros(3)).coordinates[2:]
    turned = replace(comparison, design=comparison.design * np.where(np.arange(4) == 2, -np.sign(free), 1.0))
    fitted = fit(turned, Hypothesis(subject_, (quantity(2, lower=0.0),)), np.array([0.0, 0.0, 1.0]))
    assert 0.0 <= fitted.coordinates[2] < 1e-2


# --- an axis ---------------------------------------------------------------------------------------------------------

FAR = effects_by_key()["far-bearing-stiffness"]
CONDITIONS = settings(positions=(0.2113, 0.5113, 0.8113), preloads=(150.0, 300.0))


def test_errors_of_settings_are_fitted_jointly() -> None:
    """As by least squares over coordinates and errors of all settings at once, where they are not linear.

    The fit may stop a tenth of χ² above the optimum.
    """
    rng = np.random.default_rng(3)
    off = [
        replace(
            conditions, position=conditions.position + 2e-3 * step, preload=conditions.preload * (1.0 + 0.04 * share)
        )
        for conditions, (step, share) in zip(CONDITIONS, rng.uniform(-1.0, 1.0, (6, 2)), strict=True)
    ]
    truth = FAR.added_to(true_subject(1), {"stiffness_n_per_m": 2e7})
    observations = [
        replace(observation, conditions=stated)
        for observation, stated in zip(measured(truth, off), CONDITIONS, strict=True)
    ]
    comparison = compared(observations)
    comparison = replace(comparison, tolerances=replace(comparison.tolerances, position=1.5e-3))
    hypothesis = Hypothesis(subject(), (FAR,))
    fitted = fit(comparison, hypothesis, np.array([0.0, 0.0, 0.0, 0.5]))
    n_coordinates, n_uncertain = hypothesis.n_coordinates, hypothesis.n_uncertain

    def residuals(unknowns):
        errors = unknowns[n_coordinates:].reshape(len(CONDITIONS), 3)
        misfit = comparison.shifted(errors).misfit(hypothesis.physics(unknowns[:n_coordinates]))
        scaled = misfit / comparison.layout.standard_deviation
        return np.concatenate([scaled, unknowns[:n_uncertain], unknowns[n_coordinates:]])

    errors = fitted.around.whitened_by.errors(fitted.misfit)
    assert np.max(np.abs(errors)) > 1.0  # far enough for the second order to count
    joint = optimize.least_squares(residuals, np.concatenate([fitted.coordinates, errors.ravel()]), x_scale="jac")
    there = np.sum(residuals(np.concatenate([fitted.coordinates, errors.ravel()])) ** 2)
    assert there - 2.0 * joint.cost < 0.1
    deviations = np.sqrt(np.diag(linalg.inv(joint.jac.T @ joint.jac)))[:n_coordinates]
    np.testing.assert_allclose((fitted.coordinates - joint.x[:n_coordinates]) / deviations, 0.0, atol=0.1)


def test_a_wrong_start_is_recovered_through_a_tolerance() -> None:
    """A tenth of the bracket's stiffness on a lightly damped axis; without a tolerance it ends at 369 for 1.

    The peaks do not touch, and the plain misfit has a minimum where they pass each other by.
    """
    light = replace(AXIS, loss_factor=0.005)
    comparison = compared(measured(physics_of(light), CONDITIONS))
    stated = replace(light, bracket_stiffness=0.1 * AXIS.bracket_stiffness)
    wrong = wrong_parameter("bracket_stiffness_n_per_m", stated)
    hypothesis = Hypothesis(DescribedDrive(stated, TOLERANCES, {}), (wrong,))
    fitted = fit(comparison, hypothesis, hypothesis.null)
    assert np.sqrt(np.mean(fitted.standardised**2)) < 1.1
    assert fitted.physics().joints.bracket_stiffness == pytest.approx(AXIS.bracket_stiffness, rel=0.1)


def test_linearised_misfit_is_that_of_the_shifted_comparison_less_what_the_errors_explain() -> None:
    comparison = compared(measured(true_subject(0), CONDITIONS))
    physics = true_subject(0)
    errors = np.random.default_rng(4).uniform(-2.0, 2.0, (6, 3))
    around = linearise(comparison, physics, errors, comparison.layout.standard_deviation)
    shifted = comparison.shifted(errors)
    by_errors = shifted.condition_errors(physics, shifted.misfit(physics))
    share = np.sum(by_errors * errors[comparison.layout.setting].T, axis=0)
    np.testing.assert_allclose(around.misfit(physics), shifted.misfit(physics) - share, atol=1e-12)
    # for small errors, whatever they are, it is the misfit itself
    small = linearise(comparison, physics, 1e-3 * errors, comparison.layout.standard_deviation)
    np.testing.assert_allclose(small.misfit(physics), comparison.misfit(physics), atol=1e-7)


def test_a_start_without_an_answer_is_refused() -> None:
    comparison = compared(measured(true_subject(0), CONDITIONS))
    hypothesis = Hypothesis(subject(screw_length=0.6))
    with pytest.raises(OutsideValidityError, match="position must lie on the screw"):
        fit(comparison, hypothesis, hypothesis.null)


def test_where_the_model_has_no_answer_the_step_is_shortened() -> None:
    """The data ask for more than any axis could have; the search goes that way as far as there are answers."""
    comparison, subject_ = linear()
    (free,) = fit(comparison, Hypothesis(subject_, (quantity(2),)), np.zeros(3)).coordinates[2:]

    def add(theta, values):
        if abs(values["size"]) > 0.5 * abs(free):
            raise OutsideValidityError("too much")
        return theta + values["size"] * np.eye(4)[2]

    hypothesis = Hypothesis(subject_, (replace(quantity(2), add=add),))
    fitted = fit(comparison, hypothesis, np.zeros(3))
    assert 0.3 < fitted.coordinates[2] / free <= 0.5


def test_from_a_bound_as_from_inside() -> None:
    """Most sizes are null where their range begins, and a fit may start there."""
    comparison, subject_ = linear()
    comparison = replace(comparison, data=comparison.data + 20.0 * comparison.design[:, 2])
    hypothesis = Hypothesis(subject_, (quantity(2, lower=0.0), quantity(3)))
    bound, inside = (fit(comparison, hypothesis, np.array([0.0, 0.0, at, 0.0])) for at in (0.0, 1.0))
    np.testing.assert_allclose(bound.coordinates, inside.coordinates, atol=1e-3)


def test_a_start_too_far_for_a_slope_to_mean_anything_stays_where_it_is() -> None:
    """Ten million standard deviations: an answer, not an error of the solver."""
    layout = layout_of([10] * 4, 1e-6)
    data = 10.0 * np.ones(40)
    comparison = LinearComparison(layout, np.zeros((40, 1)), data, np.zeros((0, 40)))
    fitted = fit(comparison, Hypothesis(LinearAxis({"a": 0.5}, 1)), np.zeros(1))
    np.testing.assert_array_equal(fitted.coordinates, 0.0)
    np.testing.assert_allclose(fitted.standardised, -1e7)


def test_minimum_does_not_depend_on_the_start() -> None:
    """Preloads that are wrong in all settings alike act as a stiffer nut: errors of settings might run along that."""
    truth = true_subject(0)
    axis = EFFECTS["added-mass"].added_to(truth, {"mass_kg": 2.0})
    comparison = compared(measured(axis, settings(preloads=(120.0, 300.0)), noise=0.003, seed=4))
    hypothesis = Hypothesis(subject(), (EFFECTS["added-mass"],))
    rng = np.random.default_rng(6)
    starts = [np.r_[0.5 * rng.standard_normal(hypothesis.n_uncertain), size] for size in (0.0, 2.0, 8.0)]
    costs = [fit(comparison, hypothesis, start).cost for start in starts]
    assert max(costs) - min(costs) < 0.1


# --- a fit that creeps -----------------------------------------------------------------------------------------------


def steps_until_given_up(costs: list[float], to_beat: float) -> int:
    """Return after how many costs a search is given up; all of them where it is not."""
    pace, taken = Pace(Patience(60, flat=1e-5), to_beat), 0
    with contextlib.suppress(GivenUpError):
        for taken, cost in enumerate(costs, start=1):
            pace.require(partial(float, cost), np.array([float(taken)]))
    return taken


def test_a_fit_that_creeps_is_given_up_where_it_cannot_beat_another() -> None:
    creeping = [6000.0 - step for step in range(60)]
    assert steps_until_given_up(creeping, 5700.0) == 11
    assert steps_until_given_up(creeping, 5941.0) == 60  # in the end it does
    assert steps_until_given_up(creeping, np.inf) == 60  # nothing to beat
    assert steps_until_given_up([6000.0 * 0.8**step for step in range(60)], 10.0) == 60
    refused = [6000.0, np.inf, 5999.0, np.inf, *creeping[2:]]
    assert steps_until_given_up(refused, 5700.0) <= 15
