"""Compute a uniform rod in axial or torsional vibration: rigidity, wave number, receptance.

Axial and torsional waves obey one equation. Axially the rigidity is E S and the wave runs on E; in torsion it is G J
and the wave runs on G. All functions also take complex ω, so that poles can be sought with them.

The rods are described by their rigidity, E S [N] or G J [N·m²], their wave number, shape (n_frequencies,), not zero
[rad/m], and their length [m].
"""

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray

#: Real on the frequency axis, complex away from it.
Wave = TypeVar("Wave", FloatArray, ComplexArray)


@dataclass(frozen=True, slots=True, eq=False)
class RodWaves(Generic[Wave]):
    r"""The three functions of ω from which every response of a rod follows; none of them has a pole.

    With :math:`z` the rigidity times the wave number; they obey cos² + (sin/z)(z sin) = 1.
    """

    cosine: Wave  # cos λl, shape (n_frequencies,) [-]
    sine_over_z: Wave  # sin λl / z: [m/N] or [rad/(N·m)]
    z_sine: Wave  # z sin λl: [N/m] or [N·m/rad]


def axial_rigidity(modulus: float, diameter: float) -> float:
    """Return E S of a round bar in newtons; with its density in place of E, its mass per length in kg/m."""
    return modulus * math.pi * diameter**2 / 4.0


def torsional_rigidity(modulus: float, diameter: float) -> float:
    """Return G J, J = πd⁴/32, of a round bar in N·m²; with its density in place of G, its inertia per length."""
    return modulus * math.pi * diameter**4 / 32.0


def wave_number(omega: Wave, modulus: float, density: float) -> Wave:
    r"""Return the wave number of a rod in radians per metre, at ω in rad/s, shape (n_frequencies,).

    .. math:: \lambda = \omega \sqrt{\rho/E}

    Eq. (3) of Tian et al.; the modulus [Pa] is E for axial waves, G for torsional ones, the density in kg/m³. The paper
    states λ for axial waves only and uses the symbol in its torsional Eqs. (10)-(11) too; there it must run on G, see
    docs/reference/errata.md.
    """
    return omega * float(np.sqrt(density / modulus))


def rod_waves(rigidity: float, wave_number: Wave, length: float) -> RodWaves[Wave]:
    """Return the trigonometry of a rod, all that a closed form needs to know of it."""
    z = rigidity * wave_number
    sine = np.sin(wave_number * length)
    return RodWaves(np.cos(wave_number * length), sine / z, z * sine)


def rod_receptance(rigidity: float, wave_number: Wave, length: float) -> ComplexArray:
    r"""Return the receptance of a rod with free ends.

    .. math::

        \mathbf H = \frac{1}{z} \begin{bmatrix} -\cot\lambda l & -\csc\lambda l \\ -\csc\lambda l & -\cot\lambda l
        \end{bmatrix}, \qquad z = E S \lambda \text{ or } G J \lambda

    Eqs. (1), (2), (10) and (11) of Tian et al.

    Returned: between the near end and the far end. [m/N] or [rad/(N·m)], shape (n_frequencies, 2, 2).

    Notes
    -----
    Eqs. (1) and (2) print −cos where −cot is right, see docs/reference/errata.md.
    """
    waves = rod_waves(rigidity, wave_number, length)
    return _symmetric(-waves.cosine / waves.z_sine, -1.0 / waves.z_sine)


def _symmetric(diagonal: FloatArray | ComplexArray, off_diagonal: FloatArray | ComplexArray) -> ComplexArray:
    """Return a stack of symmetric 2 × 2 matrices with equal diagonal, shape (..., 2, 2)."""
    matrix = np.empty((*np.shape(diagonal), 2, 2), dtype=np.complex128)
    matrix[..., 0, 0] = matrix[..., 1, 1] = diagonal
    matrix[..., 0, 1] = matrix[..., 1, 0] = off_diagonal
    return matrix
