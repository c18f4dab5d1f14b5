"""Motions in closed form and the force they need, written without the code under test."""

from dataclasses import dataclass

import numpy as np

from monitor_core.recording import MotionRecord

RATE = 1000.0


@dataclass(frozen=True)
class Truth:
    """What the axis really is."""

    mass: float = 80.0
    viscous: float = 300.0
    coulomb: float = 0.0
    towards_higher: float = 0.0  # viscous friction added in one direction [N·s/m]
    towards_lower: float = 0.0
    low_speed: float = 0.0  # friction added at low speed [N]
    low_speed_width: float = 0.01  # [m/s]
    offset: float = 0.0
    gain: float = 1.0
    delay: float = 0.0

    def force(self, velocity, acceleration):
        one_way = np.where(velocity > 0.0, self.towards_higher, self.towards_lower)
        friction = self.coulomb + self.low_speed / np.exp(np.abs(velocity) / self.low_speed_width)
        return (
            self.mass * acceleration
            + (self.viscous + one_way) * velocity
            + np.where(velocity > 0.0, friction, -friction)
        )


@dataclass(frozen=True)
class Motion:
    """A sum of sines that repeats after four seconds; its velocity passes zero slowly and quickly."""

    amplitudes: tuple[float, ...] = (0.06, 0.012, 0.006)  # [m]
    frequencies: tuple[float, ...] = (0.25, 1.25, 2.0)  # [Hz]

    def at(self, time, derivative):
        terms = zip(self.amplitudes, self.frequencies, strict=True)
        return sum(
            a * (2 * np.pi * f) ** derivative * np.sin(2 * np.pi * f * time + k + 0.5 * np.pi * derivative)
            for k, (a, f) in enumerate(terms)
        )


def simulated_record(
    truth=Truth(), *, duration=16.0, noise=0.3, seed=1, motion=Motion(), rate=RATE, reference=True
) -> MotionRecord:
    """Return the record of a drive that notes a force before it acts, with white noise, beside a fine encoder."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * rate)) / rate
    acts = time + truth.delay
    force = truth.gain * truth.force(motion.at(acts, 1), motion.at(acts, 2)) + truth.offset
    position = np.round(motion.at(time, 0) / 5e-8) * 5e-8
    return MotionRecord(
        rate,
        position,
        force + noise * rng.standard_normal(time.size),
        reference=motion.at(time, 0) if reference else None,
    )
