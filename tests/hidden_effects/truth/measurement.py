"""What a recorder makes of a plant: random torque, sensors with noise, frequency responses with their scatter."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.signal

from tests.hidden_effects.truth.axis import Axis, Setting

SAMPLE_RATE = 4096.0  # of the benchtop axis [Hz]
_SEGMENT = 4096  # samples, 1 Hz a line on the benchtop axis
_N_SEGMENTS, _N_LEAD_IN = 20, 2  # of what is kept, and before it, while motion from rest dies away; in lengths of one
#: In lines, 1 Hz on the benchtop axis.
_EXCITED = (21.5, 1560.0)  # band of the torque
_FIRST, _LAST, _GROWTH = 24, 1500, 1.0362  # lines that are kept, nearly a hundred
#: Hann windows spread a line over its neighbours: lines that are further apart scatter nearly independently.
APART = 3
_FULL_SCALE = 6.0  # of the converter over the rms of the channel
_BITS = 16


@dataclass(frozen=True, slots=True)
class Recorder:
    """The test bench of a machine: everything goes with its sampling rate, and what disturbs its channels."""

    sample_rate: float = SAMPLE_RATE  # [Hz]
    pink: bool = False  # the noise of the sensors has a power of 1/f, of the same rms
    hum: float = 0.0  # of the mains on every channel, over its rms; a third of it at three times 50 Hz [-]
    clipped_at: float = math.inf  # of the accelerometer, over its rms [-]
    #: A loop on the velocity of the rotor, its crossover in lines; it hears the noise of its sensor. Linear axes only.
    loop: float = 0.0

    @property
    def resolution(self) -> float:
        """Reciprocal duration of the windows. [Hz]."""
        return self.sample_rate / _SEGMENT

    @property
    def lead_in(self) -> int:
        """Samples that are dropped."""
        return _N_LEAD_IN * _SEGMENT


#: From settings and torques to acceleration of the table and angle of the rotor.
Respond = Callable[[Axis, Sequence[Setting], np.ndarray, float], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of what differs from measurement to measurement."""

    sensor_noise: float = 0.003  # of every channel, white, over its rms [-]
    gain: float = 0.005  # of each response [-]
    position: float = 0.3e-3  # true less stated [m]
    preload: float = 0.03  # true less stated, of the stated [-]
    law: str = "normal"  # of position, preload and gain: or "uniform", "heavy" (Student's t of 3 degrees of freedom)

    def drawn(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Return errors of standard deviation 1, shape (n,)."""
        if self.law == "uniform":
            return rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), n)
        if self.law == "heavy":
            return rng.standard_t(3.0, n) / math.sqrt(3.0)
        return rng.standard_normal(n)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFrf:
    """One estimated frequency response and what its measurement is tagged with."""

    stated: Setting
    output: str  # "acceleration-at-table" [m/(N·m·s²)] or "angle-at-motor" [rad/(N·m)], per torque at the motor
    frequency: np.ndarray  # shape (n_lines,) [Hz]
    response: np.ndarray  # complex, shape (n_lines,)
    standard_deviation: np.ndarray  # of real and of imaginary part, shape (n_lines,)
    coherence: np.ndarray  # shape (n_lines,)
    resolution: float  # reciprocal duration of the windows [Hz]


def set_truly(stated: Sequence[Setting], scatter: Scatter, rng: np.random.Generator) -> tuple[Setting, ...]:
    """Return how the axis is really set where settings are stated."""
    errors = scatter.drawn(2 * len(stated), rng).reshape(-1, 2)
    return tuple(
        replace(
            setting,
            position=setting.position + scatter.position * moved,
            preload=setting.preload * (1.0 + scatter.preload * tightened),
        )
        for setting, (moved, tightened) in zip(stated, errors, strict=True)
    )


def measure(
    axis: Axis,
    stated: Sequence[Setting],
    true: Sequence[Setting],
    scatter: Scatter,
    rng: np.random.Generator,
    *,
    respond: Respond,
    recorder: Recorder = Recorder(),
) -> tuple[MeasuredFrf, ...]:
    """Return both responses of every setting, acceleration of the table first.

    The rotor is sensed by its angular acceleration, and the response turned into one of the angle line by line: the
    angle itself is all drift and low frequency, and white noise on it would leave nothing to see above some 300 Hz.
    """
    rate = recorder.sample_rate
    torque = random_torque(np.array([setting.excitation_rms for setting in true]), rng, recorder)
    acceleration, angle = respond(axis, true, torque, rate)
    turning = np.zeros_like(angle)
    turning[:, 1:-1] = np.diff(angle, 2, axis=1) * rate**2
    channels = [torque, acceleration, turning]
    noises = [_noise(channel, scatter.sensor_noise, recorder, rng) for channel in channels]
    if recorder.loop:
        channels = _in_closed_loop(channels, noises[2], recorder)
    limits = (math.inf, recorder.clipped_at, math.inf)
    channels = [
        _recorded(channel[:, recorder.lead_in :], noise[:, recorder.lead_in :], limit)
        for channel, noise, limit in zip(channels, noises, limits, strict=True)
    ]
    frequency = measured_lines(recorder)
    per_turning = -((rate * 2.0 * np.sin(np.pi * frequency / rate)) ** 2)
    gains = 1.0 + scatter.gain * scatter.drawn(2 * len(stated), rng).reshape(-1, 2)
    measured = []
    for index, setting in enumerate(stated):
        for which, (output, divisor) in enumerate((("acceleration-at-table", 1.0), ("angle-at-motor", per_turning))):
            response, deviation, coherence = estimate(channels[0][index], channels[1 + which][index])
            response = gains[index, which] * response / divisor
            deviation = deviation / np.abs(divisor)
            measured.append(
                MeasuredFrf(setting, output, frequency, response, deviation, coherence, recorder.resolution)
            )
    return tuple(measured)


def random_torque(
    rms: np.ndarray,
    rng: np.random.Generator,
    recorder: Recorder = Recorder(),
) -> np.ndarray:
    """Return Gaussian torques of given rms, flat within the excited band and nothing outside, (n_settings, n_samples).

    They repeat after their own length, which no evaluation sees.
    """
    n = (_N_LEAD_IN + _N_SEGMENTS) * _SEGMENT
    frequency = scipy.fft.rfftfreq(n, 1.0 / recorder.sample_rate)
    lowest, highest = (line * recorder.resolution for line in _EXCITED)
    excited = (frequency >= lowest) & (frequency <= highest)
    spectrum = np.zeros((rms.size, frequency.size), dtype=complex)
    shape = (rms.size, int(excited.sum()))
    spectrum[:, excited] = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    # a line of power 2 gives a mean square of 4/n²
    return scipy.fft.irfft(spectrum, n=n, axis=1) * (rms / np.sqrt(4.0 * excited.sum()) * n)[:, None]


def measured_lines(recorder: Recorder = Recorder()) -> np.ndarray:
    """Return the lines that are kept, nearly evenly spread over the logarithm of the frequency. [Hz]."""
    return _bins() * recorder.resolution


def _bins() -> np.ndarray:
    lines = [_FIRST]
    while (following := max(lines[-1] + APART, round(lines[-1] * _GROWTH))) <= _LAST:
        lines.append(following)
    return np.array(lines)


def estimate(torque: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return H1, its standard deviation in real and imaginary part, and the coherence, on the lines that are kept.

    Bendat & Piersol, Random Data, Table 9.6: the relative error of the amplitude and that of the phase are both
    √((1 − γ²)/(2 n γ²)) for n independent averages. Of Hann windows that overlap by half, n count as n/1.056
    (Welch 1967).
    """
    window = scipy.signal.windows.hann(_SEGMENT, sym=False)
    step = _SEGMENT // 2
    n_segments = (torque.size - _SEGMENT) // step + 1
    lines = _bins()
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


def _in_closed_loop(channels: Sequence[np.ndarray], heard: np.ndarray, recorder: Recorder) -> list[np.ndarray]:
    """Return the channels of a linear axis as they are with a loop of T = R − c ω, ω with the noise of its sensor.

    A gain c that makes the rotor's slow inertia cross over at the wanted line; motion follows torque, line by line.
    """
    torque, acceleration, turning = (scipy.fft.rfft(channel, axis=1) for channel in channels)
    omega = 2.0 * np.pi * scipy.fft.rfftfreq(channels[0].shape[1], 1.0 / recorder.sample_rate)
    driven = np.max(np.abs(torque), axis=0) > 1e-9 * np.max(np.abs(torque))
    slow = np.flatnonzero(driven)[:50]
    inertia = np.median(np.abs(torque[:, slow] / turning[:, slow]))
    gain = 2.0 * np.pi * recorder.loop * recorder.resolution * inertia
    fed_back = np.zeros_like(torque)
    fed_back[:, driven] = gain / (1j * omega[driven])  # per acceleration
    of_noise = fed_back * scipy.fft.rfft(heard, axis=1)
    share = np.zeros_like(torque)
    share[:, driven] = (torque - of_noise)[:, driven] / (torque + fed_back * turning)[:, driven]
    n = channels[0].shape[1]
    return [scipy.fft.irfft(share * spectrum, n, axis=1) for spectrum in (torque, acceleration, turning)]


def _noise(channel: np.ndarray, share: float, recorder: Recorder, rng: np.random.Generator) -> np.ndarray:
    """Return the noise of a sensor and of the mains, shape (n_settings, n_samples)."""
    rms = np.sqrt(np.mean(channel[:, recorder.lead_in :] ** 2, axis=1, keepdims=True))
    noise = rng.standard_normal(channel.shape)
    if recorder.pink:
        spectrum = scipy.fft.rfft(noise, axis=1)
        spectrum[:, 0] = 0.0
        spectrum[:, 1:] /= np.sqrt(np.arange(1.0, spectrum.shape[1]))
        noise = scipy.fft.irfft(spectrum, channel.shape[1], axis=1)
        noise /= np.std(noise, axis=1, keepdims=True)
    noise *= share
    if recorder.hum:
        turn = 2.0 * np.pi * 50.0 * np.arange(channel.shape[1]) / recorder.sample_rate
        phase = rng.uniform(0.0, 2.0 * np.pi, (len(channel), 2, 1))
        noise += recorder.hum * np.sqrt(2.0) * (np.sin(turn + phase[:, 0]) + np.sin(3.0 * turn + phase[:, 1]) / 3.0)
    return rms * noise


def _recorded(channel: np.ndarray, noise: np.ndarray, limit: float) -> np.ndarray:
    """Return channels with their noise, clipped, in steps of a converter; shape (n_settings, n_samples)."""
    rms = np.sqrt(np.mean(channel**2, axis=1, keepdims=True))
    step = 2.0 * _FULL_SCALE * rms / 2.0**_BITS
    return np.round(np.clip(channel + noise, -limit * rms, limit * rms) / step) * step
