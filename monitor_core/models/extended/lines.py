"""Many responses as one flat array of lines, prepared once for thousands of evaluations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.conditions import ConditionArrays, EndMasks, condition_arrays, end_masks
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
class PreparedLines:
    """All lines of all cases, one after the other, with what does not depend on the physics; shape (n_lines,) each."""

    conditions: ConditionArrays  # of the cases, shape (n_cases,)
    case: npt.NDArray[np.intp]  # which case a line belongs to
    omega: FloatArray  # [rad/s]
    weight: FloatArray  # share of the excitation's power: trapezoidal rule over the case's lines, sum 1 [-]
    ends: EndMasks
    by_torque: BoolArray
    table_per_force: BoolArray
    acceleration: npt.NDArray[np.intp]  # indices of the lines that are an acceleration of the table,
    angle_per_torque: npt.NDArray[np.intp]  # … that are an angle at the motor per torque,
    at_table: npt.NDArray[np.intp]  # … that answer at the table

    @property
    def n_cases(self) -> int:
        """How many responses there are."""
        return self.conditions.position.size


def prepare_lines(cases: Sequence[ResponseCase]) -> PreparedLines:
    """Put the lines of many responses side by side.

    Parameters
    ----------
    cases : sequence of ResponseCase
        The lines keep their order.

    Raises
    ------
    OutsideValidityError
        If there is no case, frequencies are not positive and rising, a torque does not go with the stated motor end, or
        the angle of a clamped motor end is asked for.
    """
    if not cases:
        raise OutsideValidityError("responses need at least one case; got none")
    for one in cases:
        _require_motor_end(one)
    frequencies = [require_frequencies(one.frequency) for one in cases]
    case = np.repeat(np.arange(len(cases)), [one.size for one in frequencies])
    by_torque = np.array([one.excitation is not ExcitationPoint.FORCE_AT_TABLE for one in cases])[case]
    angle = np.array([one.response is ResponsePoint.ANGLE_AT_MOTOR for one in cases])[case]
    acceleration = np.array([one.response is ResponsePoint.ACCELERATION_AT_TABLE for one in cases])[case]
    return PreparedLines(
        conditions=condition_arrays([one.conditions for one in cases]),
        case=case,
        omega=2.0 * np.pi * np.concatenate(frequencies),
        weight=np.concatenate([_power_shares(one) for one in frequencies]),
        ends=end_masks([one.motor_end for one in cases]).at(case),
        by_torque=by_torque,
        table_per_force=~by_torque & ~angle,
        acceleration=np.flatnonzero(acceleration),
        angle_per_torque=np.flatnonzero(angle & by_torque),
        at_table=np.flatnonzero(~angle),
    )


def _require_motor_end(case: ResponseCase) -> None:
    needed = motor_end_of(case.excitation, otherwise=case.motor_end)
    if case.motor_end is not needed:
        raise OutsideValidityError(f"a {case.excitation} needs a {needed} motor end; got {case.motor_end}")
    if case.motor_end is MotorEnd.CLAMPED and case.response is ResponsePoint.ANGLE_AT_MOTOR:
        raise OutsideValidityError("the motor end is clamped for this excitation and has no angle; excite by a torque")


def _power_shares(frequency: FloatArray) -> FloatArray:
    """Return each line's share of a flat spectrum from the first line to the last; all of it for a single line."""
    if frequency.size == 1:
        return np.ones(1)
    step = np.diff(frequency)
    if np.any(step <= 0.0):
        raise OutsideValidityError("the frequencies of a response must rise from line to line")
    width = np.r_[step, 0.0] + np.r_[0.0, step]
    return np.asarray(width / np.sum(width))
