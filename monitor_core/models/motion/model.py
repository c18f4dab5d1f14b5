"""Model of a rigid axis in motion, as a file declares it, and the motor force that a motion needs by it."""

import math
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.motion.kinematics import Kinematics
from monitor_core.models.parameters import DriveParameters, transmission_ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPhysics:
    """A mass with viscous friction; everything else is absent at its default."""

    moving_mass: float  # with what the rotating parts add to it [kg]
    viscous_friction: float = 0.0  # mean of both directions [N·s/m]
    coulomb_friction: float = 0.0  # [N]
    viscous_difference: float = 0.0  # that towards higher positions less that towards lower ones [N·s/m]
    stribeck_friction: float = 0.0  # that of a motion about to stop less Coulomb friction [N]
    stribeck_velocity: float = 0.01  # at which 1/e of it is left [m/s]
    force_offset: float = 0.0  # recorded where there is no force [N]
    force_gain_error: float = 0.0  # recorded over true force, less one [-]
    force_delay: float = 0.0  # from a recorded force to the motion that it makes [s]

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not math.isfinite(value):
                raise OutsideValidityError(f"{item.name} must be finite; got {value}")
        for name in ("moving_mass", "stribeck_velocity"):
            if not getattr(self, name) > 0.0:
                raise OutsideValidityError(f"{name} must be positive; got {getattr(self, name)}")
        for name in ("viscous_friction", "coulomb_friction"):
            if getattr(self, name) < 0.0:
                raise OutsideValidityError(f"{name} must not be negative; got {getattr(self, name)}")


def forces(physics: MotionPhysics, motion: Kinematics) -> FloatArray:
    r"""Predict the recorded motor force of a motion in newtons, shape (n_samples,).

    .. math::

        F = M a + F_v v + \tfrac12 \Delta F_v |v| + (F_c + F_s e^{-|v| / v_s}) \operatorname{sgn} v

    is the force that the motion needs: the model of [1]_ with friction that depends on the direction, and with Tustin's
    low-speed term, see [2]_. Recorded is :math:`(1 + \varepsilon) F(t + \tau) + F_0`, since a force that acts a
    delay later is in the record before the motion it makes; at the end, a positive delay long, the last force is held.
    At standstill friction balances whatever acts, which no function of the velocity gives.

    References
    ----------
    .. [1] A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System
       Identification Benchmarks, 2019.
    .. [2] B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and compensation
       methods for the control of machines with friction, Automatica 30, 1994.
    """
    v = motion.velocity
    low_speed = physics.stribeck_friction * np.exp(-np.abs(v) / physics.stribeck_velocity)
    force = (
        physics.moving_mass * motion.acceleration
        + physics.viscous_friction * v
        + 0.5 * physics.viscous_difference * np.abs(v)
        + (physics.coulomb_friction + low_speed) * np.sign(v)
    )
    recorded = _advanced(force, physics.force_delay * motion.sample_rate)
    return (1.0 + physics.force_gain_error) * recorded + physics.force_offset


def _advanced(samples: FloatArray, by: float) -> FloatArray:
    """Return the samples of a later time, by cubic convolution (Keys 1981): smooth in the delay, as a search needs."""
    whole = math.floor(by)
    t = by - whole
    weights = (-t + 2.0 * t**2 - t**3, 2.0 - 5.0 * t**2 + 3.0 * t**3, t + 4.0 * t**2 - 3.0 * t**3, t**3 - t**2)
    at = np.arange(samples.size) + whole
    neighbours = (samples[np.clip(at + k, 0, samples.size - 1)] for k in (-1, 0, 1, 2))
    return sum((0.5 * weight * values for weight, values in zip(weights, neighbours, strict=True)), np.zeros(()))


#: By its name in files. It has no natural frequencies and is none of the drive families.
FAMILY = "motion"


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionParameters(DriveParameters):
    """What a file states of a rigid axis."""

    moving_mass: float  # with what the rotating parts add to it [kg]
    viscous_friction: float = 0.0  # [N·s/m]
    screw_lead: float | None = None  # where the record is of torque [m]

    def __post_init__(self) -> None:
        DriveParameters.__post_init__(self)
        if self.screw_lead == 0.0:
            raise OutsideValidityError("screw_lead_m must be positive and finite; got 0.0 m")

    def force_of_torque(self, torque: FloatArray) -> FloatArray:
        """Return the axial force F = 2πT/p of a motor torque, shape (n_samples,) [N]; the lead has to be stated."""
        if self.screw_lead is None:
            raise OutsideValidityError(
                "a motion record of torque needs screw_lead_m in the motion model to become a force; it is not stated"
            )
        return torque / transmission_ratio(self.screw_lead)


@dataclass(frozen=True, slots=True)
class MotionModel:
    """A rigid axis: what its file states, and what it is made of with the effects added to it."""

    parameters: MotionParameters
    physics: MotionPhysics

    @classmethod
    def of(cls, parameters: MotionParameters) -> Self:
        """Return the axis as stated, nothing added."""
        return cls(
            parameters,
            MotionPhysics(moving_mass=parameters.moving_mass, viscous_friction=parameters.viscous_friction),
        )

    def forces(self, motion: Kinematics) -> FloatArray:
        """Return the recorded motor force of a motion, shape (n_samples,) [N]; see :func:`forces`."""
        return forces(self.physics, motion)
