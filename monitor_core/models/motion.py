"""Model a rigid axis in motion, as a file declares it, and compute the motor force that a measured motion needs."""

import math
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import DriveParameters, transmission_ratio

#: Above the bandwidth of position loops, below what an encoder differentiated twice drowns in: that of the published
#: identification of the EMPS.
_HIGHEST_CUTOFF = 100.0  # [Hz]
#: Central differences read a sine of a tenth of the sample rate 6.5 % too small, one of a twenty-fifth 1 %.
_CUTOFF_SHARE = 0.1
_ORDER = 4


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """How an axis moved, uniformly sampled."""

    sample_rate: float  # [Hz]
    velocity: FloatArray  # shape (n_samples,) [m/s]
    acceleration: FloatArray  # shape (n_samples,) [m/s²]

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", read_only(self.velocity))
        object.__setattr__(self, "acceleration", read_only(self.acceleration))
        if self.velocity.shape != self.acceleration.shape or self.velocity.ndim != 1:
            raise OutsideValidityError(
                "velocity and acceleration must be of one length; "
                f"got shapes {self.velocity.shape} and {self.acceleration.shape}"
            )


def cutoff_frequency(sample_rate: float) -> float:
    """Return up to where a recorded motion is looked at: 100 Hz, or a tenth of a sample rate below 1 kHz [Hz]."""
    return min(_HIGHEST_CUTOFF, _CUTOFF_SHARE * sample_rate)


def kinematics_of(position: FloatArray, sample_rate: float) -> Kinematics:
    """Differentiate a measured position, shape (n_samples,), in metres.

    A Butterworth filter of order 4 at :func:`cutoff_frequency`, forwards and backwards so that nothing is delayed, then
    central differences, as in [1]_. The ends, about a tenth of a second, are those of the filter rather than of the
    axis. Too few samples for the filter raise ``OutsideValidityError``.

    References
    ----------
    .. [1] A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System
       Identification Benchmarks, 2019.
    """
    filtering = scipy.signal.butter(_ORDER, cutoff_frequency(sample_rate), output="sos", fs=sample_rate)
    fewest = 10 * _ORDER
    if position.size < fewest:
        raise OutsideValidityError(f"a motion needs at least {fewest} samples; got {position.size}")
    smooth = scipy.signal.sosfiltfilt(filtering, position)
    second = np.diff(smooth, 2) * sample_rate**2
    return Kinematics(sample_rate, np.gradient(smooth, 1.0 / sample_rate), np.pad(second, 1, mode="edge"))


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
    unit_ln_factor: float = 0.0  # ln of what mass and viscous friction act with in the units of the record [-]

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
    Where force or position is recorded in another unit, a factor stands before the stated M and F_v; whatever else acts
    is then in the units of the record. At standstill friction balances whatever acts, which no function of the velocity
    gives.

    References
    ----------
    .. [1] A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System
       Identification Benchmarks, 2019.
    .. [2] B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and compensation
       methods for the control of machines with friction, Automatica 30, 1994.
    """
    v = motion.velocity
    unit = math.exp(physics.unit_ln_factor)
    low_speed = physics.stribeck_friction * np.exp(-np.abs(v) / physics.stribeck_velocity)
    force = (
        unit * physics.moving_mass * motion.acceleration
        + unit * physics.viscous_friction * v
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
    indices = np.arange(samples.size) + whole
    neighbours = (samples[np.clip(indices + k, 0, samples.size - 1)] for k in (-1, 0, 1, 2))
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
