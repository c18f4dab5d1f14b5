r"""A response is known up to a factor: gain and phase of hammer or torque and of the accelerometer.

Measured is :math:`(1 + \epsilon + j\varphi) H` at all lines of a response H, with a gain :math:`\epsilon` and a phase
:math:`\varphi` of known standard deviations. With the lines over their noise as a vector h (calculated) and y
(measured), real and imaginary parts apart, the least χ² over both is that of the residuals

.. math::

    r = W (h - y), \qquad
    W = I - \left( 1 - \frac{1}{\sqrt{1 + s_\epsilon^2 |h|^2}} \right) \frac{h h^T}{|h|^2}
          - \left( 1 - \frac{1}{\sqrt{1 + s_\varphi^2 |h|^2}} \right) \frac{(jh) (jh)^T}{|h|^2}

since :math:`W^2 = (I + s_\epsilon^2 h h^T + s_\varphi^2 (jh) (jh)^T)^{-1}` is the inverse of the covariance of noise
and factor: as many residuals as lines, and no coordinate more (variable projection with priors; Golub & Pereyra,
Inverse Problems 19 (2003) R1). The factor goes with the calculated response. With the measured one its
noise would draw a fit down (Peelle's puzzle: D'Agostini, Nucl. Instrum. Methods A 346 (1994) 306).
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError


@dataclass(frozen=True, slots=True)
class FactorTolerance:
    """How well the factor of a response is known: standard deviations, of each response by itself.

    The defaults are those of a modal test that nobody calibrated on the day: hammers and accelerometers are sold with
    sensitivities known to 2 to 5 %, and turn phases by some degrees at the ends of their bands.
    """

    gain: float = 0.05  # relative [-]
    phase: float = 0.05  # [rad]

    def __post_init__(self) -> None:
        if not all(0.0 <= share < math.inf for share in (self.gain, self.phase)):
            raise OutsideValidityError(
                f"gain and phase must be known to a finite share and angle; got {self.gain} and {self.phase} rad"
            )


KNOWN_TO_5_PERCENT = FactorTolerance()
#: A response in absolute units: what a simulation gives.
EXACT = FactorTolerance(0.0, 0.0)


def best_factor(residuals: ComplexArray, along: ComplexArray, tolerance: FactorTolerance) -> complex:
    """Return the factor of a calculated response with which χ² and its own deviation from 1 are least together.

    ``residuals`` are calculated less measured lines over their noise and ``along`` the calculated ones, shape
    (n_lines,) both. [-].
    """
    share, square = _share(residuals, along)
    return 1.0 - complex(*(part * _taken(square, s) for part, s in _parts(share, tolerance)))


def without_factor(values: ComplexArray, along: ComplexArray, tolerance: FactorTolerance) -> ComplexArray:
    """Return W times values of shape (..., n_lines), whose lines move by ``along``, (n_lines,), with the factor."""
    share, square = _share(values, along)
    gain, phase = (part * (1.0 - math.sqrt(1.0 - _taken(square, s))) for part, s in _parts(share, tolerance))
    return np.asarray(values - (gain + 1j * phase)[..., None] * along)


def _share(values: ComplexArray, along: ComplexArray) -> tuple[ComplexArray, float]:
    """Return how much of ``along`` is in the values, of gain and j times phase, and its squared length."""
    square = float(np.vdot(along, along).real)
    return np.asarray(values @ along.conj() / max(square, 1e-300)), square


def _parts(share: ComplexArray, tolerance: FactorTolerance) -> tuple[tuple[FloatArray, float], ...]:
    return (share.real, tolerance.gain), (share.imag, tolerance.phase)


def _taken(square: float, tolerance: float) -> float:
    """Return which part of its share a factor of this tolerance takes up."""
    return tolerance**2 * square / (1.0 + tolerance**2 * square)
