r"""Find the antiresonance of a collocated response: the zero of B that lies nearest to the real frequencies.

Of a torque on the motor and its own angle it is the natural frequency of table, nut and screw **with the motor held**
(a driving-point antiresonance: Ewins, Modal Testing, 2nd ed., section 2.5). Inertia of the motor, friction torque and
torque constant are not in it. The zero z of the fitted B moves with its coefficients b at the poles :math:`\theta`,
and with these,

.. math:: \mathrm{var}(z) = \frac{\sigma^2\,v^H G^{-1} v}{|B'(z)|^2}
    + \frac{\partial z}{\partial\theta}\,C_\theta\,\frac{\partial z}{\partial\theta}^T,
    \qquad v_j = z^j

with the Gram matrix G of the terms of B (first order; the two parts of a separable least-squares problem).
"""

import math

import numpy as np

from monitor_core.arrays import ComplexArray
from monitor_core.modal.model import FitLines, normalised_frequency, response_coefficients
from monitor_core.modal.refine import ModeFit, formal_covariance
from monitor_core.spectral import BandSpectra
from monitor_core.uncertainty import Estimate

_STEP = 1e-6  # of a pole, relative
#: A zero damped by more than this is no antiresonance [-].
_MOST_DAMPED = 0.3


def antiresonance_of(fit: ModeFit, spectra: BandSpectra) -> Estimate | None:
    """Return the antiresonance that a fit shows [Hz], or ``None`` where it has none in its band.

    The spectra are those of the windows that were fitted.
    """
    lines = FitLines.of(spectra, *fit.band, fit.weight)
    solution = fit.solution
    coefficients, inverse = response_coefficients(lines, solution.parameters, solution.order)
    near = _zeros(coefficients, lines)
    if not near.size:
        return None
    zero = near[np.argmin(np.abs(near.imag))]
    at = normalised_frequency(zero.real, lines.frequency) + 1j * zero.imag / _half_width(lines)
    powers = at ** np.arange(coefficients.size)
    slope = np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyder(coefficients))
    variance = 0.5 * solution.noise_variance * float((powers.conj() @ inverse.T @ powers).real) / abs(slope) ** 2
    gradient = np.empty(solution.parameters.size)
    for k, value in enumerate(solution.parameters):
        moved = solution.parameters.copy()
        moved[k] += _STEP * abs(value)
        zeros = _zeros(response_coefficients(lines, moved, solution.order)[0], lines)
        gradient[k] = (abs(zeros[np.argmin(np.abs(zeros - zero))]) - abs(zero)) / (_STEP * abs(value))
    gradient[1 : 2 * solution.order.n_modes : 2] /= solution.modes[:, 1]  # by ln ζ there, of ζ in the covariance
    variance = variance * _half_width(lines) ** 2 + float(gradient @ formal_covariance(solution) @ gradient)
    return Estimate(abs(complex(zero)), math.sqrt(variance), float(solution.degrees_of_freedom))


def _half_width(lines: FitLines) -> float:
    return 0.5 * float(lines.frequency[-1] - lines.frequency[0])


def _zeros(coefficients: ComplexArray, lines: FitLines) -> ComplexArray:
    """Return the zeros of B near the lines, in hertz, shape (n_zeros,)."""
    low, high = float(lines.frequency[0]), float(lines.frequency[-1])
    roots: ComplexArray = 0.5 * (low + high) + _half_width(lines) * np.polynomial.polynomial.polyroots(coefficients)
    inside = (roots.real > low) & (roots.real < high) & (np.abs(roots.imag) < _MOST_DAMPED * np.abs(roots))
    return roots[inside]
