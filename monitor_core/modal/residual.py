"""Read the residual of a fit: the noise of each line, and sines that persist in every window."""

import numpy as np
import scipy.optimize
import scipy.special

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.modal.fit_lines import FitLines
from monitor_core.modal.model import pole_factor
from monitor_core.modal.variable_projection import Solution

_ITERATIONS = 4
#: Least share of the mean level: a line must not count for more than a thousand average ones.
_FLOOR = 1e-3
#: Probability that a clean band is said to hold a tone.
_FALSE_ALARM_PROBABILITY = 1e-3
_LINES_APART = 1.5
#: Of a tone's power over its neighbours'. With more than about a dozen windows this rise, not the significance level,
#: decides: the level then lies below three times the noise.
_LEAST_RISE = 3.0


def noise_weight(lines: FitLines, solution: Solution) -> FloatArray:
    r"""Return one over the standard deviation of the noise at each line, 1 at the least noisy, shape (n_frequencies,).

    .. math:: \sigma^2(f) = \sigma_0^2 + \sum_i \sigma_i^2\, \frac{\min |A_i|^2}{|A_i(f)|^2}

    The first part is the accelerometer's. The others are forces that nobody measures, such as friction: they reach the
    sensor through the mode, so their noise has its shape; on an axis with friction they are nearly all of it. Fitted to
    the residual's mean power over windows, whose standard deviation is proportional to itself (maximum likelihood of
    the gamma distribution by repeated non-negative least squares).
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


def strongest_tone(lines: FitLines, solution: Solution) -> float | None:
    r"""Return the frequency in hertz of the strongest sine that the fit leaves, or ``None`` if none is significant.

    A sine of unknown amplitude and phase in each window, of one frequency in all, stands out on its line, or, halfway
    between two, in their difference (the line shape changes sign there):

    .. math:: S(f_k) = \frac{2}{\sigma^2} \sum_s |R_s(k)|^2,\qquad
        S(f_{k+1/2}) = \frac{2}{\sigma^2} \sum_s \tfrac12 |R_s(k) - R_s(k+1)|^2

    Both are :math:`\chi^2` with two degrees of freedom per window if there is none; the level is divided by the number
    of places, on the lines and between them. A line and a half on either side of a mode are left out: there a sine
    cannot be told from ringing that the model does not quite meet. What stands no higher than its neighbourhood is
    noise of another colour than supposed, and no sine either.
    """
    f, residual = lines.frequency, solution.projection.residual
    power = np.sum(np.abs(residual) ** 2, axis=0)
    between = 0.5 * np.sum(np.abs(np.diff(residual, axis=1)) ** 2, axis=0)
    places = np.concatenate([f, 0.5 * (f[:-1] + f[1:])])
    candidates = np.where(_apart_from_modes(places, solution, lines.resolution), np.concatenate([power, between]), 0.0)
    best = int(np.argmax(candidates))
    distance = np.abs(f - places[best]) / lines.resolution
    neighbours = power[(distance > 1.5) & (distance < 6.5)].mean()
    level = scipy.special.chdtri(2 * lines.n_windows, _FALSE_ALARM_PROBABILITY / places.size)
    significant = 2.0 * candidates[best] / solution.noise_variance > level
    return float(places[best]) if significant and candidates[best] > _LEAST_RISE * neighbours else None


def _apart_from_modes(tones: FloatArray, solution: Solution, resolution: float) -> BoolArray:
    apart = np.ones(tones.size, dtype=np.bool_)
    for natural_frequency in solution.modes[:, 0]:
        apart &= np.abs(tones - natural_frequency) > _LINES_APART * resolution
    return apart
