"""The noise of a fit: partly white, partly shaped by the mode itself."""

import numpy as np
import scipy.optimize

from monitor_core.arrays import FloatArray
from monitor_core.modal.model import FitLines, pole_factor
from monitor_core.modal.variable_projection import Solution

_ITERATIONS = 4
#: Least share of the mean level: a line must not count for more than a thousand average ones.
_FLOOR = 1e-3


def noise_weight(lines: FitLines, solution: Solution) -> FloatArray:
    r"""Return one over the standard deviation of the noise at each line, up to a common factor.

    .. math:: \sigma^2(f) = \sigma_0^2 + \sum_i \sigma_i^2\, \frac{\min |A_i|^2}{|A_i(f)|^2}

    The first part is the accelerometer's. The others are forces that nobody measures, such as friction: they reach the
    sensor through the mode, so their noise has its shape; on an axis with friction they are nearly all of it. Fitted to
    the residual's mean power over windows, whose standard deviation is proportional to itself (maximum likelihood of
    the gamma distribution by repeated non-negative least squares).

    Parameters
    ----------
    lines : FitLines
        Lines of the fit band.
    solution : Solution
        Fit whose residual tells the noise.

    Returns
    -------
    ndarray, shape (n_frequencies,)
        Weights, 1 at the least noisy line.
    """
    power = np.mean(np.abs(solution.projection.residual) ** 2, axis=0) / lines.weight**2
    floor = _FLOOR * float(power.mean())
    shapes = [np.ones_like(power)]
    for natural_frequency, damping_ratio in solution.modes:
        shape = 1.0 / np.abs(pole_factor(lines.frequency, natural_frequency, damping_ratio)) ** 2
        shapes.append(shape / shape.max())
    columns = np.column_stack(shapes)
    level = np.full_like(power, power.mean())
    for _ in range(_ITERATIONS):
        share, _ = scipy.optimize.nnls(columns / level[:, None], power / level)
        level = np.maximum(columns @ share, floor)
    weight: FloatArray = np.sqrt(level.min() / level)
    return weight
