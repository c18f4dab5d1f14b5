"""The form error of a model as a spectrum."""

import numpy as np
import pytest

from monitor_core.fitting.residuals.model_form import DEFAULT_SPECTRUM, FormSpectrum, ModelFormError, steepness
from monitor_core.models.protocol import ResponsePoint

SPECTRUM = FormSpectrum((10.0, 1000.0), (0.001, 0.005), frequency_tolerance=(1e-3, 2e-3), learnt=True)
FREQUENCY = np.geomspace(5.0, 2000.0, 400)


FLAT = np.ones(FREQUENCY.size, dtype=complex)


def tolerance_at(frequency):
    return 1e-3 + 1e-3 * np.clip(np.log(frequency / 10.0) / np.log(100.0), 0.0, 1.0)


def test_between_knots_it_is_linear_in_the_logarithm_of_frequency_and_constant_beyond() -> None:
    frequency = np.array([5.0, 10.0, 100.0, 1000.0, 2000.0])
    found = SPECTRUM.relative_deviation(frequency, np.ones(5, dtype=complex))
    np.testing.assert_allclose(found, [0.001, 0.001, 0.003, 0.005, 0.005])


@pytest.mark.parametrize("power", [-2.0, 0.0, 3.0])
@pytest.mark.parametrize("turning", [0.0, 5.0])
def test_a_shifted_frequency_shows_where_the_response_is_steep(power, turning) -> None:
    """Of H ∝ fⁿ⁺ʲᵐ a relative error ε of the frequency changes ln H by (n + jm) ε."""
    plain = SPECTRUM.relative_deviation(FREQUENCY, FLAT)
    found = SPECTRUM.relative_deviation(FREQUENCY, 7.0 * FREQUENCY ** (power + 1j * turning))
    expected = (tolerance_at(FREQUENCY) * np.hypot(power, turning)) ** 2
    np.testing.assert_allclose(found**2 - plain**2, expected, rtol=1e-6, atol=1e-15)


def test_a_resonance_counts_at_its_peak_most() -> None:
    """Of H = 1/(1 − r² + 2jζr): |d ln H/d ln r| = |(2r² − 2jζr) H|, 1/ζ at the peak, where the phase turns."""
    frequency = np.linspace(80.0, 120.0, 4001)
    ratio, damping = frequency / 100.0, 0.02
    response = 1.0 / (1.0 - ratio**2 + 2j * damping * ratio)
    expected = np.abs((2.0 * ratio**2 - 2j * damping * ratio) * response)
    assert np.max(expected) == pytest.approx(1.0 / damping, rel=1e-3)
    np.testing.assert_allclose(steepness(frequency, response), expected, rtol=1e-3)


def test_a_single_line_has_no_steepness() -> None:
    assert SPECTRUM.relative_deviation(np.array([10.0]), np.array([3.0 + 0j])) == pytest.approx(0.001)


def test_each_kind_of_response_has_its_own_spectrum_the_default_if_none_was_learnt() -> None:
    form = ModelFormError({ResponsePoint.ANGLE_AT_MOTOR: SPECTRUM})
    assert form.of(ResponsePoint.ANGLE_AT_MOTOR) is SPECTRUM
    assert form.of(ResponsePoint.ACCELERATION_AT_TABLE) is DEFAULT_SPECTRUM
