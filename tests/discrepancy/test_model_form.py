"""The form error of a model as a spectrum."""

import numpy as np
import pytest

from monitor_core.discrepancy.comparing.model_form import DEFAULT_SPECTRUM, FormSpectrum, ModelFormError
from monitor_core.models.protocol import ResponsePoint

SPECTRUM = FormSpectrum((10.0, 1000.0), (0.001, 0.005), frequency_tolerance=1e-3, learnt=True)
FREQUENCY = np.geomspace(5.0, 2000.0, 400)


def test_between_knots_it_is_linear_in_the_logarithm_of_frequency_and_constant_beyond() -> None:
    flat = np.zeros(5)
    frequency = np.array([5.0, 10.0, 100.0, 1000.0, 2000.0])
    np.testing.assert_allclose(SPECTRUM.relative_deviation(frequency, flat), [0.001, 0.001, 0.003, 0.005, 0.005])


@pytest.mark.parametrize("slope", [-2.0, 0.0, 3.0])
def test_a_shifted_frequency_shows_where_the_response_is_steep(slope) -> None:
    """For a power law |H| ∝ fⁿ a relative error ε of the frequency is an error nε of the amplitude."""
    plain = SPECTRUM.relative_deviation(FREQUENCY, np.zeros_like(FREQUENCY))
    found = SPECTRUM.relative_deviation(FREQUENCY, slope * np.log(FREQUENCY) + 7.0)
    np.testing.assert_allclose(found**2 - plain**2, (1e-3 * slope) ** 2, rtol=1e-6, atol=1e-15)


def test_a_peak_counts_on_its_flanks() -> None:
    """Of |H| = 1/|1 − r² + 2jζr| the slope is 2r²(1 − r² − 2ζ²)/|…|²; at the peak itself nothing is added."""
    frequency = np.linspace(80.0, 120.0, 4001)
    ratio, damping = frequency / 100.0, 0.02
    square = (1.0 - ratio**2) ** 2 + (2.0 * damping * ratio) ** 2
    steepness = 2.0 * ratio**2 * (1.0 - ratio**2 - 2.0 * damping**2) / square
    plain = SPECTRUM.relative_deviation(frequency, np.zeros_like(frequency))
    found = SPECTRUM.relative_deviation(frequency, -0.5 * np.log(square))
    np.testing.assert_allclose(found, np.hypot(plain, 1e-3 * steepness), rtol=2e-3)


def test_a_single_line_has_no_steepness() -> None:
    assert SPECTRUM.relative_deviation(np.array([10.0]), np.array([3.0])) == pytest.approx(0.001)


def test_each_kind_of_response_has_its_own_spectrum_the_default_if_none_was_learnt() -> None:
    form = ModelFormError({ResponsePoint.ANGLE_AT_MOTOR: SPECTRUM})
    assert form.of(ResponsePoint.ANGLE_AT_MOTOR) is SPECTRUM
    assert form.of(ResponsePoint.ACCELERATION_AT_TABLE) is DEFAULT_SPECTRUM
