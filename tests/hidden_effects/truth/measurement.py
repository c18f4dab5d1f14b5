"""What a recorder makes of a plant: random torque, sensors with noise, frequency responses with their scatter."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.signal

from tests.hidden_effects.truth.axis import Axis, Setting

SAMPLE_RATE = 4096.0  # [Hz]
DURATION = 20.0  # of what is kept [s]
#: Dropped before it, while motion from rest dies away. [s]
LEAD_IN = 2.0
_SEGMENT = 4096  # samples, 1 Hz a line
_EXCITED = (21.5, 1560.0)  # band of the torque [Hz]
_FIRST, _LAST, _GROWTH = 24, 1500, 1.0362  # lines that are kept, nearly a hundred [Hz, Hz, -]
#: Hann windows spread a line over its neighbours: lines that are further apart scatter nearly independently.
_APART = 3
_FULL_SCALE = 6.0  # of the converter over the rms of the channel
_BITS = 16

#: From settings and torques to acceleration of the table and angle of the rotor.
Respond = Callable[[Axis, Sequence[Setting], np.ndarray, float], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of what differs from measurement to measurement."""

    sensor_noise: float = 0.003  # of every channel, white, over its rms [-]
    gain: float = 0.005  # of each response [-]
    position: float = 0.3e-3  # true less stated [m]
    preload: float = 0.03  # true less stated, of the stated [-]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFrf:
    """One estimated frequency response and what its measurement is tagged with."""

    stated: Setting
    output: str  # "acceleration-at-table" [m/(N·m·s²)] or "angle-at-motor" [rad/(N·m)], per torque at the motor
    frequency: np.ndarray  # shape (n_lines,) [Hz]
    response: np.ndarray  # complex, shape (n_lines,)
    standard_deviation: np.ndarray  # of real and of imaginary part, shape (n_lines,)
    coherence: np.ndarray  # shape (n_lines,)
    resolution: float = SAMPLE_RATE / _SEGMENT  # reciprocal duration of the windows [Hz]


def set_truly(stated: Sequence[Setting], scatter: Scatter, rng: np.random.Generator) -> tuple[Setting, ...]:
    """Return how the axis is really set where settings are stated."""
    return tuple(
        Setting(
            position=setting.position + scatter.position * rng.standard_normal(),
            preload=setting.preload * (1.0 + scatter.preload * rng.standard_normal()),
            payload=setting.payload,
            temperature_deviation=setting.temperature_deviation,
            excitation_rms=setting.excitation_rms,
            order=setting.order,
        )
        for setting in stated
    )


def measure(
    axis: Axis,
    stated: Sequence[Setting],
    true: Sequence[Setting],
    scatter: Scatter,
    rng: np.random.Generator,
    *,
    respond: Respond,
) -> tuple[MeasuredFrf, ...]:
    """Return both responses of every setting, acceleration of the table first.

    The rotor is sensed by its angular acceleration, and the response turned into one of the angle line by line: the
    angle itself is all drift and low frequency, and white noise on it would leave nothing to see above some 300 Hz.
    """
    torque = random_torque(np.array([setting.excitation_rms for setting in true]), rng)
    acceleration, angle = respond(axis, true, torque, SAMPLE_RATE)
    kept = slice(round(LEAD_IN * SAMPLE_RATE), None)
    turning = np.zeros_like(angle)
    turning[:, 1:-1] = np.diff(angle, 2, axis=1) * SAMPLE_RATE**2
    frequency = measured_lines()
    per_turning = -((SAMPLE_RATE * 2.0 * np.sin(np.pi * frequency / SAMPLE_RATE)) ** 2)
    recorded = [_recorded(channel[:, kept], scatter.sensor_noise, rng) for channel in (torque, acceleration, turning)]
    measured = []
    for index, setting in enumerate(stated):
        for output, channel, divisor in (
            ("acceleration-at-table", recorded[1], 1.0),
            ("angle-at-motor", recorded[2], per_turning),
        ):
            response, deviation, coherence = estimate(recorded[0][index], channel[index])
            gain = 1.0 + scatter.gain * rng.standard_normal()
            measured.append(
                MeasuredFrf(
                    setting, output, frequency, gain * response / divisor, deviation / np.abs(divisor), coherence
                )
            )
    return tuple(measured)


def random_torque(rms: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return Gaussian torques of given rms, flat within the excited band and nothing outside, (n_settings, n_samples).

    They repeat after their own length, which no evaluation sees.
    """
    n = round((LEAD_IN + DURATION) * SAMPLE_RATE)
    frequency = scipy.fft.rfftfreq(n, 1.0 / SAMPLE_RATE)
    excited = (frequency >= _EXCITED[0]) & (frequency <= _EXCITED[1])
    spectrum = np.zeros((rms.size, frequency.size), dtype=complex)
    shape = (rms.size, int(excited.sum()))
    spectrum[:, excited] = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    # a line of power 2 gives a mean square of 4/n²
    return scipy.fft.irfft(spectrum, n=n, axis=1) * (rms / np.sqrt(4.0 * excited.sum()) * n)[:, None]


def measured_lines() -> np.ndarray:
    """Return the lines that are kept, nearly evenly spread over the logarithm of the frequency. [Hz]."""
    lines = [_FIRST]
    while (following := max(lines[-1] + _APART, round(lines[-1] * _GROWTH))) <= _LAST:
        lines.append(following)
    return np.array(lines, dtype=float)


def estimate(torque: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return H1, its standard deviation in real and imaginary part, and the coherence, on the lines that are kept.

    Bendat & Piersol, Random Data, Table 9.6: the relative error of the amplitude and that of the phase are both
    √((1 − γ²)/(2 n γ²)) for n independent averages. Of Hann windows that overlap by half, n count as n/1.056
    (Welch 1967).
    """
    window = scipy.signal.windows.hann(_SEGMENT, sym=False)
    step = _SEGMENT // 2
    n_segments = (torque.size - _SEGMENT) // step + 1
    lines = measured_lines().astype(int)
    spectra = []
    for channel in (torque, response):
        segments = np.lib.stride_tricks.sliding_window_view(channel, _SEGMENT)[::step]
        spectra.append(scipy.fft.rfft(segments * window, axis=1)[:, lines])
    x, y = spectra
    power_x, power_y = (np.mean(np.abs(transformed) ** 2, axis=0) for transformed in (x, y))
    cross = np.mean(x.conj() * y, axis=0)
    coherence = np.abs(cross) ** 2 / (power_x * power_y)
    transfer = cross / power_x
    overlap = np.sum(window[step:] * window[:-step]) / np.sum(window**2)
    n_independent = n_segments / (1.0 + 2.0 * overlap**2 * (1.0 - 1.0 / n_segments))
    return transfer, np.abs(transfer) * np.sqrt((1.0 - coherence) / (2.0 * n_independent * coherence)), coherence


def _recorded(channel: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Return channels with the noise of their sensors, in steps of a converter; shape (n_settings, n_samples)."""
    rms = np.sqrt(np.mean(channel**2, axis=1, keepdims=True))
    noisy = channel + noise * rms * rng.standard_normal(channel.shape)
    step = 2.0 * _FULL_SCALE * rms / 2.0**_BITS
    return np.round(noisy / step) * step
