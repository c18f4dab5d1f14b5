"""Find zeros: poles of a drive by Newton's method with the circles for their residues, and zeros within brackets.

The zeros of many functions of one variable are found at once, each between two places where its signs differ.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray

#: Distance of the two ends, relative to the one where the function is nearer to zero, at which a zero is found.
_TOLERANCE = 1e-15
#: As many as halve the widest interval of numbers until nothing is left of it.
_MOST_STEPS = int(math.log2(np.finfo(np.float64).max) - math.log2(np.finfo(np.float64).smallest_normal))


def zeros_between(
    function: Callable[[FloatArray, npt.NDArray[np.intp]], FloatArray],
    between: tuple[FloatArray, FloatArray],
    values: tuple[FloatArray, FloatArray],
    which: npt.NDArray[np.intp],
) -> FloatArray:
    """Return the zero between each low and high; nan where the signs there do not differ or the function is none.

    ``values`` are those of the function at low and high, which a caller that looked for changes of sign has already.

    Chandrupatla's method [1]_, with the arithmetic of ``scipy.optimize.elementwise.find_root``, whose numbers these
    are; that of SciPy takes longer for its own steps than a closed form for its values.

    The function takes places and what of ``which``, the number of the function in each interval, goes with them, and
    returns the values there. All arrays have the shape (n_zeros,).

    References
    ----------
    .. [1] T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function
       without using derivatives, Advances in Engineering Software 28 (1997) 145-149.
    """
    (x1, x2), (f1, f2) = between, values
    zeros = np.full(x1.size, np.nan)
    sought = np.arange(x1.size)
    x3, f3, share = x2, f2, np.full(x1.size, 0.5)
    for step in range(_MOST_STEPS + 1):
        nearer = np.abs(f1) < np.abs(f2)
        best = np.where(nearer, x1, x2)
        distance, tolerance = np.abs(x2 - x1), np.abs(best) * _TOLERANCE
        at_zero = np.where(nearer, f1, f2) == 0.0
        lost = (np.sign(f1) == np.sign(f2)) | (np.isnan(f1) & np.isnan(f2))
        done = at_zero | lost | (distance < tolerance)
        if step == _MOST_STEPS or done.all():
            zeros[sought] = np.where(lost & ~at_zero, np.nan, best)
            break
        if done.any():
            zeros[sought[done]] = np.where(lost & ~at_zero, np.nan, best)[done]
            running = ~done
            sought, which, distance, tolerance, share = (
                sought[running],
                which[running],
                distance[running],
                tolerance[running],
                share[running],
            )
            x1, x2, x3, f1, f2, f3 = x1[running], x2[running], x3[running], f1[running], f2[running], f3[running]
        if step:
            share = _share((x1, x2, x3), (f1, f2, f3))
            margin = 0.5 * tolerance / distance
            share = np.minimum(np.maximum(share, margin), 1.0 - margin)
        x = x1 + share * (x2 - x1)
        f = function(x, which)
        same = np.sign(f) == np.sign(f1)
        x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
        x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
        x1, f1 = x, f
    return zeros


def _share(places: Sequence[FloatArray], values: Sequence[FloatArray]) -> FloatArray:
    """Return how far to go from the first place to the second: by inverse parabola through all three, or halfway."""
    (x1, x2, x3), (f1, f2, f3) = places, values
    xi = (x1 - x2) / (x3 - x2)
    with np.errstate(divide="ignore", invalid="ignore"):
        phi = (f1 - f2) / (f3 - f2)
    alpha = (x3 - x1) / (x2 - x1)
    smooth = ((1.0 - np.sqrt(1.0 - xi)) < phi) & (phi < np.sqrt(xi))
    share = np.full(xi.size, 0.5)
    a, b, c = f1[smooth], f2[smooth], f3[smooth]
    share[smooth] = a / (a - b) * c / (c - b) - alpha[smooth] * a / (c - a) * b / (b - c)
    return share


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
