"""Short random ramp moves that mimic an impact, and the servo that follows them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MoveProgram:
    """Ramp moves to and fro. Ramp and cruise are drawn anew for each: equal ones would put nulls at the resonance."""

    speed: float = 0.06  # [m/s]
    ramp: tuple[float, float] = (3.0e-3, 4.5e-3)  # uniform; shorter than a period, so without a null below 220 Hz [s]
    cruise: tuple[float, float] = (30e-3, 60e-3)  # uniform [s]
    starts: tuple[tuple[float, float], ...] = ((0.06, 0.18), (0.52, 0.66))  # uniform, in windows' lengths [-]


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What the servo shall follow, relative to the centre of the window's travel; shape (n_steps, ...)."""

    travel: FloatArray  # [m]
    speed: FloatArray  # [m/s]
    acceleration: FloatArray  # [m/s²]


def draw_reference(
    program: MoveProgram, rng: np.random.Generator, shape: tuple[int, ...], time: FloatArray, duration: float
) -> Reference:
    """Draw moves that alternate in direction, for windows of a duration [s] that begin at time zero.

    One more move runs backwards before the window: its ringing reaches into the record, and it leaves the bristles of
    the friction as a real machine finds them.
    """
    clock = time.reshape(-1, *(1 for _ in shape))
    starts = [rng.uniform(-0.26, -0.20, shape)] + [rng.uniform(*s, shape) * duration for s in program.starts]
    speed = np.zeros((time.size, *shape))
    acceleration = np.zeros_like(speed)
    cruise = rng.uniform(*program.cruise, shape)
    for i, start in enumerate(starts):
        if i % 2 == 1 and i > 1:  # a pair goes and returns the same way, so that the table stays where it is
            cruise = rng.uniform(*program.cruise, shape)
        sign = -1.0 if i % 2 == 0 else 1.0
        ramp = rng.uniform(*program.ramp, shape)
        for begin, slope in ((start, sign), (start + ramp + cruise, -sign)):
            speed += slope * program.speed * np.clip((clock - begin) / ramp, 0.0, 1.0)
            acceleration += slope * program.speed / ramp * ((clock >= begin) & (clock < begin + ramp))
    travel = np.cumsum(speed, axis=0) * (time[1] - time[0])
    return Reference(travel - 0.5 * (travel.max(axis=0) + travel.min(axis=0)), speed, acceleration)


@dataclass(frozen=True, slots=True)
class Servo:
    """Position loop around a proportional-integral speed loop on the motor, with feed-forward of the ramp."""

    position_gain: float = 40.0  # [1/s]
    speed_bandwidth: float = 2.0 * np.pi * 45.0  # [rad/s]
    reset_time: float = 20e-3  # [s]
    torque_limit: float = 7.0  # [N·m]
    encoder_step: float = 0.0  # what its encoder resolves; 0: it sees angle and speed as they are [rad]
    speed_filter: float = 0.5e-3  # time constant behind the differences of what the encoder counts [s]


@dataclass(frozen=True, slots=True)
class Ripple:
    """Torque that the motor makes besides what it is asked for, periodic in its angle (cogging)."""

    amplitude: float = 0.0  # [N·m]
    per_revolution: int = 30

    def at(self, angle: FloatArray) -> FloatArray | float:
        """Return the torque at an angle [rad] of the motor [N·m]."""
        return self.amplitude * np.sin(self.per_revolution * angle) if self.amplitude else 0.0


class Encoder:
    """What the servo sees of the motor: counted angles, and speeds from their filtered differences."""

    def __init__(self, servo: Servo, shape: tuple[int, ...]) -> None:
        self._servo, self._angle, self._speed = servo, np.zeros(shape), np.zeros(shape)

    def read(self, angle: FloatArray, speed: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
        """Return angle [rad] and speed [rad/s] as seen, one step [s] after the last time."""
        resolution = self._servo.encoder_step
        if not resolution:
            return angle, speed
        counted = np.round(angle / resolution) * resolution
        self._speed = self._speed + step / self._servo.speed_filter * ((counted - self._angle) / step - self._speed)
        self._angle = counted
        return self._angle, self._speed
