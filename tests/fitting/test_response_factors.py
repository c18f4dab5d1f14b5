"""A factor that is not known is taken out of a response as if it had been fitted, and costs what fitting it costs."""

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.lines import ResidualForm, ResponseProblem
from monitor_core.fitting.residuals.response_factors import FactorTolerance
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.models.published.receptance import ReceptanceModel
from tests.identification import tian

AXIS = tian.axis()
JOINTS = tian.free(AXIS)
FREQUENCY = np.linspace(15.0, 900.0, 120)
NEAR = JOINTS.start + 0.01
TOLERANCE = FactorTolerance(0.03, 0.07)


def measured(factor: complex, noise: float, position: float) -> FrequencyResponseObservation:
    rng = np.random.default_rng(round(1e3 * position))
    exact = (
        ReceptanceModel(AXIS)
        .frequency_response(
            FREQUENCY,
            DriveConditions(position),
            excitation=ExcitationPoint.FORCE_AT_TABLE,
            response=ResponsePoint.DISPLACEMENT_AT_TABLE,
        )
        .response
    )
    deviation = noise * np.abs(exact)
    scatter = rng.standard_normal(exact.size) + 1j * rng.standard_normal(exact.size)
    return FrequencyResponseObservation(
        DriveConditions(position), FREQUENCY, factor * exact + deviation * scatter, deviation
    )


OBSERVATIONS = (measured(1.04 - 0.03j, 0.02, 0.6), measured(0.98 + 0.05j, 0.02, 1.3))


def with_factors_as_coordinates(form: ResidualForm, x: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Residuals with gains and phases written out as unknowns and their deviations as data: ε₁, φ₁, ε₂, φ₂."""
    rows = []
    predicted = ResponseProblem(JOINTS, OBSERVATIONS).predict(x)
    for (gain, phase), lines, response in zip(factors.reshape(-1, 2), OBSERVATIONS, predicted, strict=True):
        if form is ResidualForm.COMPLEX:
            error = ((1.0 + gain + 1j * phase) * response - lines.response) / lines.standard_deviation
        else:
            error = np.log(response / lines.response) + gain + 1j * phase
            error = error * np.abs(lines.response) / lines.standard_deviation
        rows += [error.real, error.imag, [gain / TOLERANCE.gain, phase / TOLERANCE.phase]]
    return np.concatenate(rows)


def slopes(function, at, step):
    return np.array([function(at + h) - function(at - h) for h in step * np.eye(at.size)]).T / (2.0 * step)


@pytest.mark.parametrize("form", ResidualForm)
def test_residuals_and_information_are_those_with_the_factors_fitted(form):
    problem = ResponseProblem(JOINTS, OBSERVATIONS, form, TOLERANCE)
    # linear in the factors: one step of least squares is the minimum over them
    of_factors = slopes(lambda f: with_factors_as_coordinates(form, NEAR, f), np.zeros(4), 1e-3)
    fitted = np.linalg.lstsq(of_factors, -with_factors_as_coordinates(form, NEAR, np.zeros(4)), rcond=None)[0]
    written_out = with_factors_as_coordinates(form, NEAR, fitted)
    residuals = problem.residuals(NEAR)
    assert residuals.size == 2 * 2 * FREQUENCY.size  # as many as there are data: no degree of freedom is gained
    assert residuals @ residuals == pytest.approx(written_out @ written_out, rel=1e-9)
    # the information on the joints is what is left of that on both (Schur's complement)
    of_joints = slopes(lambda x: with_factors_as_coordinates(form, x, fitted), NEAR, 1e-6)
    both = np.hstack([of_joints, of_factors])
    expected = np.linalg.inv(np.linalg.inv(both.T @ both)[:8, :8])
    jacobian = problem.jacobian(NEAR)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        jacobian.T @ jacobian / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4
    )
    # half the slope of χ², exactly, however large the residuals are
    slope = slopes(lambda x: np.atleast_1d(0.5 * np.sum(problem.residuals(x) ** 2)), NEAR, 1e-5)[0]
    np.testing.assert_allclose((jacobian.T @ residuals) / scale, slope / scale, atol=1e-4 * np.linalg.norm(residuals))


def test_a_factor_of_the_whole_response_is_nearly_free_and_one_beyond_its_tolerance_is_not():
    """χ² of a response that is a factor off is (ln of it over its tolerance)², and no more."""
    exact = measured(1.0, 1e-6, 0.6)
    observation = FrequencyResponseObservation(
        exact.conditions, FREQUENCY, 1.02 * exact.response, 0.01 * np.abs(exact.response)
    )
    for form in ResidualForm:
        left = ResponseProblem(JOINTS, (observation,), form, FactorTolerance(0.05, 0.05)).residuals(JOINTS.start)
        assert left @ left == pytest.approx((0.02 / 0.05) ** 2, rel=0.05)
        taken = ResponseProblem(JOINTS, (observation,), form).residuals(JOINTS.start)
        assert taken @ taken == pytest.approx(FREQUENCY.size * 2.0**2, rel=0.05)


def test_a_tolerance_without_end_is_refused():
    with pytest.raises(OutsideValidityError, match=r"finite share and angle; got inf and 0\.05 rad"):
        FactorTolerance(gain=np.inf)
