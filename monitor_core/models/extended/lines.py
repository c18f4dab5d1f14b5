"""Prepare many responses as one flat array of lines, with the excitations behind them, for thousands of evaluations.

A resonance that rules the rms motion falls between the lines of a measured response. Excitations therefore have points
of their own, close enough for rms values of the motion. On them the drive is interpolated between knots: what is
interpolated has no poles, is therefore smooth over the whole band, and costs little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.conditions import ConditionArrays, EndMasks, condition_arrays, end_masks
from monitor_core.models.extended.memory import Memory
from monitor_core.models.protocol import (
    DriveConditions,
    ExcitationPoint,
    MotorEnd,
    ResponsePoint,
    motor_end_of,
    require_frequencies,
)

#: Relative distance of points. The trapezoidal rule is off by 2 exp(−2π ζ/distance) of the mean square of a resonance
#: of damping ratio ζ: by 1.6 % at ζ = 0.5 %, by 1e-4 at 1 %. [-]
_POINT_DISTANCE = 0.0065
#: Relative distance of knots. [-]
_KNOT_DISTANCE = 0.06
#: Knots that a point is interpolated between, by a polynomial in ω², in which a drive without damping is nearly one.
_NEIGHBOURS = 4


class FoundLast(dict[tuple[float, ...], tuple[Any, ...]]):
    """What was found last for each kind of question; left behind where lines go to another process."""

    def __reduce__(self) -> tuple[type["FoundLast"], tuple[()]]:
        return FoundLast, ()


@dataclass(frozen=True, slots=True)
class Setup:
    """Under what a response is taken; responses of one setup whose bands overlap were taken together."""

    conditions: DriveConditions
    excitation: ExcitationPoint
    motor_end: MotorEnd


@dataclass(frozen=True, slots=True, eq=False)
class Excitations:
    """Excitations of a stated level: each flat from the first to the last line of the responses that it served."""

    of_case: npt.NDArray[np.intp]  # which excitation a case belongs to, −1 where it is of small signals; (n_cases,)
    case: npt.NDArray[np.intp]  # one of the cases of each excitation; shape (n_excitations,)
    of_knot: npt.NDArray[np.intp]  # which excitation a knot belongs to; shape (n_knots,)
    omega: FloatArray  # of the knots, shape (n_knots,) [rad/s]
    ends: EndMasks  # of the knots
    by_torque: BoolArray  # of the knots, shape (n_knots,)
    interpolation: Any  # sparse array, from values at knots to values at points; shape (n_points, n_knots)
    of_point: npt.NDArray[np.intp]  # which excitation a point belongs to, rising, each as many; shape (n_points,)
    weight: FloatArray  # share of the excitation's power, sum 1 over each; shape (n_points,) [-]
    memory: Memory  # of what the drive answered at the knots
    balances: FoundLast = field(default_factory=FoundLast, init=False)  # of motion and linearisation; amplitude.py

    @property
    def size(self) -> int:
        """How many there are."""
        return self.case.size


def excitations_of(setups: Sequence[Setup], bands: Sequence[tuple[float, float]]) -> Excitations:
    """Return the excitations behind many responses, from setup and first and last line [rad/s] of each case.

    Cases of small signals, at an excitation level of 0, have none. Bands that overlap under one setup become one.
    """
    of_case = np.full(len(setups), -1)
    spans: list[tuple[float, float]] = []
    case: list[int] = []  # that first has each span
    reached: dict[Setup, int] = {}
    for number in sorted(range(len(setups)), key=lambda number: bands[number]):
        setup, (first, last) = setups[number], bands[number]
        if setup.conditions.excitation_level == 0.0:
            continue
        latest = reached.get(setup)
        if latest is None or first > spans[latest][1]:
            latest = reached[setup] = len(spans)
            spans.append((first, last))
            case.append(number)
        spans[latest] = (spans[latest][0], max(last, spans[latest][1]))
        of_case[number] = latest
    return _on_grids(of_case, case, [setups[number] for number in case], spans)


def _on_grids(
    of_case: npt.NDArray[np.intp], case: Sequence[int], setups: Sequence[Setup], spans: Sequence[tuple[float, float]]
) -> Excitations:
    knots = [_spread(*span, _KNOT_DISTANCE, fewest=_NEIGHBOURS) for span in spans]
    points = [_spread(*span, _POINT_DISTANCE, fewest=_NEIGHBOURS) for span in spans]
    numbers, most = np.arange(len(spans)), max((grid.size for grid in points), default=0)
    # the last point stands several times, without power, where another excitation has more
    weights = [np.pad(_power_shares(grid), (0, most - grid.size)) for grid in points]
    points = [np.pad(grid, (0, most - grid.size), mode="edge") for grid in points]
    of_knot = np.repeat(numbers, [grid.size for grid in knots])
    by_torque = np.array([setup.excitation is not ExcitationPoint.FORCE_AT_TABLE for setup in setups], dtype=np.bool_)
    matrices = [_interpolation(*pair) for pair in zip(knots, points, strict=True)]
    return Excitations(
        of_case=of_case,
        case=np.array(case, dtype=np.intp),
        of_knot=of_knot,
        omega=np.concatenate([np.zeros(0), *knots]),
        ends=end_masks([setup.motor_end for setup in setups]).at(of_knot),
        by_torque=by_torque[of_knot],
        interpolation=scipy.sparse.block_diag(matrices, format="csr") if matrices else None,
        of_point=np.repeat(numbers, most),
        weight=np.concatenate([np.zeros(0), *weights]),
        memory=Memory(of_knot.size),
    )


def _spread(first: float, last: float, distance: float, *, fewest: int) -> FloatArray:
    """Return frequencies from first to last at one relative distance; one alone where these are the same."""
    if first == last:
        return np.array([first])
    return np.geomspace(first, last, max(fewest, int(np.ceil(np.log(last / first) / distance)) + 1))


def _power_shares(omega: FloatArray) -> FloatArray:
    """Return the share of each point of a flat spectrum, by the trapezoidal rule."""
    if omega.size == 1:
        return np.ones(1)
    step = np.diff(omega)
    return np.asarray((np.r_[step, 0.0] + np.r_[0.0, step]) / (2.0 * (omega[-1] - omega[0])))


def _interpolation(knots: FloatArray, points: FloatArray) -> Any:  # noqa: ANN401 scipy.sparse has no types
    """Return Lagrange's polynomial in ω² through the knots next to each point, (n_points, n_knots)."""
    order = min(_NEIGHBOURS, knots.size)
    first = np.clip(np.searchsorted(knots, points, side="right") - order // 2, 0, knots.size - order)
    near = first[:, None] + np.arange(order)
    square, weight = knots[near] ** 2, np.ones(near.shape)
    for knot in range(order):
        for other in range(order):
            if knot != other:
                weight[:, knot] *= (points**2 - square[:, other]) / (square[:, knot] - square[:, other])
    shape = (points.size, knots.size)
    return scipy.sparse.csr_array((weight.ravel(), near.ravel(), np.arange(points.size + 1) * order), shape=shape)


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
