"""Follow the natural frequencies of the extended drive to their poles while its damping grows."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.closed_form import EntireParts, characteristic, entire_parts
from monitor_core.models.extended.conditions import AxisStates, EndMasks
from monitor_core.models.extended.physics import AxisPhysics
from monitor_core.models.poles import zeros_near

Index = npt.NDArray[np.intp]

#: Largest step of the damping, and the smallest before a pole is given up, as shares of the damping.
_LARGEST_DEGREE, _SMALLEST_DEGREE = 0.5, 2.0**-14
#: Largest move of a pole in one step, as a share of its distance to the next one, and of its own magnitude.
_FOLLOWED, _LARGEST_MOVE = 0.1, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """The undamped or partly damped drive, ready to be asked at any frequency under any of the conditions."""

    physics: AxisPhysics
    states: AxisStates
    ends: EndMasks

    def parts(self, omega: NumberArray, condition: Index) -> EntireParts:
        """Return the parts of the drive at frequencies [rad/s], each under its condition."""
        return entire_parts(self.physics, omega, self.states.at(condition), self.ends.at(condition))


def follow_damping(drives_with: Callable[[float], Drives], omega: ComplexArray, condition: Index) -> ComplexArray:
    """Follow the zeros from the undamped ones while damping grows, in steps so small that none takes another's place.

    ``drives_with`` returns the drives with a share of their damping.
    """
    share, degree = 0.0, _LARGEST_DEGREE
    while share < 1.0:
        degree = min(degree, 1.0 - share)
        after = _newton(drives_with(share + degree), omega, condition)
        room = np.minimum(_room(omega, condition), _room(after, condition))
        if np.all(np.abs(after - omega) <= room):  # not where it is nan
            omega, share, degree = after, share + degree, min(2.0 * degree, _LARGEST_DEGREE)
        elif degree > _SMALLEST_DEGREE:
            degree *= 0.5
        else:
            lost = float(np.abs(omega[np.argmin(room - np.abs(after - omega))])) / (2.0 * math.pi)
            raise OutsideValidityError(
                f"the mode near {lost:.6g} Hz is damped so strongly that it ceases to oscillate or meets another one, "
                f"at {share:.3%} of its damping; this model needs underdamped modes"
            )
    return omega


def _room(omega: ComplexArray, condition: Index) -> FloatArray:
    """Return how far each zero may move at once: a share of the distance to the next zero, or to its mirror image."""
    apart = np.where(condition[:, None] == condition[None, :], np.abs(omega[:, None] - omega[None, :]), np.inf)
    np.fill_diagonal(apart, 2.0 * omega.real)
    return np.asarray(np.minimum(_FOLLOWED * np.min(apart, axis=1), _LARGEST_MOVE * np.abs(omega)))


def _newton(drives: Drives, start: ComplexArray, condition: Index) -> ComplexArray:
    """Return the zeros of the characteristic function next to ``start``; nan if one of them is not found."""
    three_times = np.tile(condition, 3)
    return zeros_near(lambda omega: np.asarray(characteristic(drives.parts(omega, three_times))), start)
