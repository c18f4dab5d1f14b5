"""Answer for a drive that is written as a small system: responses, natural frequencies and normal modes."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.bracket import BeyondContacts, nut_from_table
from monitor_core.models.protocol import (
    DriveConditions,
    ExcitationPoint,
    MotorEnd,
    NaturalFrequency,
    NormalModes,
    ResponsePoint,
    motor_end_of,
    quantity_of,
    require_frequencies,
)
from monitor_core.models.published.second_order import SecondOrderSystem, modes_and_poles, poles, transfer_matrix
from monitor_core.response import FrequencyResponse


@dataclass(frozen=True, slots=True, eq=False)
class DriveEquations:
    """A drive as a small system, and the two points at which it is driven and watched.

    The row that picks a displacement is also the column by which a force on it acts (virtual work); so reciprocity
    is built in.
    """

    system: SecondOrderSystem
    angle_at_motor: FloatArray  # shape (n,): angle = row · q [rad per coordinate]; zeros where it is clamped
    displacement_at_table: FloatArray  # shape (n,): displacement = row · q [m per coordinate]

    def __post_init__(self) -> None:
        for name in ("angle_at_motor", "displacement_at_table"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            if getattr(self, name).shape != self.system.mass.shape[:1]:
                raise OutsideValidityError(f"{name} must have one number for each of the coordinates")


def drive_response(
    equations: DriveEquations,
    frequency: FloatArray,
    excitation: ExcitationPoint,
    response: ResponsePoint,
    beyond: Callable[[ComplexArray], BeyondContacts] | None = None,
) -> FrequencyResponse:
    """Return a frequency response of a drive at frequencies above zero [Hz], shape (n_frequencies,).

    ``beyond`` tells from jω what the contacts of the nut carry; without it the nut is one with the table. The angle of
    a clamped motor end raises ``OutsideValidityError``.
    """
    frequency = require_frequencies(frequency)
    if response is ResponsePoint.ANGLE_AT_MOTOR and not np.any(equations.angle_at_motor):
        raise OutsideValidityError("the motor end is clamped for this excitation and has no angle; excite by a torque")
    omega = 2.0 * np.pi * frequency
    s = np.asarray(1j * omega, dtype=np.complex128)
    of_table = response is not ResponsePoint.ANGLE_AT_MOTOR
    row = equations.displacement_at_table if of_table else equations.angle_at_motor
    to_row = row @ transfer_matrix(equations.system, s)
    per_force: NumberArray = to_row @ equations.displacement_at_table
    per_torque: NumberArray = to_row @ equations.angle_at_motor
    if response is ResponsePoint.ACCELERATION_AT_NUT and beyond is not None:
        per_force, per_torque = nut_from_table(per_force, per_torque, beyond(s))
    chosen = per_force if excitation is ExcitationPoint.FORCE_AT_TABLE else per_torque
    receptance = np.asarray(chosen, dtype=np.complex128)
    if response.is_acceleration:
        receptance = -(omega**2) * receptance
    return FrequencyResponse(frequency, receptance, quantity_of(excitation, response))


def drive_natural_frequencies(equations: DriveEquations) -> tuple[NaturalFrequency, ...]:
    """Return the poles of a drive as natural frequencies and damping ratios, rigid-body mode first."""
    return tuple(_natural_frequency(complex(s)) for s in poles(equations.system))


def drive_normal_modes(equations: DriveEquations) -> NormalModes:
    """Return the undamped modes of a drive, each with the damping ratio of its pole."""
    omega, shapes, own = modes_and_poles(equations.system)
    return NormalModes(
        omega / (2.0 * np.pi),
        np.array([_natural_frequency(complex(s)).damping_ratio for s in own]),
        equations.angle_at_motor @ shapes,
        equations.displacement_at_table @ shapes,
    )


def _natural_frequency(pole: complex) -> NaturalFrequency:
    magnitude = abs(pole)
    return NaturalFrequency(magnitude / (2.0 * np.pi), (0.0 - pole.real) / magnitude if pole else 0.0)


class SmallDrive(ABC):
    """A drive model whose equations of motion are a small system; the lumped and the hybrid model are such drives."""

    __slots__ = ()
    paper_motor_end: ClassVar[MotorEnd]  #: where no torque is given and nothing else is stated

    @abstractmethod
    def equations(self, conditions: DriveConditions, motor_end: MotorEnd) -> DriveEquations:
        """Return the matrices under the conditions, with a motor end."""

    @abstractmethod
    def beyond_contacts(self, s: ComplexArray, conditions: DriveConditions) -> BeyondContacts:
        """Return what the contacts of the nut carry at s = jω, for an accelerometer on the nut."""

    def frequency_response(
        self,
        frequency: FloatArray,
        conditions: DriveConditions,
        *,
        excitation: ExcitationPoint,
        response: ResponsePoint,
    ) -> FrequencyResponse:
        """Return the response per unit excitation; a force at the table finds the motor end as in the paper."""
        equations = self.equations(conditions, motor_end_of(excitation, otherwise=self.paper_motor_end))
        return drive_response(equations, frequency, excitation, response, lambda s: self.beyond_contacts(s, conditions))

    def natural_frequencies(
        self, conditions: DriveConditions, motor_end: MotorEnd | None = None
    ) -> tuple[NaturalFrequency, ...]:
        """Return the poles in order of frequency, rigid-body mode first."""
        return drive_natural_frequencies(self.equations(conditions, motor_end or self.paper_motor_end))

    def normal_modes(self, conditions: DriveConditions, motor_end: MotorEnd | None = None) -> NormalModes:
        """Return the undamped modes, each with the damping ratio of its pole."""
        return drive_normal_modes(self.equations(conditions, motor_end or self.paper_motor_end))
