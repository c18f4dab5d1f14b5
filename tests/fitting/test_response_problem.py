"""Whole responses of an axis in finite elements, with noise: joints come back, and their intervals cover."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak, FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.residuals.lines import ResidualForm, ResponseProblem, response_problem
from monitor_core.fitting.residuals.peaks import peak_problem
from monitor_core.fitting.solver.global_search import SearchSettings, search
from monitor_core.fitting.solver.least_squares import fit_local
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.models.published.receptance import ReceptanceModel
from monitor_core.recordings.model_file import read_model_file
from tests.identification import simulated, tian

AXIS = tian.axis()
JOINTS = tian.free(AXIS)
MODELS = tian.PUBLISHED.parent / "models"
TRUTH = JOINTS.start
NUT = 2
#: Two decades of stiffness and four of damping around the truth, which is nowhere near the middle of one's knowledge.
WIDE = Bounds(TRUTH - np.repeat([1.0, 2.0], 4), TRUTH + np.repeat([1.0, 2.0], 4))


@pytest.fixture(scope="module")
def exact():
    return simulated.receptances(AXIS)


@pytest.fixture(scope="module")
def fits(exact):
    rng = np.random.default_rng(7)
    return [fit_local(response_problem(JOINTS, simulated.noisy(exact, rng)), WIDE, TRUTH) for _ in range(60)]


@pytest.mark.release
def test_nut_stiffness_comes_back_within_half_a_percent(fits):
    errors = np.array([fit.coordinates.values[NUT] - TRUTH[NUT] for fit in fits]) * np.log(10)
    assert np.max(np.abs(errors)) < 0.005
    assert np.abs(errors.mean()) < 4 * errors.std() / np.sqrt(len(fits))  # no bias beside the scatter


@pytest.mark.release
def test_intervals_cover_as_often_as_they_say(fits):
    inside = [np.abs(fit.coordinates.values - TRUTH) <= 1.96 * fit.coordinates.standard_uncertainties for fit in fits]
    # 480 intervals of 95 %: 92 to 98 % is 3 standard deviations of the binomial, were they independent
    assert 0.92 < np.mean(inside) < 0.98


@pytest.mark.release
def test_residuals_are_as_large_as_the_noise(fits):
    n = fits[0].degrees_of_freedom
    chi_squared = np.array([fit.chi_squared for fit in fits]) / n
    assert chi_squared.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / n / len(fits)))


@pytest.mark.release
def test_wide_random_starts_agree(exact):
    problem = response_problem(JOINTS, simulated.noisy(exact, np.random.default_rng(1)))
    found = search(replace(problem, form=ResidualForm.LOGARITHMIC), WIDE, 1, SearchSettings(n_starts=20))
    assert found.agreement() >= 0.7
    final = fit_local(problem, WIDE, found.best.coordinates.values)
    assert final.converged
    shift = np.abs(final.coordinates.values - found.best.coordinates.values)
    assert np.all(shift < final.coordinates.standard_uncertainties)  # the same optimum but for the second order


@pytest.mark.release
def test_peaks_of_the_same_data_know_ten_times_less(exact, fits):
    bands, rng = tian.BANDS, np.random.default_rng(3)
    modes = peak_problem(JOINTS, tian.as_labelled(tian.measured("l1", "l3", "l5")), bands=bands).predict(TRUTH)
    errors = []
    for _ in range(20):
        peaks = []
        for observation, near in zip(simulated.noisy(exact, rng), modes.frequency.reshape(3, 4), strict=True):
            for mode, frequency in enumerate(near, start=1):
                f, a = simulated.picked_peak(observation, frequency)
                peaks.append(AssignedPeak(ModalObservation(observation.conditions, f, 0.002 * f, a, 0.05 * a), mode))
        fit = fit_local(peak_problem(JOINTS, peaks, bands=bands), WIDE, TRUTH)
        errors.append(fit.coordinates.values[NUT] - TRUTH[NUT])
    whole = [fit.coordinates.values[NUT] - TRUTH[NUT] for fit in fits]
    assert np.sqrt(np.mean(np.square(errors))) > 10 * np.sqrt(np.mean(np.square(whole)))


def test_jacobian_is_the_slope_of_the_residuals_at_all_points(subtests):
    for form, (excitation, response) in itertools.product(
        ResidualForm, [(e, r) for e in ExcitationPoint for r in ResponsePoint]
    ):
        with subtests.test(form=form, excitation=excitation):
            frequency, conditions = np.linspace(15.0, 900.0, 150), DriveConditions(0.7)
            measured = ReceptanceModel(replace(AXIS, nut_stiffness=8e8)).frequency_response(
                frequency, conditions, excitation=excitation, response=response
            )
            if not np.any(measured.response):
                pytest.skip("the model says zero there")
            observation = FrequencyResponseObservation(
                conditions, frequency, measured.response, 0.05 * np.abs(measured.response), excitation, response
            )
            problem, x, h = ResponseProblem(JOINTS, (observation,), form), TRUTH + 0.03, 3e-6
            slope = np.array([problem.residuals(x + e) - problem.residuals(x - e) for e in h * np.eye(8)]).T / (2 * h)
            # 1e-8: rounding of residuals of a few tens, over the step; of a joint that plays no part slopes are 0
            assert np.all(
                np.abs(problem.jacobian(x) - slope) <= 1e-5 * np.abs(slope).max(axis=0) + 1e-8 * slope.any(axis=0)
            )


def test_at_its_own_joints_a_response_leaves_nothing():
    frequency, conditions = np.linspace(15.0, 900.0, 150), DriveConditions(0.7)
    for excitation, response in ((e, r) for e in ExcitationPoint for r in ResponsePoint):
        values = ReceptanceModel(AXIS).frequency_response(
            frequency, conditions, excitation=excitation, response=response
        )
        observation = FrequencyResponseObservation(
            conditions, frequency, values.response, np.abs(values.response) + 1e-30, excitation, response
        )
        for form in ResidualForm:
            assert np.max(np.abs(ResponseProblem(JOINTS, (observation,), form).residuals(TRUTH))) < 1e-9


@pytest.mark.release
def test_both_forms_are_one_near_the_truth(exact):
    rng = np.random.default_rng(4)
    observations = simulated.noisy(exact, rng, noise=1e-4)
    by_form = [response_problem(JOINTS, observations, form=form).residuals(TRUTH) for form in ResidualForm]
    chi_squared = [np.sum(residuals**2) for residuals in by_form]
    assert chi_squared[0] == pytest.approx(chi_squared[1], rel=1e-3)


def test_too_little_is_refused():
    observation = FrequencyResponseObservation(
        DriveConditions(1.0), np.array([20.0, 30.0]), np.array([1e-7, 1e-8]), np.ones(2)
    )
    with pytest.raises(NotIdentifiableError, match="need 8 real and imaginary parts of lines at least; got 0"):
        response_problem(JOINTS, [])
    with pytest.raises(NotIdentifiableError, match="at 2 positions at least; got 1"):
        response_problem(JOINTS, [observation], minimum_positions=2)
    with pytest.raises(NotIdentifiableError, match="need 8 real and imaginary parts of lines at least; got 4"):
        response_problem(JOINTS, [observation])


def test_the_logarithm_of_nothing_is_refused():
    response = np.full(9, 1e-7)
    response[3] = 0.0
    observation = FrequencyResponseObservation(DriveConditions(1.0), np.linspace(20.0, 60.0, 9), response, np.ones(9))
    with pytest.raises(OutsideValidityError, match="got 0 at 35 Hz"):
        response_problem(JOINTS, [observation], form=ResidualForm.LOGARITHMIC)
    response_problem(JOINTS, [observation], form=ResidualForm.COMPLEX)


def test_joints_that_are_no_coordinates_are_refused():
    with pytest.raises(OutsideValidityError, match="nut_damping_ns_per_m must be stated and positive to be free"):
        tian.free(replace(AXIS, nut_damping=0.0), "nut_damping")
    lumped = FreeParameters("lumped", read_model_file(MODELS / "lumped.toml").parameters, ("nut_stiffness_n_per_m",))
    with pytest.raises(OutsideValidityError, match="compared with a receptance model; got a lumped model"):
        peak_problem(lumped, tian.as_labelled(tian.measured("l1", "l3")), bands=tian.BANDS)
    mass = FreeParameters("receptance", AXIS.to_file_names(), ("table_mass_kg",))
    with pytest.raises(OutsideValidityError, match=r"compared by their joints, .*; got table_mass_kg"):
        peak_problem(mass, tian.as_labelled(tian.measured("l1", "l3")), bands=tian.BANDS)
    with pytest.raises(OutsideValidityError, match=r"must have shape \(8,\)"):
        JOINTS.record(np.zeros(3))
