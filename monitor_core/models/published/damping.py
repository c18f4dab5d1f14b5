"""Compute springs that lose energy: complex stiffness, springs in series, the equivalent viscous damper.

A loss factor belongs to the frequency domain. With a complex stiffness the equations of motion have, besides the
decaying solution that oscillates with ω > 0, one with ω < 0 that grows: they must not be integrated in time.
"""

import cmath
import math

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError


def complex_stiffness(stiffness: float, loss_factor: float) -> complex:
    r"""Return the stiffness of a spring with hysteretic damping.

    .. math:: \hat k = k (1 + j \eta)

    Section 3 of Sun et al. (2022), for positive frequencies; k in N/m or N·m/rad. A joint that does not give, of
    infinite k, does not lose energy either.
    """
    return complex(math.inf, 0.0) if math.isinf(stiffness) else stiffness * complex(1.0, loss_factor)


def series_stiffness(*stiffnesses: complex) -> complex:
    r"""Return the stiffness of springs in series.

    .. math:: \hat k = \left[ \sum_i \frac{1}{\hat k_i} \right]^{-1} = k (1 + j \eta_e)

    Eqs. (5) and (14) of Sun et al. (2022). Infinite ones do not count; ``OutsideValidityError`` if one of them is zero,
    or none is finite: the chain would be open, or rigid.

    Examples
    --------
    Half of each of two equal springs, and a rigid bracket:

    >>> series_stiffness(complex_stiffness(2.0, 0.1), complex_stiffness(2.0, 0.1), complex_stiffness(math.inf, 0.1))
    (1+0.1j)
    """
    finite = [k for k in map(complex, stiffnesses) if cmath.isfinite(k)]
    if not finite or 0.0 in finite:
        raise OutsideValidityError(f"springs in series must not be zero, nor all of them infinite; got {stiffnesses}")
    return 1.0 / sum(1.0 / k for k in finite)


def effective_loss_factor(stiffness: complex) -> float:
    """Return η_e of k(1 + jη_e), Eq. (14) of Sun et al. (2022), without unit."""
    return stiffness.imag / stiffness.real


def equivalent_viscous_damping(stiffness: npt.ArrayLike, omega: float) -> FloatArray:
    r"""Return the viscous damping that loses as much energy in a cycle at one frequency.

    .. math:: c = \frac{\eta_e k}{\omega}

    from :math:`j \omega c = j \eta_e k`; for the time domain, in which a complex stiffness must not be used.

    ``stiffness``: k(1 + jη_e), one spring or a stiffness matrix. [N/m] or [N·m/rad], shape (...); ``omega``: where
    both are to be equal: the resonance [rad/s]. Returned: [N·s/m] or [N·m·s/rad], shape (...).
    ``OutsideValidityError`` if omega is not positive.

    Examples
    --------
    >>> float(equivalent_viscous_damping(100.0 + 4.0j, 2.0))
    2.0
    """
    if not (math.isfinite(omega) and omega > 0.0):
        raise OutsideValidityError(f"omega must be positive; got {omega} rad/s")
    return np.asarray(np.imag(np.asarray(stiffness, dtype=np.complex128)) / omega)
