"""Transmission-line model (Moreno-Castaneda et al., 2005): the screw as lines on which waves travel step by step."""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
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
from monitor_core.models.published.transmission_line.grid import LineGrid, closest_common_step_grid
from monitor_core.models.published.transmission_line.mobility import DiscreteDrive, response_at
from monitor_core.models.published.transmission_line.modes import natural_frequencies, normal_modes
from monitor_core.models.published.transmission_line.parameters import TransmissionLineParameters
from monitor_core.response import FrequencyResponse


@dataclass(frozen=True, slots=True)
class TransmissionLineModel:
    """The discretised drive of Moreno-Castaneda et al. (2005): bearings to ground, one time step for both lines.

    What it answers is exact for the discretised drive: the same as a run of ``simulate_drive`` on ``grid`` would give.
    Poles are given up to the fourth half-wave of the free screw in torsion.

    Notes
    -----
    Eqs. (22)–(32) of Moreno-Castaneda et al. (2005) as printed put the stiffness of a bearing between two pieces of the
    screw, not between the screw and ground; here it is to ground. Table mass, nut and motor are not in the paper and
    are trapezoidal stubs. There is no loss factor, which has no counterpart in time.
    """

    parameters: TransmissionLineParameters
    #: The torsional line has so many sections to twice as many, whichever rounds the axial delay least. [-]
    least_torsional_sections: int = 80

    @property
    def grid(self) -> LineGrid:
        """Sections of the lines and their common time step."""
        return closest_common_step_grid(self.parameters, self.least_torsional_sections)

    def frequency_response(
        self,
        frequency: FloatArray,
        conditions: DriveConditions,
        *,
        excitation: ExcitationPoint,
        response: ResponsePoint,
    ) -> FrequencyResponse:
        """Return the response below half the sampling rate of the grid; a force at the table finds the rotor free."""
        frequency = require_frequencies(frequency)
        drive = self._drive(conditions, motor_end_of(excitation, otherwise=MotorEnd.FREE))
        highest = 0.5 / drive.grid.time_step
        if np.any(frequency >= highest):
            raise OutsideValidityError(
                f"frequencies must lie below half the sampling rate of the lines, {highest:g} Hz; "
                f"got {np.max(frequency):g} Hz"
            )
        values = response_at(drive, 2j * math.pi * frequency, excitation, response)
        return FrequencyResponse(frequency, values, quantity_of(excitation, response))

    def natural_frequencies(
        self, conditions: DriveConditions, motor_end: MotorEnd | None = None
    ) -> tuple[NaturalFrequency, ...]:
        """Return the poles in order of frequency, rigid-body mode first; the motor turns freely if none is stated."""
        return natural_frequencies(self._drive(conditions, motor_end))

    def normal_modes(self, conditions: DriveConditions, motor_end: MotorEnd | None = None) -> NormalModes:
        """Return the undamped modes; with a clamped motor no torque reaches any of them."""
        return normal_modes(self._drive(conditions, motor_end))

    def _drive(self, conditions: DriveConditions, motor_end: MotorEnd | None) -> DiscreteDrive:
        grid = self.grid
        grid.require_room(np.asarray(conditions.position), self.parameters.screw_length)
        return DiscreteDrive(self.parameters, grid, conditions, MotorEnd.FREE if motor_end is None else motor_end)
