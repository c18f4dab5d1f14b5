"""Compute the covariance of fitted poles, from the residual noise and from the scatter between windows."""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.modal.variable_projection import Solution


def formal_covariance(solution: Solution) -> FloatArray:
    r"""Return :math:`\tfrac12\sigma^2(\mathrm{Re}\,J^H J)^{-1}`, right if the whitened noise is white.

    Of natural frequency [Hz] and damping ratio [-] of each mode, and of the tone frequencies [Hz].
    """
    covariance: FloatArray = 0.5 * solution.noise_variance * _inverse(solution)
    return covariance


def between_window_covariance(solution: Solution) -> FloatArray | None:
    r"""Return the covariance that the scatter of the windows' pulls implies (sandwich).

    .. math:: N^{-1}\Bigl(\tfrac{n}{n-1}\sum_s g_s g_s^T\Bigr) N^{-1},\qquad
        N = \mathrm{Re}\,J^H J,\quad g_s = \mathrm{Re}\,J_s^H R_s

    It needs no law of the noise, only that one window's does not know the other's. ``None`` for one window; else in the
    order of :func:`formal_covariance`.
    """
    pulls = _pulls(solution)
    n_windows = pulls.shape[1]
    if n_windows < 2:
        return None
    inverse = _inverse(solution)
    covariance: FloatArray = inverse @ (pulls @ pulls.T) @ inverse * n_windows / (n_windows - 1)
    return covariance


def _pulls(solution: Solution) -> FloatArray:
    """Return the gradient that each window contributes, shape (n_nonlinear, n_windows)."""
    projection = solution.projection
    pulls: FloatArray = np.einsum("pwf,wf->pw", projection.jacobian.conj(), projection.residual).real
    return pulls / _to_ratio(solution)[:, None]


def _inverse(solution: Solution) -> FloatArray:
    to_ratio = _to_ratio(solution)
    inverse: FloatArray = np.linalg.inv(solution.normal_matrix) * np.outer(to_ratio, to_ratio)
    return inverse


def _to_ratio(solution: Solution) -> FloatArray:
    """Return dζ/d ln ζ = ζ at the places of the damping parameters, 1 elsewhere."""
    to_ratio = np.ones(solution.order.n_nonlinear)
    to_ratio[1 : 2 * solution.order.n_modes : 2] = solution.modes[:, 1]
    return to_ratio
