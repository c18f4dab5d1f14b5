r"""Project out of residuals what the coordinates of a fit can take up linearly.

With Q an orthonormal basis of the derivatives and priors of a fit, of residuals r the part :math:`(I - Q Q^T) r` is
left after a linear refit.
"""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.priors import prior_jacobian, prior_residuals
from monitor_core.fitting.solver.hypothesis_fit import Fitted


class Projection:
    """Project out of residuals what the coordinates of a fit can take up; those of one effect may be left out."""

    def __init__(self, fitted: Fitted[Physics], without: Effect[Physics] | None = None) -> None:
        self._chosen = fitted.fitted
        self.n_coordinates = fitted.hypothesis.n_coordinates
        left_out = None if without is None else without.key
        unknowns = [effect.key != left_out for effect, _ in fitted.hypothesis.unknowns]
        kept = np.array([True] * fitted.hypothesis.n_uncertain + unknowns, dtype=np.bool_)
        priors = fitted.hypothesis.priors
        self._prior_residuals = prior_residuals(priors, fitted.coordinates)
        stacked = np.vstack([fitted.jacobian[self._chosen], prior_jacobian(priors)]) * kept
        left, singular, right = np.linalg.svd(stacked, full_matrices=False)
        seen = singular > 1e-9 * np.max(singular, initial=0.0)
        self._basis = left[:, seen]
        self._to_coordinates = right[seen].T / singular[seen]

    def residuals(self, standardised: FloatArray) -> FloatArray:
        """Return what the coordinates cannot take up, of residuals of all values; shape (n_fitted + n_priors,)."""
        return self._left(np.concatenate([standardised[self._chosen], self._prior_residuals]))

    def direction(self, derivative_of_all: FloatArray) -> FloatArray:
        """Return what is left of a derivative of all values."""
        return self._left(np.concatenate([derivative_of_all[self._chosen], np.zeros_like(self._prior_residuals)]))

    def step(self, standardised: FloatArray) -> FloatArray:
        """Return the move of the coordinates that takes up what they can, shape (n_coordinates,)."""
        rows = np.concatenate([standardised[self._chosen], self._prior_residuals])
        return np.asarray(-self._to_coordinates @ (self._basis.T @ rows))

    def freed(self, index: int) -> tuple[float, float]:
        """Return the decrease of χ² without the prior of an uncertain parameter, and the decrease per deviation of it.

        A row of residual u and leverage h leaves a linear least-squares problem with u²/(1 − h) less; and a parameter
        one deviation off its prior has u = 1 − h.
        """
        row = self._basis[self._basis.shape[0] - self._prior_residuals.size + index]
        rest = max(1.0 - float(row @ row), 1e-12)
        return float(self._prior_residuals[index]) ** 2 / rest, rest

    def _left(self, values: FloatArray) -> FloatArray:
        return values - self._basis @ (self._basis.T @ values)
