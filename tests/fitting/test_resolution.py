"""What the resolution of an estimate does to a response: against the integral, and against Welch's average itself."""

import numpy as np
import pytest
import scipy.signal

from monitor_core.fitting.residuals.resolution import STEPS, WEIGHTS, smearing, spread_under_random_excitation
from monitor_core.models.extended import ResponseCase, prepare_lines, responses
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from tests.discrepancy.axes import subject

PHYSICS = subject().physics({})
ACCELERATION, ANGLE = ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
LINES = np.arange(60.0, 400.0, 5.0)


def case(point, frequency=LINES):
    return ResponseCase(frequency, DriveConditions(0.5, 200.0), ExcitationPoint.TORQUE_AT_MOTOR, point, MotorEnd.FREE)


def hann_power(offset, resolution):
    """Return |W|² of a Hann window of 1/resolution seconds."""
    turns = offset / resolution
    return np.array([np.sinc(turn) / (1.0 - turn**2) if abs(abs(turn) - 1.0) > 1e-9 else 0.5 for turn in turns]) ** 2


@pytest.mark.release
@pytest.mark.parametrize("resolution", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("point", [ACCELERATION, ANGLE])
def test_it_is_the_response_averaged_over_the_spectrum_of_the_window(point, resolution) -> None:
    """The integral in 320 steps, of what is recorded: of an angle its second derivative."""
    offsets = np.arange(-8.0, 8.0, 0.05) * resolution + 0.025 * resolution
    power = hann_power(offsets, resolution)
    seen = np.zeros(LINES.size, dtype=complex)
    for offset, weight in zip(offsets, power / np.sum(power), strict=True):
        recorded = responses(PHYSICS, prepare_lines([case(point, LINES + offset)]))
        seen += weight * recorded * ((LINES + offset) / LINES) ** (2.0 if point is ANGLE else 0.0)
    plain = responses(PHYSICS, prepare_lines([case(point)]))
    found = smearing([case(point)], [spread_under_random_excitation(resolution, LINES.size)]).log_ratio(PHYSICS)
    expected = np.log(seen / plain)
    assert np.max(np.abs(expected)) > 3e-3 * resolution**2
    np.testing.assert_allclose(found, expected, atol=0.03 * np.max(np.abs(expected)))


@pytest.mark.release
def test_it_is_what_the_average_over_hann_windows_shows() -> None:
    """Of an oscillator under white noise, 3 % damped at 30 Hz, in windows of 1 s: its peak is a fifth lower."""
    rate, frequency, damping = 512.0, 30.0, 0.03
    pole = np.exp(2.0 * np.pi * frequency / rate * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    poles = np.real(np.poly([pole, np.conj(pole)]))
    force = np.random.default_rng(1).standard_normal(2_000_000)
    motion = scipy.signal.lfilter([1.0], poles, force)
    settings = {"fs": rate, "window": "hann", "nperseg": 512, "detrend": False}
    lines, cross = scipy.signal.csd(force, motion, **settings)
    estimated = cross / scipy.signal.welch(force, **settings)[1]
    around = (lines > 24.0) & (lines < 36.0)

    def response(shift):
        return scipy.signal.freqz([1.0], poles, lines[around] + shift, fs=rate)[1]

    expected = sum(weight * response(step) for weight, step in zip(WEIGHTS, STEPS, strict=True))
    np.testing.assert_allclose(estimated[around] / expected, 1.0, atol=0.01)
    assert np.max(np.abs(estimated[around] / response(0.0) - 1.0)) > 0.15


@pytest.mark.parametrize(("lines_wide", "error"), [(2.0, 1e-3), (1.0, 1e-2)])
def test_it_is_as_exact_as_is_said(lines_wide, error) -> None:
    """Of one mode so many resolutions wide: against its impulse response under the autocorrelation of the window."""
    resolution, frequency = 1.0, 100.0
    decay = np.pi * lines_wide * resolution
    time = np.arange(0.0, 1.0 / resolution, 1e-5)
    window = scipy.signal.windows.hann(time.size, sym=False)
    weight = scipy.signal.fftconvolve(window, window[::-1])[time.size - 1 :] / np.sum(window**2)
    impulse = weight * np.exp((2j * np.pi * frequency - decay) * time)
    around = frequency + np.arange(-4.0, 4.0, 0.25) * resolution
    exact = np.array([np.trapezoid(impulse * np.exp(-2j * np.pi * line * time), time) for line in around])

    def response(shift):
        return 1.0 / (decay + 2j * np.pi * (around + shift * resolution - frequency))

    found = sum(weight * response(step) for weight, step in zip(WEIGHTS, STEPS, strict=True))
    np.testing.assert_allclose(np.log(found / exact), 0.0, atol=error)
    assert np.max(np.abs(np.log(response(0.0) / exact))) > 50.0 * error


def test_lines_without_a_stated_resolution_are_exact() -> None:
    assert smearing([case(ACCELERATION)], [None]) is None
    both = [case(ACCELERATION), case(ANGLE)]
    found = smearing(both, [spread_under_random_excitation(1.0, LINES.size), None]).log_ratio(PHYSICS)
    assert np.all(np.abs(found[: LINES.size]) > 0.0)
    np.testing.assert_allclose(found[LINES.size :], 0.0, atol=1e-13)
