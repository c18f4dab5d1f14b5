"""Principal directions of what a fit does not see, and the verdict on each."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.solver.least_squares import LocalFit

#: Part of the largest movement along a direction from which on a coordinate belongs to it.
_BELONGS = 0.3


class Verdict(StrEnum):
    """How well the data determine something."""

    DETERMINED = "determined"
    POORLY_DETERMINED = "poorly determined"
    NOT_DETERMINED = "not determined"


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Between the verdicts, in the unit of the coordinates; the defaults are meant for decimal logarithms."""

    determined: float = 0.03  #: standard uncertainty up to which: 7 %, the 95 % interval within 15 % either way
    not_determined: float = 0.15  #: … from which on not: the 95 % interval is a factor of two either way
    inseparable: float = 0.9  #: absolute correlation from which on two coordinates are not told apart [-]

    def verdict(self, standard_uncertainty: float) -> Verdict:
        """Return the verdict on a standard uncertainty."""
        if standard_uncertainty <= self.determined:
            return Verdict.DETERMINED
        return Verdict.POORLY_DETERMINED if standard_uncertainty < self.not_determined else Verdict.NOT_DETERMINED


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """A direction in the coordinates, and how far the data let one move along it."""

    names: tuple[str, ...]  # of all coordinates
    movement: FloatArray  # of each coordinate while χ² rises by one residual variance, shape (n_parameters,)
    beyond_bounds: bool  # χ² would rise by less over the whole width of the bounds, where the movement is cut off
    verdict: Verdict  # on the coordinate that moves most

    def __post_init__(self) -> None:
        object.__setattr__(self, "movement", read_only(self.movement))

    @property
    def members(self) -> tuple[str, ...]:
        """Coordinates that take part, the one that moves most first."""
        order = np.argsort(-np.abs(self.movement))
        least = _BELONGS * np.max(np.abs(self.movement))
        return tuple(self.names[i] for i in order if abs(self.movement[i]) >= least)

    @property
    def factors(self) -> dict[str, float]:
        """By what each member is multiplied, where the coordinates are decimal logarithms. [-]."""
        return {name: float(10.0 ** self.movement[self.names.index(name)]) for name in self.members}

    def describe(self) -> str:
        """Say which coordinates it is: ``k_al against k_ar``, ``c_n alone``."""
        first, *others = self.members
        if not others:
            return f"{first} alone"
        sign = math.copysign(1.0, self.movement[self.names.index(first)])
        against = [name for name in others if sign * self.movement[self.names.index(name)] < 0.0]
        together = " with ".join([first, *(name for name in others if name not in against)])
        return f"{together} against {' and '.join(against)}" if against else together


def directions(fit: LocalFit, bounds: Bounds, thresholds: Thresholds) -> tuple[Direction, ...]:
    r"""Return the principal directions of what is unknown, least seen first.

    Singular vectors of :math:`J\,\mathrm{diag}(w)` with the widths w of the bounds (or the value, where they are
    infinite), so that coordinates of different units can be compared. Along the vector v with singular value
    :math:`\lambda` a movement of :math:`s\,w v/\lambda` raises χ² by one residual variance s².
    """
    values = fit.coordinates.values
    width = bounds.upper - bounds.lower
    width = np.where(np.isfinite(width), width, np.maximum(np.abs(values), 1.0))
    _, singular, vectors = np.linalg.svd(fit.jacobian * width, full_matrices=False)
    found = []
    for strength, vector in zip(singular[::-1], vectors[::-1], strict=True):
        farthest = 1.0 / float(np.max(np.abs(vector)))  # one coordinate then crosses its whole width
        reach = math.sqrt(fit.residual_variance) / max(float(strength), 1e-300)
        movement = min(reach, farthest) * vector * width
        if movement[np.argmax(np.abs(movement))] < 0.0:
            movement = -movement
        verdict = thresholds.verdict(float(np.max(np.abs(movement))))
        found.append(Direction(fit.names, movement, reach > farthest, verdict))
    return tuple(found)
