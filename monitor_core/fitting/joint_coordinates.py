r"""The joints of an axis as coordinates of a fit: decimal logarithms of those that are free.

Stiffness and damping are positive and known beforehand to decades at best, so a fit moves
:math:`\log_{10}` of them: bounds are decades, steps are factors, and a standard uncertainty *u* of a coordinate is one
of :math:`u \ln 10`, relative, of the parameter.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.problem import Bounds
from monitor_core.models.protocol import DriveConditions
from monitor_core.models.published.receptance.parameters import JOINT_NAMES, JointParameters, ReceptanceParameters


@dataclass(frozen=True, slots=True)
class JointCoordinates:
    """Which joints are free, and the axis that states all else."""

    axis: ReceptanceParameters
    free: tuple[str, ...] = JOINT_NAMES  # of JOINT_NAMES, in their order

    def __post_init__(self) -> None:
        if not self.free or list(self.free) != [name for name in JOINT_NAMES if name in self.free]:
            raise OutsideValidityError(
                f"free joints must be some of {', '.join(JOINT_NAMES)}, in this order; got {', '.join(self.free)}"
            )

    @property
    def rows(self) -> list[int]:
        """Place of each free joint in ``JOINT_NAMES``, the rows of a gradient."""
        return [JOINT_NAMES.index(name) for name in self.free]

    def parameters(self, coordinates: FloatArray) -> ReceptanceParameters:
        """Return the axis with its free joints at the coordinates, shape (n_parameters,)."""
        if np.shape(coordinates) != (len(self.free),):
            raise OutsideValidityError(
                f"coordinates must have shape ({len(self.free)},), one per free joint; got {np.shape(coordinates)}"
            )
        values = {name: 10.0 ** float(x) for name, x in zip(self.free, coordinates, strict=True)}
        return replace(self.axis, **values)

    def coordinates(self, parameters: ReceptanceParameters) -> FloatArray:
        """Return the coordinates of an axis, shape (n_parameters,).

        Raises
        ------
        OutsideValidityError
            If a free joint is zero: it has no logarithm.
        """
        values = np.array([getattr(parameters, name) for name in self.free], dtype=np.float64)
        for name, value in zip(self.free, values, strict=True):
            if not value > 0.0:
                raise OutsideValidityError(f"{name} must be positive to be free in a fit; got {value}")
        return np.asarray(np.log10(values))

    def bounds(self, limits: Mapping[str, tuple[float, float]]) -> Bounds:
        """Return the bounds of the coordinates from lower and upper limits of each free joint, in SI units."""
        missing = [name for name in self.free if name not in limits]
        if missing:
            raise OutsideValidityError(f"a free joint needs a lower and an upper limit; {missing[0]} has none")
        both = np.log10([limits[name] for name in self.free])
        return Bounds(both[:, 0], both[:, 1])

    def slopes(self, joints: JointParameters) -> FloatArray:
        """Return d joint/d coordinate, shape (n_parameters,).

        A nut whose rigidity follows the preload is proportional to its catalogue value, so its slope is taken from the
        rigidity under the conditions, which ``joints`` holds.
        """
        return np.array([math.log(10.0) * getattr(joints, name) for name in self.free])

    def joints(self, coordinates: FloatArray, conditions: DriveConditions) -> JointParameters:
        """Return the joints at the coordinates under the conditions."""
        return self.parameters(coordinates).joints(conditions)
