"""Scaled linear algebra of a fit: bounded steps, the directions of its Jacobian, and its covariance."""

import numpy as np
from scipy.optimize import lsq_linear

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError

#: Relative singular value of the column-scaled Jacobian below which nothing is known along a direction. The variance
#: there is finite, so that it drops out of what does not depend on it, and is larger than any that is of use.
_UNSEEN = 1e-10


def bounded_step(
    jacobian: FloatArray, residuals: FloatArray, lowest: FloatArray, highest: FloatArray
) -> tuple[FloatArray, float]:
    """Return the step within bounds that minimises |r + J s|², and by how much it would fall."""
    scale = _column_scale(jacobian)
    p = scale.size
    # So little damping moves no determined direction; without it an unseen one runs to a bound for nothing.
    damped = np.vstack([jacobian / scale, 1e-8 * np.eye(p)])
    target = np.concatenate([-residuals, np.zeros(p)])
    step = lsq_linear(damped, target, (lowest * scale, highest * scale), method="bvls").x / scale
    left = residuals + jacobian @ step
    return step, max(float(residuals @ residuals - left @ left), 0.0)


def _column_scale(jacobian: FloatArray) -> FloatArray:
    """Return the lengths of the columns, those without influence as the least length that counts; shape (p,)."""
    length: FloatArray = np.linalg.norm(jacobian, axis=0)
    if not (length > 0.0).any():
        raise NotIdentifiableError("the objective is flat: no coordinate moves any residual")
    at_least: FloatArray = np.maximum(length, _UNSEEN * length.max())
    return at_least


def scaled_directions(jacobian: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return column scale, singular values and, as rows, directions of the column-scaled Jacobian."""
    scale = _column_scale(jacobian)
    _, singular, directions = np.linalg.svd(jacobian / scale, full_matrices=False)
    return scale, np.maximum(singular, _UNSEEN * singular[0]), directions


def inverse_information(jacobian: FloatArray) -> FloatArray:
    """Return (JᵀJ)⁻¹ from the singular values, shape (n_parameters, n_parameters)."""
    scale, singular, directions = scaled_directions(jacobian)
    half = directions.T / singular / scale[:, np.newaxis]
    covariance: FloatArray = half @ half.T
    return covariance
