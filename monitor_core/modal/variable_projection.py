"""Minimise over poles and tone frequencies (Levenberg–Marquardt), with all linear parameters projected out."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.modal.model import FitLines, ModelOrder, Projection, poles_of, project

_MAXIMUM_ITERATIONS = 100
#: Predicted decrease of the cost, in units of the noise variance, below which a step is a hundredth of a standard
#: deviation long and no further step is worth taking.
_NEGLIGIBLE_GAIN = 1e-4
_DAMPING_LIMITS = (math.log(1e-5), math.log(0.7))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A local optimum of the likelihood."""

    order: ModelOrder
    parameters: FloatArray  # shape (n_nonlinear,): f [Hz], ln ζ of each mode, then tone frequencies [Hz]
    projection: Projection
    normal_matrix: FloatArray  # Re JᴴJ, shape (n_nonlinear, n_nonlinear)
    degrees_of_freedom: int  # real ones of the residual

    @property
    def noise_variance(self) -> float:
        """Variance of the complex noise of one whitened line."""
        return 2.0 * self.projection.cost / self.degrees_of_freedom

    @property
    def modes(self) -> FloatArray:
        """Natural frequency [Hz] and damping ratio [-] of each mode, shape (n_modes, 2)."""
        return poles_of(self.parameters, self.order)

    @property
    def tones(self) -> FloatArray:
        """Frequencies of the tones in hertz, shape (n_tones,)."""
        return self.parameters[2 * self.order.n_modes :]

    @property
    def bic(self) -> float:
        """Bayesian information criterion over the real data."""
        n_real = 2 * self.projection.residual.size
        n_parameters = self.order.n_parameters(self.projection.residual.shape[0])
        return n_real * math.log(self.projection.cost) + n_parameters * math.log(n_real)


def degrees_of_freedom(lines: FitLines, order: ModelOrder) -> int:
    """Return real data less real parameters, those of the ends of the windows included."""
    return 2 * lines.response.size - order.n_parameters(lines.n_windows) - 2 * lines.derivatives * lines.n_windows


def minimise(lines: FitLines, start: FloatArray, order: ModelOrder) -> Solution | None:
    """Find the local maximum of the likelihood near a start; ``None`` without convergence or with too little data."""
    dof = degrees_of_freedom(lines, order)
    if dof <= 0:
        return None
    try:
        return _descend(lines, start, order, dof)
    except np.linalg.LinAlgError:  # excitation without the dimensions that B needs, or two equal poles
        return None


def solution_at(lines: FitLines, parameters: FloatArray, order: ModelOrder) -> Solution:
    """Return what :func:`minimise` would, were its optimum at these parameters."""
    projection = project(lines, parameters, order)
    return Solution(order, parameters, projection, _normal_equations(projection)[0], degrees_of_freedom(lines, order))


def _descend(lines: FitLines, start: FloatArray, order: ModelOrder, dof: int) -> Solution | None:
    parameters = _clip(start, lines, order)
    current = project(lines, parameters, order)
    marquardt = 1e-3
    for _ in range(_MAXIMUM_ITERATIONS):
        normal, gradient = _normal_equations(current)
        newton_gain = float(gradient @ _solved(normal, gradient))
        if newton_gain <= _NEGLIGIBLE_GAIN * current.cost / dof:
            return Solution(order, parameters, current, normal, dof)
        damped = normal + marquardt * np.diag(normal.diagonal())
        step = -_solved(damped, gradient)
        trial_parameters = _clip(parameters + _limit(step, lines, order), lines, order)
        trial = project(lines, trial_parameters, order)
        if trial.cost < current.cost:
            parameters, current = trial_parameters, trial
            marquardt = max(marquardt / 10.0, 1e-9)
        elif marquardt > 1e9:
            # Rounding, not the slope, stops the descent of a nearly noise-free fit.
            return Solution(order, parameters, current, normal, dof) if newton_gain < 1e-6 * current.cost else None
        else:
            marquardt *= 10.0
    return None


def _normal_equations(projection: Projection) -> tuple[FloatArray, FloatArray]:
    jacobian = projection.jacobian.reshape(projection.jacobian.shape[0], -1)
    normal: FloatArray = (jacobian.conj() @ jacobian.T).real
    gradient: FloatArray = (jacobian.conj() @ projection.residual.ravel()).real
    return normal, gradient


def _solved(normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Solve normal equations: LAPACK's own, for what NumPy does around it takes longer at this size."""
    solution, info = scipy.linalg.lapack.dgesv(normal, gradient)[2:]
    if info:
        raise np.linalg.LinAlgError("the parameters are not independent")
    return np.asarray(solution)


def _limit(step: FloatArray, lines: FitLines, order: ModelOrder) -> FloatArray:
    """Keep a step within an eighth of the band and a factor e in damping; the model is far from linear beyond."""
    longest = np.full(step.size, (lines.frequency[-1] - lines.frequency[0]) / 8.0)
    longest[1 : 2 * order.n_modes : 2] = 1.0
    longest[2 * order.n_modes :] = lines.resolution
    return np.clip(step, -longest, longest)


def _clip(parameters: FloatArray, lines: FitLines, order: ModelOrder) -> FloatArray:
    """Keep poles within one band width of the band, and damping possible."""
    low, high = lines.frequency[0], lines.frequency[-1]
    clipped = parameters.copy()
    modes = slice(0, 2 * order.n_modes, 2)
    clipped[modes] = np.clip(clipped[modes], max(2.0 * low - high, 0.1 * low), 2.0 * high - low)
    dampings = slice(1, 2 * order.n_modes, 2)
    clipped[dampings] = np.clip(clipped[dampings], *_DAMPING_LIMITS)
    return clipped
