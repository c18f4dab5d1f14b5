"""Modes so low, or so damped, that the fit reaches 0 Hz: a right answer or a named refusal, never a traceback."""

import itertools

import numpy as np
import pytest
from scipy import stats

from monitor_core.modal import ModalMeasurement, ModeGate, fit_modes, measure_mode
from monitor_core.recording import Conditions, Rejection, Window
from monitor_core.spectral import band_spectra
from tests.recordings.test_session import START

N_WINDOWS = 12


def windows_of(modes, rate, n_samples, *, seed=0, noise=0.01):
    """Cut windows out of an endless record: the closed form of each accelerance on the lines of a long period."""
    rng = np.random.default_rng(seed)
    n_total = n_samples * (N_WINDOWS + 2)
    torque = 0.02 * rng.standard_normal(n_total)
    longest = int(np.clip(0.6 * rate / modes[0][0], 3, n_total // 20))
    for start in rng.integers(0, n_total, size=max(n_total // (8 * longest), 4)):
        length = int(rng.integers(2, longest + 1))
        pulse = np.sin(np.pi * (np.arange(length) + 0.5) / length)
        torque[(start + np.arange(length)) % n_total] += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5) * pulse
    spectrum, f = np.fft.rfft(torque), np.fft.rfftfreq(n_total, 1.0 / rate)
    spectrum[(f > 0.47 * rate) | (f == 0.0)] = 0.0
    response = sum(-gain * f**2 / (f0**2 - f**2 + 2j * zeta * f0 * f) for f0, zeta, gain in modes)
    channels = [np.fft.irfft(lines, n_total) for lines in (spectrum, response * spectrum)]
    channels[1] += noise * channels[1].std() * rng.standard_normal(n_total)
    cut = [channel[n_samples:-n_samples].reshape(N_WINDOWS, n_samples) for channel in channels]
    return tuple(Window(x, y, rate, START, Conditions(0.3), "a") for x, y in zip(*cut, strict=True))


def measured(modes, rate, n_samples, band, *, seed=0, gate=None):
    return measure_mode(windows_of(modes, rate, n_samples, seed=seed), band=band, gate=gate or ModeGate())


def assert_right_or_refused(answer, modes):
    """Find a mode within the interval of 95 %, or 0.1 %: to that, the lines of sampled ringing are rational."""
    if isinstance(answer, Rejection):
        return
    frequency = answer.mode.frequency
    half_width = stats.t.ppf(0.975, frequency.degrees_of_freedom) * frequency.standard_uncertainty
    nearest = min(abs(frequency.value - f0) - 1e-3 * f0 for f0, _, _ in modes)
    # four times out of a hundred an interval of 95 % is missed by chance; by half of it again hardly ever
    assert nearest <= 1.5 * half_width, (frequency, modes)


def test_a_mode_at_7_hz_is_found(subtests):
    for rate, (seconds, damping) in itertools.product([200.0, 500.0, 2000.0], [(2.0, 0.05), (4.0, 0.02), (4.0, 0.05)]):
        with subtests.test(rate=rate, seconds=seconds):
            # a second mode was started at the line at 0 Hz, where it is 0/0, and the fit ended in a traceback
            answer = measured([(7.0, damping, 1.0)], rate, int(rate * seconds), (2.0, 60.0))
            assert isinstance(answer, ModalMeasurement)
            assert answer.mode.frequency.value == pytest.approx(7.0, rel=2e-3)
            assert answer.mode.damping_ratio.value == pytest.approx(damping, rel=0.05)


def test_modes_at_50_and_75_hz_with_14_percent_are_told_apart_or_refused(subtests):
    for rate, seconds, gain in itertools.product([500.0, 1000.0, 2000.0], [1.0, 2.0], [0.8, -0.8]):
        with subtests.test(rate=rate, seconds=seconds):
            modes = [(50.0, 0.14, 1.0), (75.0, 0.14, gain)]
            assert_right_or_refused(measured(modes, rate, int(rate * seconds), (20.0, 150.0)), modes)


@pytest.mark.release
def test_every_mode_from_two_lines_to_two_fifths_of_nyquist_is_right_or_refused(subtests):
    for n_samples, place, damping, second in itertools.product(
        [256, 1000, 2000], [2, 3, 8, 30, None], [0.002, 0.03, 0.14, 0.2], [0.0, 0.8, -0.8]
    ):
        with subtests.test(n_samples=n_samples, place=place):
            rate = 1000.0
            resolution = rate / n_samples
            f0 = 0.2 * rate if place is None else place * resolution
            if f0 > 0.2 * rate:
                pytest.skip("above two fifths of the Nyquist frequency")
            modes = [(f0, damping, 1.0), (1.5 * f0, damping, second)][: 2 if second else 1]
            band = (max(0.6 * f0, 0.51 * resolution), min(2.2 * f0 + 3.0 * resolution, 0.45 * rate))
            assert_right_or_refused(measured(modes, rate, n_samples, band, seed=n_samples), modes)


def test_the_line_at_0_hz_is_no_datum_of_a_fit():
    # it was set to zero with the mean of each window: a fit that takes it for measured is drawn towards zero there
    windows = windows_of([(7.0, 0.13, 1.0)], 500.0, 1000)
    spectra = band_spectra(*(np.array([getattr(w, n) for w in windows]) for n in ("excitation", "response")),
                           500.0, (0.0, 100.0))  # fmt: skip
    assert spectra.frequency[0] == 0.0
    fit = fit_modes(spectra, frequency=7.0, damping_ratio=0.13)
    assert not isinstance(fit, Rejection)
    assert fit.band[0] == spectra.resolution


def test_a_second_mode_that_cannot_be_told_near_0_hz_widens_the_uncertainty():
    modes = [(3.0, 0.14, 1.0), (4.5, 0.14, -0.8)]
    answer = measured(modes, 1000.0, 1000, (1.8, 9.6), gate=ModeGate(maximum_frequency_uncertainty=1.0))
    assert isinstance(answer, ModalMeasurement), answer
    assert_right_or_refused(answer, modes)
    if answer.n_modes == 1:
        assert any("the lines end at 0 Hz" in warning for warning in answer.warnings)
