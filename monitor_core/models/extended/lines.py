"""Prepare many responses as one flat array of lines, once for thousands of evaluations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.conditions import ConditionArrays, EndMasks, condition_arrays, end_masks
from monitor_core.models.extended.excitations import Excitations, Setup, excitations_of
from monitor_core.models.extended.memory import Memory
from monitor_core.models.protocol import (
    DriveConditions,
    ExcitationPoint,
    MotorEnd,
    ResponsePoint,
    motor_end_of,
    require_frequencies,
)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseCase:
    """One response under one set of conditions."""

    frequency: FloatArray  # shape (n_frequencies,), above zero, rising [Hz]
    conditions: DriveConditions
    excitation: ExcitationPoint
    response: ResponsePoint
    motor_end: MotorEnd  # what holds it meanwhile; of a torque it follows, see ``motor_end_of``


@dataclass(frozen=True, slots=True, eq=False)
class DriveLines:
    """Where the drive itself is evaluated: once for all that answers to one excitation, shape (n_drive_lines,) each."""

    case: npt.NDArray[np.intp]  # a case whose conditions hold
    omega: FloatArray  # [rad/s]
    ends: EndMasks
    memory: Memory  # of what the drive answered there


@dataclass(frozen=True, slots=True, eq=False)
class PreparedLines:
    """All lines of all cases, one after the other, with what does not depend on the physics; shape (n_lines,) each."""

    conditions: ConditionArrays  # of the cases, shape (n_cases,); may be replaced where equal ones stay equal
    case: npt.NDArray[np.intp]  # which case a line belongs to
    omega: FloatArray  # [rad/s]
    drive: DriveLines
    drive_line: npt.NDArray[np.intp]  # which of them a line belongs to
    by_torque: BoolArray
    table_per_force: npt.NDArray[np.intp]  # indices of the lines that are a table's answer to a force there,
    acceleration: npt.NDArray[np.intp]  # … that are an acceleration,
    at_nut: npt.NDArray[np.intp]  # … that answer at the nut,
    angle_per_torque: npt.NDArray[np.intp]  # … that are an angle at the motor per torque,
    beyond_screw: npt.NDArray[np.intp]  # … that answer at the table or the nut that carries it
    excitations: Excitations  # of the cases


def prepare_lines(cases: Sequence[ResponseCase]) -> PreparedLines:
    """Put the lines of many responses side by side, in their order.

    ``OutsideValidityError`` if there is no case, frequencies are not positive and rising, a torque does not go with the
    stated motor end, or the angle of a clamped motor end is asked for.
    """
    if not cases:
        raise OutsideValidityError("responses need at least one case; got none")
    for case in cases:
        _require_motor_end(case)
    frequencies = [_require_rising(case.frequency) for case in cases]
    case_of_line = np.repeat(np.arange(len(cases)), [grid.size for grid in frequencies])
    by_torque = np.array([case.excitation is not ExcitationPoint.FORCE_AT_TABLE for case in cases])[case_of_line]
    angle = np.array([case.response is ResponsePoint.ANGLE_AT_MOTOR for case in cases])[case_of_line]
    acceleration = np.array([case.response.is_acceleration for case in cases])[case_of_line]
    at_nut = np.array([case.response is ResponsePoint.ACCELERATION_AT_NUT for case in cases])[case_of_line]
    setups = [Setup(case.conditions, case.excitation, case.motor_end) for case in cases]
    omega = 2.0 * np.pi * np.concatenate(frequencies)
    excitations = excitations_of(setups, [(2.0 * np.pi * grid[0], 2.0 * np.pi * grid[-1]) for grid in frequencies])
    drive, drive_line = _drive_lines(setups, excitations, case_of_line, omega)
    return PreparedLines(
        conditions=condition_arrays([case.conditions for case in cases]),
        case=case_of_line,
        omega=omega,
        drive=drive,
        drive_line=drive_line,
        by_torque=by_torque,
        table_per_force=np.flatnonzero(~by_torque & ~angle),
        acceleration=np.flatnonzero(acceleration),
        at_nut=np.flatnonzero(at_nut),
        angle_per_torque=np.flatnonzero(angle & by_torque),
        beyond_screw=np.flatnonzero(~angle),
        excitations=excitations,
    )


def _drive_lines(
    setups: Sequence[Setup], excitations: Excitations, case: npt.NDArray[np.intp], omega: FloatArray
) -> tuple[DriveLines, npt.NDArray[np.intp]]:
    """Return the distinct lines of what was excited together, and which of them each line is."""
    first: dict[tuple[Setup, int], int] = {}
    together = zip(setups, excitations.of_case.tolist(), strict=True)
    of_case = np.array([first.setdefault(setup, index) for index, setup in enumerate(together)])
    distinct, which = np.unique(np.column_stack([of_case[case], omega]), axis=0, return_inverse=True)
    of_line = distinct[:, 0].astype(np.intp)
    ends = end_masks([setup.motor_end for setup in setups])
    return DriveLines(of_line, distinct[:, 1], ends.at(of_line), Memory(of_line.size)), which.reshape(-1)


def _require_motor_end(case: ResponseCase) -> None:
    needed = motor_end_of(case.excitation, otherwise=case.motor_end)
    if case.motor_end is not needed:
        raise OutsideValidityError(f"a {case.excitation} needs a {needed} motor end; got {case.motor_end}")
    if case.motor_end is MotorEnd.CLAMPED and case.response is ResponsePoint.ANGLE_AT_MOTOR:
        raise OutsideValidityError("the motor end is clamped for this excitation and has no angle; excite by a torque")


def _require_rising(frequency: FloatArray) -> FloatArray:
    frequency = require_frequencies(frequency)
    if frequency.size == 0 or np.any(np.diff(frequency) <= 0.0):
        raise OutsideValidityError("the frequencies of a response must rise from line to line, and be at least one")
    return frequency
