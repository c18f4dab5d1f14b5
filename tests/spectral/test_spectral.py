"""Spectra, frequency responses and coherence against scipy, closed forms and simulation."""

import numpy as np
import pytest
import scipy.signal

from monitor_core.errors import OutsideValidityError
from monitor_core.spectral import (
    band_spectra,
    coherence_bias,
    cross_spectra,
    effective_averages,
    estimate_frf,
    least_leaking_taper,
    random_error,
    significance_level,
)

RATE, N_SAMPLES = 1000.0, 1000
BAND = (40.0, 160.0)


def noisy_pair(rng, n_windows, n_samples=N_SAMPLES, noise=1.0):
    """Excitation and response of a first-order system, with as much noise as signal at ``noise=1``."""
    x = rng.standard_normal((n_windows, n_samples))
    clean = scipy.signal.lfilter([0.5], [1.0, -0.5], x, axis=1)
    return x, clean + noise * clean.std() * rng.standard_normal(x.shape)


@pytest.mark.parametrize("n_samples", [1000, 1001])
def test_h1_and_coherence_equal_scipys(n_samples):
    # The Hann taper is applied after the transform here, before it in scipy: rounding is all that may differ.
    rng = np.random.default_rng(1)
    x, y = noisy_pair(rng, 12, n_samples)
    x += 7.0
    frf = estimate_frf(cross_spectra(band_spectra(x, y, RATE, BAND)), quantity="torque_accelerance")

    settings = {"fs": RATE, "window": "hann", "nperseg": n_samples, "noverlap": 0}
    frequency, sxy = scipy.signal.csd(x.ravel(), y.ravel(), **settings)
    _, sxx = scipy.signal.welch(x.ravel(), **settings)
    _, coherence = scipy.signal.coherence(x.ravel(), y.ravel(), **settings)
    lines = (frequency >= BAND[0]) & (frequency <= BAND[1])
    np.testing.assert_allclose(frf.frequency, frequency[lines], rtol=1e-12)
    np.testing.assert_allclose(frf.response, (sxy / sxx)[lines], rtol=1e-12)
    np.testing.assert_allclose(frf.coherence, coherence[lines], rtol=1e-12)


@pytest.mark.parametrize("taper", ["hann", "rectangular"])
def test_window_by_window_equals_all_at_once(taper):
    x, y = noisy_pair(np.random.default_rng(2), 9)
    batch = cross_spectra(band_spectra(x, y, RATE, BAND), taper=taper)
    stream = cross_spectra(band_spectra(x[:1], y[:1], RATE, BAND), taper=taper)
    for i in range(1, 9):
        stream = stream + cross_spectra(band_spectra(x[i : i + 1], y[i : i + 1], RATE, BAND), taper=taper)
    assert stream.n_averages == batch.n_averages == 9.0
    for name in ("excitation_power", "response_power", "cross_power"):
        np.testing.assert_allclose(getattr(stream, name), getattr(batch, name), rtol=1e-12)


def test_single_precision_stays_single_and_agrees():
    x, y = noisy_pair(np.random.default_rng(3), 4)
    single = band_spectra(x.astype(np.float32), y.astype(np.float32), RATE, BAND)
    assert single.excitation.dtype == single.response.dtype == np.complex64
    double = estimate_frf(cross_spectra(band_spectra(x, y, RATE, BAND)), quantity="accelerance")
    frf = estimate_frf(cross_spectra(single), quantity="accelerance")
    # 24 bits of mantissa through an FFT of 1000 points: a few 1e-7 of the largest line.
    np.testing.assert_allclose(frf.response, double.response, rtol=1e-4)


def test_estimators_stand_as_their_definitions_demand():
    x, y = noisy_pair(np.random.default_rng(4), 20)
    cross = cross_spectra(band_spectra(x, y, RATE, BAND))
    h1, h2, hv = (estimate_frf(cross, estimator=e, quantity="accelerance") for e in ("H1", "H2", "Hv"))
    np.testing.assert_allclose(h1.response / h2.response, h1.coherence, rtol=1e-12)
    np.testing.assert_allclose(hv.response**2, h1.response * h2.response, rtol=1e-12)


def test_estimators_are_unbiased_where_their_noise_is():
    # H1 under noise on the response, H2 under noise on the excitation; the other one is off by 1/γ² = 2.
    rng = np.random.default_rng(5)
    clean = rng.standard_normal((400, 256))
    noisy = clean + rng.standard_normal(clean.shape)
    band = (20.0, 200.0)
    forward = cross_spectra(band_spectra(clean, noisy, RATE, band))
    backward = cross_spectra(band_spectra(noisy, clean, RATE, band))

    def level(cross, estimator):
        return np.mean(estimate_frf(cross, estimator=estimator, quantity="accelerance").response).real

    # 400 windows × 46 lines: standard error of the mean below 1 %.
    assert level(forward, "H1") == pytest.approx(1.0, abs=0.02)
    assert level(forward, "H2") == pytest.approx(2.0, abs=0.04)
    assert level(backward, "H2") == pytest.approx(1.0, abs=0.02)
    assert level(backward, "H1") == pytest.approx(0.5, abs=0.02)


def test_one_average_has_no_coherence_to_judge():
    x, y = noisy_pair(np.random.default_rng(6), 1)
    frf = estimate_frf(cross_spectra(band_spectra(x, y, RATE, BAND)), quantity="accelerance")
    assert frf.coherence is None
    assert frf.n_averages == 1.0
    with pytest.raises(OutsideValidityError, match="at least 2 averages"):
        significance_level(1.0)


def test_impacts_near_the_start_call_for_the_rectangular_taper_and_ringing_across_the_ends_for_hann():
    rng = np.random.default_rng(7)
    pole = scipy.signal.cont2discrete(([1.0, 0, 0], [1, 2 * 0.01 * 600, 600**2]), 1e-3)
    impacts = np.zeros((10, 1000))
    impacts[:, 5] = rng.uniform(1, 2, 10)
    ringing_out = scipy.signal.lfilter(pole[0].ravel(), pole[1], impacts, axis=1)
    ringing_out += 1e-3 * rng.standard_normal(impacts.shape)
    assert least_leaking_taper(band_spectra(impacts, ringing_out, RATE, BAND)) == "rectangular"

    stream = rng.standard_normal(10_000)
    across = scipy.signal.lfilter(pole[0].ravel(), pole[1], stream).reshape(10, 1000)
    assert least_leaking_taper(band_spectra(stream.reshape(10, 1000), across, RATE, BAND)) == "hann"


@pytest.mark.parametrize(("true", "n"), [(1e-9, 8), (0.3, 15), (0.9, 30)])
def test_bias_of_coherence_against_its_exact_expectation(true, n):
    # E[γ̂²] = (1−γ²)ⁿ/n · ₃F₂(2, n, n; n+1, 1; γ²), Carter et al. 1973; the series is summed here.
    k = np.arange(4000)
    log_ratio = np.log((2 + k) * (n + k) ** 2 / ((n + 1 + k) * (1 + k) ** 2))
    log_terms = np.concatenate([[0.0], np.cumsum(log_ratio[:-1])]) + k * np.log(true)
    expected = (1 - true) ** n / n * np.sum(np.exp(log_terms))
    # First order in 1/n: the rest is of order 1/n².
    assert coherence_bias(true, n) == pytest.approx(expected - true, abs=1.0 / n**2 * (1 - true))


def test_significance_and_random_errors_against_simulation():
    rng = np.random.default_rng(8)
    n, trials = 15, 4000
    shape = (trials, n)
    x = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    e = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    def coherence_and_response(y):
        sxy = np.sum(x.conj() * y, axis=1)
        sxx = np.sum(np.abs(x) ** 2, axis=1)
        return np.abs(sxy) ** 2 / (sxx * np.sum(np.abs(y) ** 2, axis=1)), sxy / sxx

    unrelated, _ = coherence_and_response(e)
    # 4000 trials at 5 %: standard error 0.34 %.
    assert np.mean(unrelated > significance_level(n)) == pytest.approx(0.05, abs=0.012)

    true = 0.9
    _, response = coherence_and_response(x + e * np.sqrt((1 - true) / true))
    # First-order formula at n = 15 (n − 1 would be exact here), 4000 trials: 5 %.
    error = float(random_error(true, n))
    assert np.std(np.abs(response)) == pytest.approx(error, rel=0.06)
    assert np.std(np.angle(response)) == pytest.approx(error, rel=0.06)


def test_overlapped_windows_are_worth_what_simulated_power_estimates_say():
    # Variance of a Welch estimate of white noise: (power)² / effective averages.
    rng = np.random.default_rng(9)
    n, length, overlap = 12, 128, 0.75
    step = int(length * (1 - overlap))
    hann = scipy.signal.get_window("hann", length)
    records = rng.standard_normal((1500, step * (n - 1) + length))
    segments = np.lib.stride_tricks.sliding_window_view(records, length, axis=1)[:, ::step]
    power = np.mean(np.abs(np.fft.rfft(hann * segments, axis=2)[..., 10:50:4]) ** 2, axis=1)
    measured = np.mean(power.mean(axis=0) ** 2 / power.var(axis=0))
    # 1500 records × 10 lines: the variance is known to about 2 %.
    assert effective_averages(n, overlap) == pytest.approx(measured, rel=0.06)
    assert effective_averages(n, 0.0) == n


@pytest.mark.parametrize("band", [(100.0, 90.0), (10.0, 600.0), (100.2, 100.4)])
def test_bands_without_lines_are_refused(band):
    x, y = noisy_pair(np.random.default_rng(10), 2)
    with pytest.raises(OutsideValidityError, match="band must rise"):
        band_spectra(x, y, RATE, band)


def test_sums_of_different_lines_do_not_add():
    x, y = noisy_pair(np.random.default_rng(11), 2)
    with pytest.raises(OutsideValidityError, match="same lines"):
        cross_spectra(band_spectra(x, y, RATE, BAND)) + cross_spectra(band_spectra(x, y, RATE, (40.0, 150.0)))


@pytest.mark.parametrize("band", [(20.0, 60.0), (20.3, 59.6), (0.0, 128.0)])
def test_lines_around_a_band_are_those_of_its_own_spectra(band):
    rng = np.random.default_rng(3)
    excitation, response = rng.standard_normal((2, 4, 256))
    own = band_spectra(excitation, response, 256.0, band)
    around = band_spectra(excitation, response, 256.0, (min(band[0], 5.0), 128.0)).around(*band)
    assert np.array_equal(own.frequency, around.frequency)
    assert np.array_equal(own.excitation, around.excitation)
    assert np.array_equal(own.response, around.response)
