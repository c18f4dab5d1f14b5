"""The drive of ``tests/plant/drive.py`` in a speed loop: a sampled PI controller, a lagging current, friction torque.

What commands the speed is known and shakes the axis; so does a torque that nobody measures, and the controller answers
both. The natural frequency is that of the axis alone, from its own matrices.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tests.plant.drive import Drive

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SpeedLoop:
    """Gains of the controller, and how fast the current follows what it asks for."""

    drive: Drive = field(default_factory=Drive)
    bandwidth: float = 700.0  # [rad/s]
    integral: float = 20.0  # [1/s]
    lag: float = 3e-4  # of the current [s]

    def logged(
        self,
        position: float,
        preload: float,
        *,
        n_windows: int,
        n_samples: int,
        rng: np.random.Generator,
        commanded: float,  # speed of the motor, random [rad/s rms]
        friction: float,  # torque on the motor, random [N·m rms]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return commanded speed [rad/s], measured current [A] and table [m], each of shape (n_windows, n_samples).

        States: those of the drive, the current, and what is held over a sample, current asked for and friction.
        """
        drive, step = self.drive, 1.0 / self.drive.sample_rate
        a, b = drive.matrices(position, preload)
        whole = np.zeros((9, 9))
        whole[:6, :6], whole[:6, 6], whole[:6, 8] = a, b[:, 0] * drive.torque_constant, b[:, 0]
        whole[6, 6:8] = -1.0 / self.lag, 1.0 / self.lag
        sampled = linalg.expm(whole * step)
        turning = drive.inertia + drive.table_mass * drive.transmission**2
        gain = turning * self.bandwidth / drive.torque_constant
        before = int(0.5 * drive.sample_rate)
        speeds = commanded * rng.normal(size=(before + n_samples, n_windows))
        torques = friction * rng.normal(size=speeds.shape)
        state, integral, last = np.zeros((9, n_windows)), np.zeros(n_windows), np.zeros(n_windows)
        kept = np.zeros((2, *speeds.shape))
        for k, (speed, torque) in enumerate(zip(speeds, torques, strict=True)):
            error = speed - (state[0] - last) / step
            integral = integral + error * step
            kept[:, k] = state[6], state[2]
            last = state[0].copy()
            state[7], state[8] = gain * (error + self.integral * integral), torque
            state = sampled @ state
        current, table = kept[:, before:].transpose(0, 2, 1)
        return speeds[before:].T, current, table
