"""A slow axis with play: a driven motor, a dead zone with a spring behind it, a table held by rolling friction.

It shares nothing with what estimates the play: time steps of a table that obeys Newton, not a curve of force over
deflection.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
#: Of the integration [s]: a fiftieth of the shortest period of the table on its spring.
STEP = 1e-4
SAMPLE_EVERY = 10  # 1 kHz


@dataclass(frozen=True, slots=True)
class SlowAxis:
    """An axis whose motor goes to and fro slowly; what it is made of may differ from draw to draw, shape (n_axes,)."""

    play: FloatArray  # [m]
    stiffness: FloatArray  # between motor and table [N/m]
    table_friction: FloatArray  # [N]
    screw_friction: FloatArray  # [N] at the table
    table_mass: float = 120.0  # [kg]
    motor_mass: float = 400.0  # inertia of motor and screw at the table [kg]
    table_presliding: float = 4e-6  # [m]
    screw_presliding: float = 8e-6  # [m]
    exponent: float = 1.0  # of force over deflection: 1.5 where nothing preloads the balls
    lead: float = 0.010  # [m]


@dataclass(frozen=True, slots=True)
class SlowRecord:
    """What the drive logs, shape (n_axes, n_samples)."""

    angle: FloatArray  # of the motor [rad]
    scale: FloatArray  # [m]
    torque: FloatArray  # [N·m]
    rate: float  # [Hz]


def go_to_and_fro(
    axis: SlowAxis,
    rng: np.random.Generator,
    *,
    turns: int = 8,
    amplitude: float = 3e-4,
    period: float = 2.0,
    encoder_step: float = 10e-9,
    scale_step: float = 10e-9,
    torque_noise: float = 3e-3,
    pitch_error: float = 2e-6,
    drift: float = 1e-6,
) -> SlowRecord:
    """Return a record of slow sinusoidal moves: steps of both encoders in metres at the table, drift in metres."""
    n = axis.play.size
    steps = round(0.5 * period * turns / STEP)
    time = np.arange(steps) * STEP
    omega = 2.0 * np.pi / period
    motor, speed = amplitude * np.sin(omega * time), amplitude * omega * np.cos(omega * time)
    acceleration = -(omega**2) * motor
    table, velocity = np.zeros(n), np.zeros(n)
    bristle, screw = np.zeros(n), np.zeros(n)
    kept_table, kept_force = [], []
    damping = 2.0 * 0.05 * np.sqrt(axis.stiffness * axis.table_mass)
    for i in range(steps):
        deflection = motor[i] - table
        beyond = np.sign(deflection) * np.maximum(np.abs(deflection) - 0.5 * axis.play, 0.0)
        # a curved contact is as stiff as the straight one at 5 µm
        spring = axis.stiffness * beyond * (np.abs(beyond) / 5e-6) ** (axis.exponent - 1.0)
        force = spring + np.where(beyond != 0.0, damping * (speed[i] - velocity), 0.0)
        bristle = _bristle(bristle, velocity, axis.table_presliding)
        screw = _bristle(screw, speed[i], axis.screw_presliding)
        friction = axis.table_friction * bristle + 2000.0 * velocity
        if i % SAMPLE_EVERY == 0:
            kept_table.append(table)
            kept_force.append(force + axis.screw_friction * screw + axis.motor_mass * acceleration[i])
        velocity = velocity + STEP * (force - friction) / axis.table_mass
        table = table + STEP * velocity
    at_table, at_motor = np.array(kept_table).T, motor[::SAMPLE_EVERY]
    to_torque, share = axis.lead / (2.0 * np.pi), np.linspace(0.0, 1.0, at_motor.size)
    phase, start = rng.uniform(0.0, 2.0 * np.pi, (2, n, 1))
    start = start * 0.1
    wandering = (
        pitch_error * np.sin(2.0 * np.pi * at_motor / axis.lead + phase) + drift * rng.standard_normal((n, 1)) * share
    )
    torque = np.array(kept_force).T * to_torque
    torque = torque * (1.0 + 0.02 * np.sin(2.0 * np.pi * 6.0 * at_motor / axis.lead + phase))  # ripple of the motor
    torque = torque + torque_noise * rng.standard_normal(torque.shape) + 0.05
    at_encoder = _quantised(at_motor + wandering + start, encoder_step)
    return SlowRecord(
        at_encoder / to_torque, _quantised(at_table + start, scale_step), torque, 1.0 / (STEP * SAMPLE_EVERY)
    )


def _bristle(deflection: FloatArray, velocity: FloatArray | float, presliding: float) -> FloatArray:
    """Advance a Dahl bristle, −1 to 1, exactly over a step of constant velocity."""
    limit = np.sign(velocity)
    return np.asarray(limit + (deflection - limit) * np.exp(-np.abs(velocity) * STEP / presliding))


def _quantised(values: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.round(values / step) * step)
