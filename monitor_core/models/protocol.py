"""Define what every drive model is asked, under which conditions, and what it answers.

Four published models predict the same axis. They differ in what they neglect, not in what they can be asked: the
response at a stated point to an excitation at a stated point, and the natural frequencies. Which poles a response has
depends on what holds the motor end of the screw, so that is stated too: a torque that is *measured* between motor and
screw is prescribed there and hides the motor; a motor held by its servo clamps it.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import DriveParameters
from monitor_core.response import FrequencyResponse


class ExcitationPoint(StrEnum):
    """Where a model is driven, by its name in files (``input``)."""

    TORQUE_AT_SCREW = "torque-at-screw"  #: prescribed at the motor end of the screw [N·m]
    TORQUE_AT_MOTOR = "torque-at-motor"  #: on the rotor [N·m]
    FORCE_AT_TABLE = "force-at-table"  #: along the axis [N]


class ResponsePoint(StrEnum):
    """What a model answers with, by its name in files (``output``)."""

    ACCELERATION_AT_TABLE = "acceleration-at-table"  #: [m/s²]
    ACCELERATION_AT_NUT = "acceleration-at-nut"  #: before the bracket that carries the table [m/s²]
    DISPLACEMENT_AT_TABLE = "displacement-at-table"  #: [m]
    ANGLE_AT_MOTOR = "angle-at-motor"  #: of the rotor; of the screw's motor end where no motor turns with it [rad]

    @property
    def is_acceleration(self) -> bool:
        """Whether an accelerometer shows it."""
        return self in (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT)


class MotorEnd(StrEnum):
    """What holds the motor end of the screw."""

    CLAMPED = "clamped"  #: the rotor stands still, as if its servo were rigid
    FREE = "free"  #: the rotor turns freely: the whole drive, with a rigid-body mode
    PRESCRIBED = "prescribed"  #: the torque at the end of the screw is given; neither rotor nor coupling take part


@dataclass(frozen=True, slots=True)
class DriveConditions:
    """What the prediction is for (influence quantities of an axis).

    A preload is only stated where the nut's rigidity is to follow from it, Eq. (1) of Nguyen et al. (2018). Temperature
    and excitation level move none of the four models as published; they are here for effects that are added to them.
    """

    position: float  # of the table from the fixed bearing [m]
    preload: float | None = None  # [N]
    payload_mass: float = 0.0  # on the table [kg]
    temperature_deviation: float = 0.0  # from the reference temperature [K]
    excitation_level: float = 0.0  # rms of the excitation [N·m or N]; 0: small signals

    def __post_init__(self) -> None:
        for name, unit in (
            ("position", "m"), ("payload_mass", "kg"), ("temperature_deviation", "K"), ("excitation_level", "N·m or N"),
        ):  # fmt: skip
            value = getattr(self, name)
            if not math.isfinite(value):
                raise OutsideValidityError(f"{name} must be finite; got {value} {unit}")
        if self.payload_mass < 0.0:
            raise OutsideValidityError(f"payload_mass must not be negative; got {self.payload_mass} kg")
        if self.preload is not None and not (math.isfinite(self.preload) and self.preload > 0.0):
            raise OutsideValidityError(f"preload must be positive; got {self.preload} N")
        if self.excitation_level < 0.0:
            raise OutsideValidityError(f"excitation_level must not be negative; got {self.excitation_level}")


@dataclass(frozen=True, slots=True)
class NaturalFrequency:
    """One pole pair of a model: ω_n = |s|, ζ = −Re(s)/|s|."""

    frequency: float  # undamped natural frequency ω_n/2π; 0 for a rigid-body mode [Hz]
    damping_ratio: float  # [-]; 0 for a rigid-body mode


@dataclass(frozen=True, slots=True, eq=False)
class NormalModes:
    """Undamped modes, mass-normalised, with the damping ratio of each: what modal superposition needs.

    The receptance between points a and b is Σ φ_a φ_b/(ω_n² − ω² + 2jζ ω_n ω); a rigid-body mode has ω_n = 0. What is
    neglected is the static share of the modes beyond the last.
    """

    frequency: FloatArray  # shape (n_modes,), rising, rigid-body mode first [Hz]
    damping_ratio: FloatArray  # shape (n_modes,) [-]
    angle_at_motor: FloatArray  # shape (n_modes,): φ where a torque acts [rad/(m·√kg)]
    displacement_at_table: FloatArray  # shape (n_modes,): φ where a force at the table acts [1/√kg]

    def __post_init__(self) -> None:
        for name in ("frequency", "damping_ratio", "angle_at_motor", "displacement_at_table"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        parts = (self.frequency, self.damping_ratio, self.angle_at_motor, self.displacement_at_table)
        if len({array.shape for array in parts}) != 1:
            raise OutsideValidityError("modes must have a frequency, a damping ratio and two shape values each")


class DriveModel(Protocol):
    """A prediction of an axis."""

    @property
    def parameters(self) -> DriveParameters:
        """The family's record of parameters."""
        ...

    def frequency_response(
        self,
        frequency: FloatArray,
        conditions: DriveConditions,
        *,
        excitation: ExcitationPoint,
        response: ResponsePoint,
    ) -> FrequencyResponse:
        """Return the response per unit excitation, named by ISO 7626.

        The frequencies [Hz] have the shape (n_frequencies,). The two points say where the drive is driven and where it
        answers; a torque also says what holds the motor end. ``OutsideValidityError`` if a frequency is not positive or
        a condition is out of the model's range.
        """
        ...

    def natural_frequencies(
        self, conditions: DriveConditions, motor_end: MotorEnd | None = None
    ) -> tuple[NaturalFrequency, ...]:
        """Return the poles in order of frequency, rigid-body mode first; ``None`` stands for the paper's motor end."""
        ...

    def normal_modes(self, conditions: DriveConditions, motor_end: MotorEnd | None = None) -> NormalModes:
        """Return the undamped modes that modal superposition needs."""
        ...


class PreparedResponse(Protocol):
    """The lines of one response as a function of the joints alone, all else computed beforehand."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints by their names in files, in the order of the gradient."""
        ...

    def at(self, parameters: DriveParameters) -> ComplexArray:
        """Return the response for an axis that differs in its joints alone, shape (n_frequencies,)."""
        ...

    def gradient(self, parameters: DriveParameters) -> ComplexArray | None:
        """Return d H/d ln joint, shape (n_joints, n_frequencies); None where there is no closed form."""
        ...


@runtime_checkable
class HasJointGradient(Protocol):
    """A drive model that offers, besides its answers, a response as a function of its joints with the gradient."""

    def joint_response(
        self, frequency: FloatArray, conditions: DriveConditions, excitation: ExcitationPoint, response: ResponsePoint
    ) -> PreparedResponse:
        """Prepare the lines of a response, shape (n_frequencies,) [Hz]."""
        ...


#: What a response is called (ISO 7626), by what was excited and what answers.
_QUANTITIES = {
    (True, ResponsePoint.ACCELERATION_AT_TABLE): "torque_accelerance",  # [m/(N·m·s²)]
    (True, ResponsePoint.ACCELERATION_AT_NUT): "torque_accelerance",
    (True, ResponsePoint.DISPLACEMENT_AT_TABLE): "torque_receptance",  # [m/(N·m)]
    (True, ResponsePoint.ANGLE_AT_MOTOR): "rotational_receptance",  # [rad/(N·m)]
    (False, ResponsePoint.ACCELERATION_AT_TABLE): "accelerance",  # [m/(N·s²)]
    (False, ResponsePoint.ACCELERATION_AT_NUT): "accelerance",
    (False, ResponsePoint.DISPLACEMENT_AT_TABLE): "receptance",  # [m/N]
    (False, ResponsePoint.ANGLE_AT_MOTOR): "angle_per_force",  # [rad/N]
}


def quantity_of(excitation: ExcitationPoint, response: ResponsePoint) -> str:
    """Name the quantity of a frequency response."""
    return _QUANTITIES[excitation is not ExcitationPoint.FORCE_AT_TABLE, response]


def motor_end_of(excitation: ExcitationPoint, otherwise: MotorEnd) -> MotorEnd:
    """Tell what holds the motor end while a model is driven somewhere; ``otherwise`` where no torque is given."""
    return {
        ExcitationPoint.TORQUE_AT_SCREW: MotorEnd.PRESCRIBED,
        ExcitationPoint.TORQUE_AT_MOTOR: MotorEnd.FREE,
    }.get(excitation, otherwise)


def require_frequencies(frequency: FloatArray) -> FloatArray:
    """Return the frequencies as an array, or refuse them: a drive that is free to move has no response at rest."""
    array = np.asarray(frequency, dtype=np.float64)
    if array.ndim != 1 or not np.all(np.isfinite(array)) or np.any(array <= 0.0):
        raise OutsideValidityError("frequencies must be finite and positive, in one dimension")
    return array


#: Shortest part of a screw, of all of it: a nanometre of a metre. Of less, the stiffness is no number.
_SHORTEST_SHARE = 1e-9


def require_position(position: float, screw_length: float) -> float:
    """Return the position, or refuse one that is not on the screw: what is left of it on a side has a stiffness."""
    least = _SHORTEST_SHARE * screw_length
    if not least <= position <= screw_length - least:
        raise OutsideValidityError(f"position must lie on the screw, within 0 and {screw_length} m; got {position} m")
    return position
