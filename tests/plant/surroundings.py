"""What a shop adds to a measurement: a shaking floor, noisy channels, and a mode of the structure that comes up."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tests.plant.sensors import TORQUE, Sensor

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SecondMode:
    """A mode of the structure that the reaction to the drive excites and the accelerometer feels."""

    frequency: float  # [Hz]
    damping_ratio: float  # [-]
    residue: float  # of its torque accelerance, with the sign of the axial mode's [m/(N·m·s²)]


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the machine stands in; by default a laboratory."""

    torque_noise: float = TORQUE.noise  # white, at the recorded rate, standard deviation [N·m]
    torque_span: float = TORQUE.span  # of its converter [N·m]
    coloured_noise: float = 0.0  # of the acceleration, falling with the frequency from 50 Hz, rms [m/s²]
    floor_force: float = 0.0  # of the floor on the table, of 20 to 200 Hz, rms [N]
    second_mode: SecondMode | None = None

    @property
    def torque_sensor(self) -> Sensor:
        """The torque channel with its noise."""
        return replace(TORQUE, noise=self.torque_noise, span=self.torque_span)

    def floor(self, rng: np.random.Generator, shape: tuple[int, ...], rate: float) -> FloatArray:
        """Draw the force of a shaking floor, time along axis 0 [N]."""
        sections = signal.butter(1, (20.0, 200.0), "bandpass", fs=rate, output="sos")
        return self.floor_force * _of_unit_rms(sections, rng.standard_normal(shape))

    def colour(self, rng: np.random.Generator, shape: tuple[int, ...], rate: float) -> FloatArray:
        """Draw noise of the accelerometer whose density falls with the frequency [m/s²]."""
        sections = signal.butter(1, 50.0, "lowpass", fs=rate, output="sos")
        return self.coloured_noise * _of_unit_rms(sections, rng.standard_normal(shape))

    def second_mode_acceleration(self, torque: FloatArray, rate: float) -> FloatArray | float:
        """Return what the second mode adds to the acceleration [m/s²]; time along axis 0."""
        mode = self.second_mode
        if mode is None:
            return 0.0
        omega = 2.0 * np.pi * mode.frequency
        b, a = signal.bilinear([mode.residue, 0.0, 0.0], [1.0, 2.0 * mode.damping_ratio * omega, omega**2], fs=rate)
        answer: FloatArray = signal.lfilter(b, a, torque, axis=0)
        return answer


def _of_unit_rms(sections: FloatArray, white: FloatArray) -> FloatArray:
    coloured: FloatArray = signal.sosfilt(sections, white, axis=0)
    impulse = np.zeros(8192)
    impulse[0] = 1.0
    return coloured / np.sqrt(np.sum(signal.sosfilt(sections, impulse) ** 2))
