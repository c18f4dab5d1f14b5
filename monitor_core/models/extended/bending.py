r"""How a screw that bends gives way to the force in the nut, along the screw.

Where the nut pulls out of line, its force bends the screw, and the screw turns and moves across where the nut sits: the
nut gives way along the screw. Between two supports a uniform screw of length L has natural frequencies that rise with
n², and a mode moves the nut by its slope, of n half waves. To the force in the nut that is a compliance in series,

.. math::

    Y(\omega, x) = c \sum_n s_n \frac{\cos^2(n \pi x/L)}{1 - r_n^2 + 2j\zeta r_n}, \qquad
    r_n = \frac{\omega}{n^2 \omega_1}, \qquad s_1 = 1

whose real power is never negative with any c, ζ and shares :math:`s_n` that are not, so that it is positive real. Of a
moment the shares are 1/n², to which the length of the nut, what stands across and how the ends are held add their own;
so each is a number of its own. (Euler and Bernoulli's beam; Blevins, Formulas for Natural Frequency and Mode Shape,
table 8-1.)
"""

from collections.abc import Iterator

import numpy as np

from monitor_core.arrays import FloatArray, NumberArray, acts
from monitor_core.models.extended.physics import ScrewBending


def yielding(
    bending: ScrewBending, omega: NumberArray, along: FloatArray, softening: FloatArray
) -> tuple[NumberArray, NumberArray]:
    """Return d and y without poles, of which Y is y/d.

    Parameters
    ----------
    bending : ScrewBending
    omega : ndarray, shape (n_lines,)
        [rad/s]
    along : ndarray, shape (n_lines,)
        Position of the nut over the length of the screw. [-]
    softening : ndarray, shape (n_lines,) or ()
        Stiffness of the screw over what it is at the reference temperature. [-]
    """
    d: NumberArray = np.ones_like(omega)
    y: NumberArray = np.zeros_like(omega)
    for number, stiffness in stiffnesses(bending, omega, softening):
        share = bending.shares[number - 1]
        y = y * stiffness + bending.compliance * share * np.cos(number * np.pi * along) ** 2 * d
        d = d * stiffness
    return d, y


def stiffnesses(bending: ScrewBending, omega: NumberArray, softening: FloatArray) -> Iterator[tuple[int, NumberArray]]:
    """Yield the number of each mode that takes part and its dynamic stiffness over the static one, (n_lines,)."""
    for number, share in enumerate(bending.shares, 1):
        if not acts(share):
            continue
        ratio = omega / (2.0 * np.pi * number**2 * bending.frequency)
        damper = 2j * bending.damping_ratio * ratio if acts(bending.damping_ratio) else 0.0
        yield number, softening - ratio * ratio + damper
