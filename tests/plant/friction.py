"""Rolling friction: Dahl bristles with viscous drag, advanced exactly over a step of constant velocity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction of the axis, without the part that depends on the preload."""

    guide_force: float = 6.0  # Coulomb friction of the rail guides with their seals [N]
    bearing_torque: float = 0.02  # Coulomb friction of the fixed bearing [N·m]
    guide_presliding: float = 25e-6  # deflection at which sliding sets in [m]
    screw_presliding: float = 2e-2  # the same for nut and bearing: 19 µm of travel [rad]
    guide_viscosity: float = 20.0  # [N·s/m]
    screw_viscosity: float = 1e-4  # of nut and bearing, each [N·m·s/rad]


def advance_bristles(deflection: FloatArray, velocity: FloatArray, presliding: FloatArray, step: float) -> FloatArray:
    """Return the bristle deflection after one step.

    Dahl: dz/dt = v - |v| z / z_s, whose solution at constant v is an exponential towards ±z_s. Being exact, it neither
    chatters nor becomes unstable, however far the axis travels in a step.
    """
    limit = np.copysign(presliding, velocity)
    approach: FloatArray = np.exp(-np.abs(velocity) * (step / presliding))
    return limit + (deflection - limit) * approach
