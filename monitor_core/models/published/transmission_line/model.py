"""Simulate a drive by transmission lines (Moreno-Castaneda et al., 2005): waves on the screw, step by step.

The drive is given a torque and a force at the table; its nut moves while waves travel.
"""

import math
from collections.abc import MutableSequence
from dataclasses import dataclass, fields
from typing import cast

import numpy as np

from monitor_core.arrays import FloatArray, read_only_samples
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
from monitor_core.models.published.transmission_line.grid import (
    SMOOTH,
    DriveFriction,
    LineGrid,
    SpeedControl,
    TransmissionLineParameters,
    closest_common_step_grid,
    discretise,
)
from monitor_core.models.published.transmission_line.kernel import (
    Inputs,
    LineDrive,
    LineState,
    Outputs,
    Rings,
    advance,
    compiled_stepper,
    compiler_installed,
)
from monitor_core.models.published.transmission_line.mobility import DiscreteDrive, response_at
from monitor_core.models.published.transmission_line.modes import natural_frequencies, normal_modes
from monitor_core.response import FrequencyResponse


@dataclass(frozen=True, slots=True, eq=False)
class DriveMotion:
    """What a drive does, one value for each time step, from rest; each of shape (n_samples,)."""

    time_step: float  # [s]
    acceleration_at_table: FloatArray  # [m/s²]
    displacement_at_table: FloatArray  # [m]
    angle_at_motor: FloatArray  # [rad]
    motor_torque: FloatArray  # on the rotor, of the current [N·m]
    screw_torque: FloatArray  # of the coupling on the screw, as a torque sensor behind it sees it [N·m]
    nut_torque: FloatArray  # of the screw on the nut, its friction included, as a strain gauge sees it [N·m]
    bearing_force: FloatArray  # of the screw on the mounting of its fixed bearing, as a load washer sees it [N]
    far_bearing_force: FloatArray  # on that of its far bearing [N]

    def __post_init__(self) -> None:
        for item in fields(self)[1:]:
            object.__setattr__(self, item.name, read_only_samples(getattr(self, item.name)))


def simulate_drive(
    parameters: TransmissionLineParameters,
    grid: LineGrid,
    conditions: DriveConditions,
    torque: FloatArray,
    *,
    motor_end: MotorEnd = MotorEnd.FREE,
    force_at_table: FloatArray | None = None,
    position: FloatArray | None = None,
    friction: DriveFriction = SMOOTH,
    control: SpeedControl | None = None,
    speed: FloatArray | None = None,
) -> DriveMotion:
    r"""Run the drive in time, from rest.

    The nut sits between two nodes of each line, with weights 1 − a and a on them. That leaves out the kink of the
    line's displacement under the nut, which is put back as a compliance in series with it:

    .. math:: a (1 - a) \left[ \frac{\Delta x_a}{EA} + i^2 \frac{\Delta x_t}{GJ} \right]

    With numba installed the steps are compiled; without it the same numbers take some two hundred times longer. The
    grid comes from ``common_step_grid`` or ``synchronised_grid``.

    Torque [N·m], force along the axis [N] and position [m] have the shape (n_samples,). The torque acts on the rotor,
    or with a prescribed motor end on the screw; a clamped motor end takes none. A position says where the nut is at
    each step, instead of the position of the conditions. With ``control`` the motor follows the commanded ``speed``
    [rad/s] of that shape, and the torque acts besides, as a disturbance. ``OutsideValidityError`` if the arrays differ
    in length or are not finite, the nut comes within a section of an end of the screw, a speed is commanded without
    ``control``, or a motor that does not turn freely is given what only such a one takes.
    """
    torque = _finite("torque", torque, np.shape(torque))
    force = _finite("force_at_table", np.zeros_like(torque) if force_at_table is None else force_at_table, torque.shape)
    if motor_end is MotorEnd.CLAMPED and np.any(torque):
        raise OutsideValidityError("a clamped motor takes no torque; give zeros, or another motor end")
    if control is not None and motor_end is not MotorEnd.FREE:
        raise OutsideValidityError(f"a speed loop drives a motor that turns freely; got {motor_end}")
    if speed is not None and control is None:
        raise OutsideValidityError("a commanded speed is followed by a speed loop; got a speed without control")
    commanded = _finite("speed", np.zeros_like(torque) if speed is None else speed, torque.shape)
    if position is None:
        position = np.full_like(torque, conditions.position)
    position = _finite("position", position, torque.shape)
    drive = discretise(parameters, grid, conditions, motor_end, friction, control=control)
    run = DriveRun(drive, grid, parameters.screw_length)
    return DriveMotion(grid.time_step, *run.advance(torque, commanded, force, position))


class DriveRun:
    """A drive from rest, advanced piece by piece; what it is given is that of :func:`simulate_drive`, and finite."""

    def __init__(self, drive: LineDrive, grid: LineGrid, screw_length: float) -> None:
        self._drive, self._grid, self._length = drive, grid, screw_length
        self._stepper, self._sequence = (compiled_stepper(), _array) if compiler_installed() else (advance, _list)
        self._rings = Rings(
            *(self._sequence(np.zeros(n)) for n in 2 * (grid.axial_sections,) + 2 * (grid.torsional_sections,))
        )
        self._state = LineState()

    def advance(
        self, torque: FloatArray, speed: FloatArray, force: FloatArray, position: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Return what ``Outputs`` names over the next steps, write-protected."""
        places = _places(position, self._length, self._grid)
        inputs = Inputs(*(self._sequence(values) for values in (torque, speed, force, *places)))
        outputs = Outputs(*(self._sequence(np.zeros(torque.size)) for _ in Outputs._fields))
        self._state = self._stepper(self._drive, self._state, self._rings, inputs, outputs)
        recorded = tuple(np.asarray(values) for values in outputs)
        for samples in recorded:
            samples.setflags(write=False)
        return recorded


def _array(values: FloatArray) -> MutableSequence[float]:
    """Return what the compiled stepper takes: an array, which has all of a sequence that the stepper uses."""
    return cast(MutableSequence[float], np.ascontiguousarray(values))


def _list(values: FloatArray) -> MutableSequence[float]:
    """Return what the plain stepper takes; Python is faster with lists than with arrays."""
    return cast(MutableSequence[float], values.tolist())


def _finite(name: str, values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or array.shape != shape:
        raise OutsideValidityError(f"{name} must have one dimension and the length of the torque; got {array.shape}")
    if not np.all(np.isfinite(array)):
        raise OutsideValidityError(f"{name} must be finite; got {array[~np.isfinite(array)][0]}")
    return array


def _places(position: FloatArray, length: float, grid: LineGrid) -> tuple[FloatArray, FloatArray]:
    """Count positions in axial and torsional sections; the nut must leave room for the ends."""
    grid.require_room(position, length)
    return position * (grid.axial_sections / length), position * (grid.torsional_sections / length)


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
