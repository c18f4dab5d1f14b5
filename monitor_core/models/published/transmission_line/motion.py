"""Simulate the drive in time under a given torque and table force, with a nut that moves while waves travel."""

from collections.abc import MutableSequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.transmission_line.drive import SMOOTH_GUIDES, StribeckFriction, discretise
from monitor_core.models.published.transmission_line.grid import LineGrid
from monitor_core.models.published.transmission_line.kernel import (
    Inputs,
    LineState,
    Outputs,
    Rings,
    compiled_stepper,
    compiler_installed,
    plain_stepper,
)
from monitor_core.models.published.transmission_line.parameters import TransmissionLineParameters


@dataclass(frozen=True, slots=True, eq=False)
class DriveMotion:
    """What a drive does, one value for each time step, from rest."""

    time_step: float  # [s]
    acceleration_at_table: FloatArray  # shape (n_samples,) [m/s²]
    displacement_at_table: FloatArray  # shape (n_samples,) [m]
    angle_at_motor: FloatArray  # shape (n_samples,) [rad]

    def __post_init__(self) -> None:
        for name in ("acceleration_at_table", "displacement_at_table", "angle_at_motor"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def simulate_drive(
    parameters: TransmissionLineParameters,
    grid: LineGrid,
    conditions: DriveConditions,
    torque: FloatArray,
    *,
    motor_end: MotorEnd = MotorEnd.FREE,
    force_at_table: FloatArray | None = None,
    position: FloatArray | None = None,
    friction: StribeckFriction = SMOOTH_GUIDES,
) -> DriveMotion:
    r"""Run the drive in time, from rest.

    The nut sits between two nodes of each line, with weights 1 − a and a on them. That leaves out the kink of the
    line's displacement under the nut, which is put back as a compliance in series with it:

    .. math::

        a (1 - a) \left[ \frac{\Delta x_a}{EA} + i^2 \frac{\Delta x_t}{GJ} \right]

    With numba installed the steps are compiled; without it the same numbers take some two hundred times longer.

    ``grid``: sections and time step, from ``common_step_grid`` or ``synchronised_grid``; ``conditions``: position,
    preload and payload; ``torque``: on the rotor, or with a prescribed motor end on the screw [N·m], shape
    (n_samples,); ``motor_end``: what holds the motor end; a clamped one takes no torque; ``force_at_table``: along
    the axis [N], shape (n_samples,); ``position``: where the nut is at each step, instead of the position of the
    conditions [m], shape (n_samples,); ``friction``: dry friction of the guides. ``OutsideValidityError`` if the
    arrays differ in length or are not finite, the nut comes within a section of an end of the screw, or a clamped
    motor is given a torque.
    """
    torque = _finite("torque", torque, np.shape(torque))
    force = _finite("force_at_table", np.zeros_like(torque) if force_at_table is None else force_at_table, torque.shape)
    if motor_end is MotorEnd.CLAMPED and np.any(torque):
        raise OutsideValidityError("a clamped motor takes no torque; give zeros, or another motor end")
    if position is None:
        position = np.full_like(torque, conditions.position)
    place = _places(_finite("position", position, torque.shape), parameters.screw_length, grid)

    drive = discretise(parameters, grid, conditions, motor_end, friction)
    stepper, sequence = (compiled_stepper(), _array) if compiler_installed() else (plain_stepper(), _list)
    outputs = Outputs(*(sequence(np.zeros(torque.size)) for _ in range(3)))
    rings = Rings(*(sequence(np.zeros(n)) for n in 2 * (grid.axial_sections,) + 2 * (grid.torsional_sections,)))
    inputs = Inputs(*(sequence(values) for values in (torque, force, *place)))
    stepper(drive, LineState(), rings, inputs, outputs)
    return DriveMotion(grid.time_step, *(np.asarray(values) for values in outputs))


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
