"""Lay out the excitation of each measurement on lines close enough for rms values of the motion.

A resonance that rules the rms motion falls between the lines of a measured response. Excitations therefore have points
of their own. On them the drive is interpolated between knots: what is interpolated has no poles, is therefore smooth
over the whole band, and costs little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.models.extended.conditions import EndMasks, end_masks
from monitor_core.models.extended.memory import Memory
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd

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
    at, weight = knots[near] ** 2, np.ones(near.shape)
    for knot in range(order):
        for other in range(order):
            if knot != other:
                weight[:, knot] *= (points**2 - at[:, other]) / (at[:, knot] - at[:, other])
    shape = (points.size, knots.size)
    return scipy.sparse.csr_array((weight.ravel(), near.ravel(), np.arange(points.size + 1) * order), shape=shape)
