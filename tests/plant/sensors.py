"""Sensors and acquisition: anti-aliasing, sampling, noise and sixteen bits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sensor:
    """A channel with white noise and a converter of a given span."""

    noise: float  # standard deviation at the recorded rate
    span: float  # the converter covers ± this
    bits: int = 16

    @property
    def resolution(self) -> float:
        """Value of one bit."""
        return 2.0 * self.span / float(2**self.bits)


# Spans are powers of two, and so are the steps: float32 then holds them exactly, and files compress well.
TORQUE = Sensor(noise=4e-3, span=8.0)  # [N·m]
ACCELERATION = Sensor(noise=0.04, span=64.0)  # [m/s²]
ENCODER = Sensor(noise=0.0, span=4.0, bits=26)  # counts of 2^-23 m, about 0.12 µm [m]


def anti_alias(samples: FloatArray, factor: int) -> FloatArray:
    """Low-pass (flat to 0.36, closed from 0.5 of the new rate) and keep every ``factor``-th sample of axis 0.

    Linear phase, and the same for every channel: it drops out of every frequency response. Its half length is cut from
    both ends of the record.
    """
    half = filter_margin(factor)
    taps = signal.firwin(2 * half + 1, 0.86 / factor, window=("kaiser", 8.0))
    n_out = (samples.shape[0] - 2 * half - 1) // factor + 1
    filtered = signal.upfirdn(taps, samples, up=1, down=factor, axis=0)
    if (2 * half) % factor:
        raise ValueError(f"twice the filter's half length {half} must be a multiple of the factor {factor}")
    first = 2 * half // factor
    result: FloatArray = filtered[first : first + n_out]
    return result


def filter_margin(factor: int) -> int:
    """Return how many samples :func:`anti_alias` needs before the first and after the last that it returns."""
    return 18 * factor


def convert(samples: FloatArray, sensor: Sensor, rng: np.random.Generator) -> NDArray[np.float32]:
    """Add the sensor's noise and round to the converter's steps, clipping at its span."""
    noisy = samples + sensor.noise * rng.standard_normal(samples.shape) if sensor.noise else samples
    counts = np.clip(np.round(noisy / sensor.resolution), -(2 ** (sensor.bits - 1)), 2 ** (sensor.bits - 1) - 1)
    return (counts * sensor.resolution).astype(np.float32)
