"""Candidates: what is a peak, and what is chance."""

import numpy as np
import pytest
import scipy.signal

from monitor_core.errors import OutsideValidityError
from monitor_core.modal import ModeGate, averaging, candidate_peaks
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.response import FrequencyResponse
from monitor_core.spectral import band_spectra, cross_spectra, estimate_frf

RATE, N_SAMPLES = 1000.0, 1000
BAND = (100.0, 300.0)


def response_lines(rng, modes, n_windows, noise):
    x = rng.standard_normal(N_SAMPLES * (n_windows + 1))
    y = np.zeros_like(x)
    for frequency, damping in modes:
        w = 2 * np.pi * frequency
        b, a, _ = scipy.signal.cont2discrete(([1.0, 0, 0], [1, 2 * damping * w, w * w]), 1.0 / RATE)
        y += scipy.signal.lfilter(b.ravel(), a, x)
    y += noise * rng.standard_normal(x.size)
    shape = (n_windows, N_SAMPLES)
    pair = (x[N_SAMPLES:].reshape(shape), y[N_SAMPLES:].reshape(shape))
    return band_spectra(*pair, RATE, (50.0, 400.0))


def measured(rng, modes, n_windows, noise):
    return estimate_frf(cross_spectra(response_lines(rng, modes, n_windows, noise)), quantity="accelerance")


def test_two_modes_are_the_two_highest_candidates():
    frf = measured(np.random.default_rng(1), [(150.0, 0.01), (240.0, 0.015)], 30, noise=0.5)
    found = candidate_peaks(frf, BAND)
    # Peak bin: within half a half-power bandwidth.
    assert sorted(c.frequency for c in found[:2]) == [pytest.approx(150.0, abs=1.5), pytest.approx(240.0, abs=3.6)]
    assert [c.amplitude for c in found] == sorted((c.amplitude for c in found), reverse=True)
    for candidate, damping in zip(sorted(found[:2], key=lambda c: c.frequency), (0.01, 0.015), strict=True):
        # A rough start, from whole lines of 1 Hz: within a factor of two.
        assert damping / 2 < candidate.damping_ratio < damping * 2


def test_peaks_outside_the_band_are_none():
    frf = measured(np.random.default_rng(2), [(150.0, 0.01)], 30, noise=0.05)
    assert all(180.0 <= c.frequency <= 300.0 for c in candidate_peaks(frf, (180.0, 300.0)))
    assert candidate_peaks(frf, (500.0, 600.0)) == ()


def test_unrelated_channels_hardly_ever_have_a_candidate():
    # At most one band in twenty, by the level of significance; 60 bands, so 3 ± 1.7.
    rng = np.random.default_rng(3)
    found = [len(candidate_peaks(measured(rng, [], 15, noise=1.0), BAND)) for _ in range(60)]
    assert np.sum(np.array(found) > 0) <= 7


def test_one_average_has_no_candidates_to_offer():
    f = np.arange(100.0, 200.0)
    with pytest.raises(OutsideValidityError, match="at least 2 averages"):
        candidate_peaks(FrequencyResponse(f, 1.0 / (150.0**2 - f**2 + 3j * f), "accelerance"), BAND)


def test_of_many_peaks_the_five_strongest_are_fitted(monkeypatch):
    """Eight modes, none of which may stand out: each fit takes its time."""
    fitted = []

    def passed_over(spectra, candidate, maximum_modes, band):
        fitted.append(candidate.frequency)
        return Rejection(RejectionReason.NO_PEAK_IN_BAND, "as noise")

    monkeypatch.setattr(averaging, "_fit_peak", passed_over)
    modes = [(frequency, 0.015) for frequency in np.arange(110.0, 300.0, 25.0)]
    spectra = response_lines(np.random.default_rng(4), modes, 30, 0.05)
    assert len(candidate_peaks(estimate_frf(cross_spectra(spectra), quantity="accelerance"), BAND)) > 5
    given = averaging.average_and_fit(spectra, BAND, ModeGate(), lines=BAND, quantity="accelerance", maximum_modes=1)
    assert isinstance(given, Rejection)
    assert len(fitted) == 5
