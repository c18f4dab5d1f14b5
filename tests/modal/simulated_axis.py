"""Windows of an axis with known modes, simulated in continuous time and cut anywhere: the truth for estimator tests."""

import numpy as np
import scipy.signal

from monitor_core.spectral import BandSpectra, band_spectra

RATE, N_SAMPLES, N_WINDOWS = 2000.0, 4000, 30  # 0.5 Hz lines
FREQUENCY = 175.0
BAND = (80.0, 270.0)


def moves(rng, n_windows=N_WINDOWS):
    """Return an unbroken record of short torque pulses at random times, of random length, and a little tremor."""
    n_total = N_SAMPLES * n_windows
    torque = 0.02 * rng.standard_normal(n_total)
    for start in rng.integers(0, n_total - 40, size=4 * n_windows):
        length = int(rng.integers(3, 30))
        pulse = np.sin(np.pi * (np.arange(length) + 0.5) / length)
        torque[start : start + length] += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5) * pulse
    return torque


def acceleration(torque, modes):
    """Return the response of modes (frequency [Hz], damping ratio, gain) to a torque held between samples: exact."""
    total = np.zeros_like(torque)
    for frequency, damping, gain in modes:
        w = 2.0 * np.pi * frequency
        system = ([gain, 0.0, 0.0], [1.0, 2.0 * damping * w, w * w])
        b, a, _ = scipy.signal.cont2discrete(system, 1.0 / RATE)
        total += scipy.signal.lfilter(b.ravel(), a, torque)
    return total


def clean_windows(rng, modes, n_windows=N_WINDOWS):
    """Return torque and acceleration, shape (n_windows, N_SAMPLES): ringing runs on from one window into the next."""
    torque = moves(rng, n_windows + 1)
    response = acceleration(torque, modes)
    # The first stretch is thrown away: the record must not begin at rest.
    shape = (n_windows, N_SAMPLES)
    return torque[N_SAMPLES:].reshape(shape), response[N_SAMPLES:].reshape(shape)


def clean_spectra(rng, modes, n_windows=N_WINDOWS):
    """Return the lines of clean windows."""
    return band_spectra(*clean_windows(rng, modes, n_windows), RATE, BAND)


def with_noise(rng, spectra, snr_db, half_width):
    """Add white noise to the response, by the mean power within ``half_width`` of the mode.

    The lines of white noise in time are independent and normal, so they may as well be drawn as lines.
    """
    inside = spectra.within(FREQUENCY - half_width, FREQUENCY + half_width)
    deviation = np.sqrt(np.mean(np.abs(inside.response) ** 2) / 10.0 ** (snr_db / 10.0) / 2.0)
    shape = spectra.response.shape
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    noisy = BandSpectra(
        spectra.frequency,
        spectra.excitation,
        spectra.response + deviation * noise,
        spectra.n_samples,
        spectra.sample_rate,
    )
    return noisy, np.sqrt(2.0) * deviation
