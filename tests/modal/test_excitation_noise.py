"""Noise on the torque: how much there is, read at rest, and what it did to a frequency."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.modal.channels import Contamination, contamination, excitation_noise
from monitor_core.spectral import band_spectra
from tests.modal.simulated_axis import BAND, FREQUENCY, N_SAMPLES, RATE, clean_windows
from tests.plant.shop import CASES, MEDIUM, case_session

DAMPING = 0.012
PLANT_BAND = (180.0, 240.0)


def pulses_with_a_dip(rng, n_windows=60):
    """Return torque with rests in it whose spectrum has a dip at the mode, as between motor and screw, and response."""
    t = np.arange(N_SAMPLES) / RATE
    torque = np.zeros((n_windows, N_SAMPLES))
    for row in torque:
        for start in rng.uniform(0.1, 1.4, 4):
            move = (t >= start) & (t < start + 0.2)
            row[move] += rng.choice([-1.0, 1.0]) * np.sin(np.pi * (t[move] - start) / 0.2) ** 2
            row[:] += rng.choice([-1.0, 1.0]) * 2.0 * np.exp(-0.5 * ((t - start) / 0.9e-3) ** 2)
    spectrum, f = np.fft.rfft(torque, axis=1), np.fft.rfftfreq(N_SAMPLES, 1.0 / RATE)
    axis = f**2 / (FREQUENCY**2 - f**2 + 2j * DAMPING * FREQUENCY * f)
    dip = (FREQUENCY**2 - f**2 + 4j * DAMPING * FREQUENCY * f) / (FREQUENCY**2 + f**2 + 0.2j * FREQUENCY * f)
    return np.fft.irfft(spectrum * dip, N_SAMPLES, axis=1), np.fft.irfft(spectrum * dip * axis, N_SAMPLES, axis=1)


@pytest.mark.parametrize("deviation", [0.003, 0.03, 0.3])
def test_noise_is_read_at_rest_whatever_the_moves(deviation):
    rng = np.random.default_rng(1)
    torque, _ = pulses_with_a_dip(rng)
    noise = excitation_noise(torque + deviation * rng.standard_normal(torque.shape))
    # of so many stretches the quantile is known to some percent; what rings on at rest adds to it
    assert np.sqrt(noise / N_SAMPLES) == pytest.approx(deviation, rel=0.1)


def test_no_noise_moves_nothing():
    torque, response = pulses_with_a_dip(np.random.default_rng(2))
    spectra = band_spectra(torque, response, RATE, BAND).within(155.0, 195.0)
    assert contamination(spectra, FREQUENCY, excitation_noise(torque), "hann") == Contamination(0.0, 0.0)
    assert excitation_noise(torque[:, :20]) == 0.0


@pytest.mark.release
def test_noise_on_the_torque_of_a_plant_is_taken_off():
    # Torque between coupling and screw is least at the mode: 5 % of noise moves the frequency by a quarter hertz.
    rng = np.random.default_rng(3)
    errors, taken_off, reach = [], [], []
    for day in range(4):
        session = case_session(MEDIUM, CASES["healthy"], rng, day=day).session
        for name in session.measurements:
            clean = session.windows_of(name)
            noisy = [
                replace(w, excitation=w.excitation + 0.026 * rng.standard_normal(w.n_samples).astype(np.float32))
                for w in clean
            ]
            without, found = (measure_mode(windows, band=PLANT_BAND, gate=ModeGate()) for windows in (clean, noisy))
            assert isinstance(without, ModalMeasurement)
            assert isinstance(found, ModalMeasurement)
            (said,) = [warning for warning in found.warnings if warning.startswith("noise of 0.02")]
            taken_off.append(-float(said.split("frequency by ")[1].split(" Hz")[0]))
            errors.append(found.mode.frequency.value - without.mode.frequency.value)
            reach.append(1.96 * found.mode.frequency.standard_uncertainty)
    biased = np.array(errors) - np.array(taken_off)
    assert np.mean(biased) < -0.15
    assert abs(np.mean(errors)) < 0.4 * abs(np.mean(biased))
    # 20 measurements: 95 % less two standard deviations of 5 %
    assert np.mean(np.abs(errors) < reach) >= 0.85


def test_torque_of_a_servo_that_trembles_is_no_noise():
    rng = np.random.default_rng(4)
    torque, response = clean_windows(rng, [(FREQUENCY, 0.02, 1.0)])
    noise = excitation_noise(torque)
    assert np.sqrt(noise / N_SAMPLES) == pytest.approx(0.02, rel=0.2)
    spectra = band_spectra(torque, response + 0.02 * rng.standard_normal(response.shape), RATE, BAND)
    assert abs(contamination(spectra.within(155.0, 195.0), FREQUENCY, noise, "hann").shift) < 0.01
