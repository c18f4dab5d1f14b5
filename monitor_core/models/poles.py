"""Find the poles of a drive by Newton's method, and the circles around them on which residues are taken."""

import math
from collections.abc import Callable

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray

_NEWTON_STEPS = 30
#: Points on the circle around a pole; what the neighbours add falls with their power of the radius over the distance.
_CIRCLE = 16


def zeros_near(function: Callable[[ComplexArray], ComplexArray], start: ComplexArray) -> ComplexArray:
    """Return the zeros next to ``start`` [rad/s], by Newton's method on all at once; nan if one of them is not found.

    The function takes three times as many ω as there are zeros: at each, then a little above each, then below.
    """
    omega = start
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a step that is too long may lead anywhere
        for _ in range(_NEWTON_STEPS):
            h = 1e-6 * np.abs(omega)
            here, above, below = np.split(function(np.concatenate([omega, omega + h, omega - h])), 3)
            step = here * 2.0 * h / (above - below)
            omega = omega - step
            if np.all(np.abs(step) < 1e-11 * np.abs(omega)):
                return omega
    return np.full_like(omega, np.nan)


def circles_around(omega: FloatArray) -> ComplexArray:
    """Return offsets from natural frequencies to points on circles around them, shape (n_modes, n_points) [rad/s].

    No circle reaches a neighbour: on it nothing is divided by nearly zero, whether the mode moves the nut or not.
    """
    apart = np.diff(np.r_[0.0, omega, 2.0 * omega[-1:]])
    radius = np.minimum(0.1 * np.minimum(apart[:-1], apart[1:]), 1e-3 * omega)
    return np.asarray(radius[:, None] * np.exp(2j * math.pi * np.arange(_CIRCLE) / _CIRCLE))
