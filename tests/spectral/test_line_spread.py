"""What Hann windows of a known excitation show of a response: against an oscillator that is simulated in time."""

import numpy as np
import pytest
import scipy.signal

from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.residuals.resolution import STEPS, WEIGHTS
from monitor_core.response import LineSpread
from monitor_core.spectral import band_spectra, cross_spectra, estimate_frf, line_spread

RATE, SAMPLES = 1024.0, 1024
FREQUENCY = 120.0
AROUND = (FREQUENCY - 15.0, FREQUENCY + 15.0)


def poles(lines_wide):
    """Return the denominator of an oscillator that is so many lines wide between its half-power points."""
    damping = 0.5 * lines_wide * RATE / SAMPLES / FREQUENCY
    pole = np.exp(2.0 * np.pi * FREQUENCY / RATE * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    return np.real(np.poly([pole, np.conj(pole)]))


def pulses(at, *, n_windows=12, offset=0.0):
    """Return a short pulse in each window, drawn near a share of its length, on a constant torque."""
    rng = np.random.default_rng(4)
    time = np.arange(SAMPLES) / RATE
    places = at + rng.uniform(-0.04, 0.04, (n_windows, 1))
    return np.exp(-0.5 * ((time - places) / rng.uniform(1e-3, 2e-3, (n_windows, 1))) ** 2) + offset


def estimated(excitation, motion):
    frf = estimate_frf(cross_spectra(band_spectra(excitation, motion, RATE, AROUND)), quantity="torque_accelerance")
    return frf.frequency, frf.response


@pytest.mark.parametrize(("at", "higher"), [(0.15, True), (0.7, False)])
@pytest.mark.parametrize(("lines_wide", "error"), [(3.0, 4e-3), (1.5, 1e-2)])
def test_pulses_show_what_is_said_and_not_the_response(at, higher, lines_wide, error) -> None:
    """Where they lie early the window weighs the ringing more than them, and where late less."""
    excitation, denominator = pulses(at), poles(lines_wide)
    frequency, seen = estimated(excitation, scipy.signal.lfilter([1.0], denominator, excitation, axis=1))
    spread = line_spread(excitation, RATE, frequency)

    def response(at_frequency):
        return scipy.signal.freqz([1.0], denominator, at_frequency, fs=RATE)[1]

    said = np.sum(spread.weights * response(frequency + spread.offsets[:, None]), axis=0)
    np.testing.assert_allclose(seen / said, 1.0, atol=error)
    peak = np.argmax(np.abs(said))
    shown = abs(seen[peak] / response(frequency)[peak])
    assert shown > 1.1 if higher else shown < 0.9
    np.testing.assert_allclose(np.sum(spread.weights, axis=0), 1.0, atol=1e-12)


def test_a_torque_that_was_there_before_the_window_rings_nothing() -> None:
    pushed = line_spread(pulses(0.15, offset=3.0), RATE, np.arange(110.0, 131.0))
    free = line_spread(pulses(0.15), RATE, np.arange(110.0, 131.0))
    np.testing.assert_allclose(pushed.weights, free.weights, atol=1e-9)


def test_of_random_excitation_it_is_the_spectrum_of_the_window() -> None:
    """In expectation; of 20 000 windows to 2 %, and beyond the steps that are told apart there next to nothing."""
    excitation = np.random.default_rng(1).standard_normal((20_000, 64))
    spread = line_spread(excitation, 64.0, np.array([10.0, 20.0]))
    expected = dict(zip(STEPS.tolist(), WEIGHTS.tolist(), strict=True))
    for offset, weights in zip(spread.offsets, spread.weights, strict=True):
        np.testing.assert_allclose(weights, expected.get(offset, 0.0), atol=0.01)


def test_lines_next_to_zero_have_neighbours_below_it() -> None:
    spread = line_spread(pulses(0.3), RATE, np.array([1.0, 2.0]))
    assert np.all(np.isfinite(spread.weights))
    assert spread.of_lines(np.array([False, True])).weights.shape == (spread.offsets.size, 1)


def test_lines_between_those_of_the_windows_are_refused() -> None:
    with pytest.raises(OutsideValidityError, match="whole multiples of 1 Hz"):
        line_spread(pulses(0.3), RATE, np.array([10.5]))


def test_a_spread_begins_with_the_line_itself() -> None:
    with pytest.raises(OutsideValidityError, match="that of the line itself first"):
        LineSpread(np.array([-0.5, 0.0]), np.ones((2, 3)))
