"""Sizes of a machine and its measurement by themselves: what the ranges of effects are multiples of.

An absolute range is that of one machine: ten newtons of preload a kelvin are much for an axis of 20 kg and nothing for
one of two tonnes. Scale an axis, masses by a, stiffnesses by a b², lengths by c, and every size here goes with it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from monitor_core.errors import OutsideValidityError


class Reference(StrEnum):
    """What the range of an effect's parameter is a multiple of, by what it is called and its unit."""

    NONE = "1"  # a pure number, or a value as it is
    MOVING_MASS = "moving mass [kg]"
    INVERSE_MASS = "1/moving mass [1/kg]"
    PAYLOAD = "payload [kg]"
    AXIAL_STIFFNESS = "axial stiffness [N/m]"
    AXIAL_COMPLIANCE = "axial compliance [m/N]"
    BEARING_STIFFNESS = "stiffness of the fixed bearing [N/m]"
    TURNING_INERTIA = "inertia of all that turns and moves, at the motor [kg·m²]"
    ROTOR_STIFFNESS = "spring that turns the drive at its first natural frequency [N·m/rad]"
    ROTOR_DAMPING = "damper that holds the drive at its first natural frequency [N·m·s/rad]"
    LENGTH = "length of the screw [m]"
    PRELOAD = "preload [N]"
    NUT_DEFLECTION = "1/deflection of the nut by its preload² [1/m²]"
    EXCITATION_FORCE = "excitation as an axial force [N]"
    FREQUENCY = "first natural frequency [Hz]"
    BENDING_FREQUENCY = "frequency at which the screw bends between supports that let it turn [Hz]"
    PERIOD = "period of the first natural frequency [s]"
    INVERSE_SQUARE = "1/first natural frequency² [s²]"
    MOTOR_FORCE = "motor force [N]"
    FORCE_CHANGE = "change of the motor force [N]"  # about its mean: without what a hanging weight needs
    VELOCITY = "velocity [m/s]"
    VISCOUS_FRICTION = "change of the motor force over velocity [N·s/m]"
    CUTOFF_PERIOD = "shortest period of a motion [s]"


@dataclass(frozen=True, slots=True)
class MachineSizes:
    """The sizes of one machine under one measurement, in SI units."""

    values: Mapping[Reference, float]

    def __post_init__(self) -> None:
        for reference, value in self.values.items():
            if not (math.isfinite(value) and value > 0.0):
                raise OutsideValidityError(f"the {reference} of a machine must be positive and finite; got {value}")

    def of(self, reference: Reference) -> float:
        """Return the size of one kind; ``OutsideValidityError`` if this machine has none."""
        if reference is Reference.NONE:
            return 1.0
        if reference not in self.values:
            raise OutsideValidityError(
                f"an effect whose range is a multiple of the {reference} needs a machine with that; "
                f"got one with {', '.join(self.values)}"
            )
        return self.values[reference]


def drive_sizes(
    *,
    moving_mass: float,
    axial_stiffness: float,
    bearing_stiffness: float,
    nut_rigidity: float,
    turning_inertia: float,
    length: float,
    preload: float,
    payload: float,
    excitation_force: float,
    bending_frequency: float,
) -> MachineSizes:
    r"""Return the sizes of a drive from a few of them.

    .. math::

        \omega_1^2 = k/m, \qquad k_\varphi = J \omega_1^2, \qquad \delta_0 = P/k_{nut}

    are the first natural frequency of the table on the path of the force, the spring that turns everything at it, and
    the deflection at which a preloaded nut loses contact.

    Parameters
    ----------
    moving_mass : float
        Of table and nut. [kg]
    axial_stiffness : float
        From the table to ground, of the path of the force with the table in the middle. [N/m]
    bearing_stiffness : float
        Of the fixed bearing. [N/m]
    nut_rigidity : float
        Under the preload. [N/m]
    turning_inertia : float
        Of rotor, screw and the moving mass, at the motor. [kg·m²]
    length : float
        Of the screw. [m]
    preload : float
        As usual in the measurement. [N]
    payload : float
        The least that is on the table wherever there is one. [kg]
    excitation_force : float
        As usual in the measurement, rms. [N]
    bending_frequency : float
        At which the screw bends, its ends held where they are but free to turn. [Hz]
    """
    square = axial_stiffness / moving_mass
    frequency = math.sqrt(square) / (2.0 * math.pi)
    return MachineSizes(
        {
            Reference.MOVING_MASS: moving_mass,
            Reference.INVERSE_MASS: 1.0 / moving_mass,
            Reference.PAYLOAD: payload,
            Reference.AXIAL_STIFFNESS: axial_stiffness,
            Reference.AXIAL_COMPLIANCE: 1.0 / axial_stiffness,
            Reference.BEARING_STIFFNESS: bearing_stiffness,
            Reference.TURNING_INERTIA: turning_inertia,
            Reference.ROTOR_STIFFNESS: turning_inertia * square,
            Reference.ROTOR_DAMPING: turning_inertia * math.sqrt(square),
            Reference.LENGTH: length,
            Reference.PRELOAD: preload,
            Reference.NUT_DEFLECTION: (nut_rigidity / preload) ** 2,
            Reference.EXCITATION_FORCE: excitation_force,
            Reference.FREQUENCY: frequency,
            Reference.BENDING_FREQUENCY: bending_frequency,
            Reference.PERIOD: 1.0 / frequency,
            Reference.INVERSE_SQUARE: 1.0 / square,
        }
    )


def motion_sizes(*, force: float, change: float, velocity: float, cutoff: float) -> MachineSizes:
    """Return the sizes of a motion, and up to where it is seen [Hz].

    They are the rms of the motor force [N], that about its mean [N] and that of the velocity [m/s].
    """
    return MachineSizes(
        {
            Reference.MOTOR_FORCE: force,
            Reference.FORCE_CHANGE: change,
            Reference.VELOCITY: velocity,
            Reference.VISCOUS_FRICTION: change / velocity,
            Reference.CUTOFF_PERIOD: 1.0 / cutoff,
        }
    )
