"""Find zeros by their number where they can be counted, and poles by Newton's method with circles for their residues.

Those of many functions of one variable are found at once.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray

#: Relative distance on both sides of a zero at which it is counted.
_AROUND = 1e-10
#: A step of Newton's method from whose end the next would be lost in rounding; relative.
_LAST_STEP = 1e-8
#: The step before the last was so much longer, or the zero is a pair to Newton's method, and where it lies is counted.
_MUCH_LONGER = 1e3
#: Relative width of an interval in which nothing is left to be found.
_ROUNDING = 4e-16
#: Steps by Newton's method; what is not found by then is found by halving, until nothing is left of the interval.
_MOST_NEWTON_STEPS, _MOST_STEPS = 40, 120

Numbers = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class NumberedZeros:
    """Zeros that are sought by their numbers; each array has the shape (n_zeros,)."""

    which: Numbers  # number of the function that has the zero
    number: Numbers  # how many zeros of it are no higher
    low: FloatArray  # a place with fewer zeros below
    high: FloatArray  # a place with at least as many below

    def at(self, chosen: Numbers) -> "NumberedZeros":
        """Return some of them."""
        return NumberedZeros(self.which[chosen], self.number[chosen], self.low[chosen], self.high[chosen])

    def bound(self, chosen: Numbers, low: FloatArray, high: FloatArray) -> None:
        """Narrow the bounds of some of them; nan where there is none."""
        self.low[chosen], self.high[chosen] = np.fmax(self.low[chosen], low), np.fmin(self.high[chosen], high)


def numbered_zeros(
    look: Callable[[FloatArray, Numbers], tuple[Numbers, FloatArray]],
    count: Callable[[FloatArray, Numbers], Numbers],
    zeros: NumberedZeros,
    start: FloatArray,
) -> FloatArray:
    """Return the zeros of functions whose zeros can be counted, wherever the search starts; shape (n_zeros,).

    Newton's method leads from ``start`` to a zero; the count where its last step began, or where that is not sure those
    on both sides of the zero, tell whether it is the one that is sought. Until it is, all places that were looked at
    bound the interval in which that one lies, and the search goes on from the middle of it where no step leads to it.
    So a zero is followed where it is near, and found where it is not.

    ``look`` takes places and what of ``which`` goes with them, and returns how many zeros lie below and f/f' there;
    ``count`` is the same without f/f'.
    """
    place, moved = start.copy(), np.full(start.size, np.inf)
    found = np.zeros(start.size, dtype=np.bool_)
    for step in range(_MOST_STEPS):
        going = np.flatnonzero(~(moved <= _LAST_STEP * place))
        if not going.size:  # all are where a step ended that was short
            left = np.flatnonzero(~found)
            around = np.concatenate([place[left] * (1.0 - _AROUND), place[left] * (1.0 + _AROUND)])
            counts = count(around, np.tile(zeros.which[left], 2))
            before, behind = np.split(counts >= np.tile(zeros.number[left], 2), 2)
            found[left] = behind & ~before
            if found.all():
                break
            zeros.bound(left, np.where(behind, np.nan, place[left]), np.where(before, place[left], np.nan))
            going = left[before | ~behind]
            place[going] = np.nan
        some = zeros.at(going)
        inside = (some.low < place[going]) & (place[going] < some.high)
        here = np.where(inside, place[going], 0.5 * (some.low + some.high))
        if step < _MOST_NEWTON_STEPS:
            before = np.where(np.isinf(moved[going]), _LAST_STEP * here, moved[going])
            (low, high), place[going], moved[going], sure = _stepped(some, here, *look(here, some.which))
            short = moved[going] <= np.minimum(_LAST_STEP * place[going], before / _MUCH_LONGER)
            found[going] = sure & short
        else:
            passed = count(here, some.which) >= some.number
            low, high = np.where(passed, np.nan, here), np.where(passed, here, np.nan)
            place[going], moved[going] = np.nan, np.inf
        zeros.bound(going, low, high)
        narrow = going[zeros.high[going] - zeros.low[going] <= _ROUNDING * zeros.high[going]]
        place[narrow], moved[narrow], found[narrow] = zeros.high[narrow], 0.0, True
        if found.all():
            break
    return place


def _stepped(
    zeros: NumberedZeros, place: FloatArray, below: Numbers, newton: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return the places next to each zero, where a step to it ends, how long that is, and whether that leads there.

    What there is not is not a number.

    A step forward leads to the zero behind those that lie below, one backward to the last of these: that from the
    place of a zero itself, or that from the place next to it, of another one.
    """
    leads_to, ends, lengths = np.where(newton > 0.0, below, below + 1), place - newton, np.abs(newton)
    own = (leads_to == zeros.number) | (lengths <= _AROUND * place)
    if np.all(own & (zeros.low <= ends) & (ends <= zeros.high)):  # as where each is followed from near by
        beyond = below >= zeros.number
        low_and_high = np.stack([np.where(beyond, np.nan, place), np.where(beyond, place, np.nan)])
        return low_and_high, ends, lengths, leads_to == zeros.number
    order = np.lexsort((place, zeros.which))
    most = int(max(np.max(below), np.max(zeros.number))) + 2
    passed = np.maximum.accumulate((zeros.which * most + below)[order])
    behind = np.searchsorted(passed, zeros.which * most + zeros.number)
    none = np.stack([behind < 1, behind == place.size])
    neighbours = order[np.where(none, 0, np.stack([behind - 1, behind]))]
    none |= zeros.which[neighbours] != zeros.which
    low, high = np.where(none, np.nan, place[neighbours])
    sources = np.concatenate([np.arange(place.size)[None], neighbours])
    right = (leads_to[sources] == zeros.number) & (zeros.which[sources] == zeros.which)
    right[0] |= own
    ends, lengths = ends[sources], lengths[sources]
    right &= (np.fmax(zeros.low, low) <= ends) & (ends <= np.fmin(zeros.high, high))
    first = np.argmax(right, axis=0)[None]
    found = np.any(right, axis=0)
    return (
        np.stack([low, high]),
        np.where(found, np.take_along_axis(ends, first, axis=0)[0], np.nan),
        np.where(found, np.take_along_axis(lengths, first, axis=0)[0], np.inf),
        found & (first[0] == 0) & (leads_to == zeros.number),
    )


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
