"""A rod by its dynamic stiffness: another way to what the models compute by receptances."""

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.rod import Wave, rod_waves


def rod_dynamic_stiffness(rigidity: float, wave_number: Wave, length: float) -> ComplexArray:
    r"""Return the dynamic stiffness of a rod, the inverse of its receptance.

    .. math::

        \mathbf D = z \begin{bmatrix} \cot\lambda l & -\csc\lambda l \\ -\csc\lambda l & \cot\lambda l \end{bmatrix}

    Returned: between the near end and the far end. [N/m] or [N·m/rad], shape (n_frequencies, 2, 2).
    """
    waves = rod_waves(rigidity, wave_number, length)
    diagonal, off_diagonal = waves.cosine / waves.sine_over_z, -1.0 / waves.sine_over_z
    return np.moveaxis(np.array([[diagonal, off_diagonal], [off_diagonal, diagonal]]), (0, 1), (-2, -1))


def condensed_stiffness(
    rigidity: float, wave_number: Wave, length: float, end_stiffness: FloatArray | ComplexArray
) -> ComplexArray:
    r"""Return the dynamic stiffness felt at one end of a rod whose other end is held by a dynamic stiffness k.

    .. math::

        D = z \, \frac{k \cos\lambda l - z \sin\lambda l}{z \cos\lambda l + k \sin\lambda l}

    The wave equation with the end's condition put in; a free end has k = 0.

    ``rigidity``, ``wave_number``, ``length``: as for all functions; ``end_stiffness``: k(ω): spring, damper and
    mass at the other end together. [N/m] or [N·m/rad], shape (n_frequencies,). Returned: [N/m] or [N·m/rad], shape
    (n_frequencies,).

    Examples
    --------
    Slowly, a bar of E S/l = 2 N/m behind a spring of 2 N/m is a spring of 1 N/m:

    >>> condensed_stiffness(2.0, np.array([1e-6]), 1.0, np.array(2.0)).round(9).item()
    (1+0j)
    """
    waves = rod_waves(rigidity, wave_number, length)
    quotient = (end_stiffness * waves.cosine - waves.z_sine) / (waves.cosine + end_stiffness * waves.sine_over_z)
    return np.asarray(quotient, dtype=np.complex128)
