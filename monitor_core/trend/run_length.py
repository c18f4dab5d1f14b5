"""Compute the average run length of control charts.

All functions take the true distribution of the residual as the chart sees it, N(shift, scale²), counted positive
towards loss. ``shift`` and ``scale`` [-] may be arrays of any shape: on an *estimated* baseline even a healthy axis
shows a shift and a scale other than 1, different ones for each baseline. All functions return the measurements up to
and including the signal [-], at most 1e12, in that shape. A limit that is not positive raises ``OutsideValidityError``.
"""

import math

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError

#: No axis lives longer. A run ends by itself with the reciprocal of this as its probability per measurement, without
#: which the linear system of a chart that never signals would be singular.
_LONGEST = 1e12


def cusum_run_length(
    limit: float,
    *,
    reference: float,
    shift: npt.ArrayLike = 0.0,
    scale: npt.ArrayLike = 1.0,
    largest_increment: float = math.inf,
    confirmed_limit: float = math.inf,
    n_cells: int = 80,
) -> FloatArray:
    r"""Return the average run length of the one-sided CUSUM, from an empty chart to a value above its limit.

    Markov chain of [1]_: [0, h] in cells of width w = 2h/(2n − 1), the first of which is half a cell around zero. With
    a second rule, by which two residuals in a row beyond a limit signal as well, the chain also remembers whether the
    last residual was beyond. With the transitions P₀ of a residual within and P₁ of one beyond, the mean lengths a
    after one within and b after one beyond are

    .. math:: a = 1 + P_0 a + P_1 b, \qquad b = 1 + P_0 a

    with h the limit and k the reference. The largest increment is the winsorising constant of
    :func:`monitor_core.trend.state.cusum_step`; the confirmed limit, the Shewhart limit of the second rule, is
    infinite without it. The error falls with the square of the number of cells; 80 give 0.1 % at k = 0.5, h = 5.

    Examples
    --------
    Table 3 of [2]_, one side, k = 0.5, h = 4: 335.4

    >>> round(float(cusum_run_length(4.0, reference=0.5)))
    335

    References
    ----------
    .. [1] D. Brook, D. A. Evans, Biometrika 59 (1972) 539–549.
    .. [2] J. M. Lucas, R. B. Crosier, Technometrics 24 (1982) 199–205.
    """
    _require_positive(limit)
    width = 2.0 * limit / (2 * n_cells - 1)
    edge: FloatArray = np.arange(-n_cells, n_cells, dtype=np.float64) + 0.5  # of the cells travelled in one step
    cumulative = _normal_cdf(edge * width + reference, shift, scale)
    below = _normal_cdf(np.array([confirmed_limit]), shift, scale)
    # a whole number of cells, rounded down: two increments of half the limit fill the chart, but do not exceed it
    atom = edge > (math.floor(largest_increment / width) if math.isfinite(largest_increment) else math.inf)
    within = np.where(atom, below, np.minimum(cumulative, below))
    beyond = np.where(atom, 1.0, cumulative) - within

    p0, p1 = _from_cell_to_cell(within), _from_cell_to_cell(beyond)
    ones = np.ones((*p0.shape[:-1], 1))
    return _first_passage(p0 + p1 @ p0, ones + p1 @ ones, start_cell=0)


def _from_cell_to_cell(cumulative: FloatArray) -> FloatArray:
    """Turn P(cells travelled ≤ edge), shape (..., 2n), into P(from cell, to cell), shape (..., n, n)."""
    n_cells = cumulative.shape[-1] // 2
    cell = np.arange(n_cells)
    travelled = cell[None, :] - cell[:, None] + n_cells
    probability = np.asarray(cumulative[..., travelled] - cumulative[..., travelled - 1])
    probability[..., 0] = cumulative[..., travelled[:, 0]]  # everything below the first cell is held at zero
    return probability


def ewma_run_length(
    limit: float,
    *,
    weight: float,
    shift: npt.ArrayLike = 0.0,
    scale: npt.ArrayLike = 1.0,
    largest_residual: float = math.inf,
    n_cells: int = 81,
) -> FloatArray:
    r"""Return the average run length of an EWMA from zero to beyond its limit.

    Markov chain of [1]_ on [−c, c], where :math:`c = L \sqrt{\lambda/(2-\lambda)}` is the limit of the average itself
    and λ the weight. Residuals are winsorised at the largest magnitude. The number of cells is odd, so that zero is the
    middle of one; 81 give 0.6 % at λ = 0.1, ARL 500.

    Examples
    --------
    Table 3 of [1]_, λ = 0.1, L = 2.814: 500

    >>> round(float(ewma_run_length(2.814 * math.sqrt(0.1 / 1.9), weight=0.1, n_cells=321)), -1)
    500.0

    References
    ----------
    .. [1] J. M. Lucas, M. S. Saccucci, Technometrics 32 (1990) 1–12.
    """
    _require_positive(limit)
    width = 2.0 * limit / n_cells
    start_cell = n_cells // 2
    centre: FloatArray = (np.arange(n_cells, dtype=np.float64) - start_cell) * width
    half = 0.5 * width

    def cdf_of_next(edge: FloatArray) -> FloatArray:
        residual = (edge[None, :] - (1.0 - weight) * centre[:, None]) / weight
        probability = _normal_cdf(residual, shift, scale)
        probability[..., residual >= largest_residual] = 1.0
        probability[..., residual < -largest_residual] = 0.0
        return probability

    transition = cdf_of_next(centre + half) - cdf_of_next(centre - half)
    return _first_passage(transition, np.ones((*transition.shape[:-1], 1)), start_cell)


def shewhart_run_length(
    limit: float,
    *,
    shift: npt.ArrayLike = 0.0,
    scale: npt.ArrayLike = 1.0,
    consecutive: int = 1,
    two_sided: bool = False,
) -> FloatArray:
    r"""Return the average run length of a Shewhart chart that signals after consecutive residuals beyond the limit.

    .. math:: \mathrm{ARL} = \frac{1 - p^r}{(1 - p)\, p^r}

    Mean waiting time for a run of r successes, section XIII.7 of [1]_; 1/p for r = 1. The limit is in standard
    deviations, r the number of consecutive residuals; two-sided, those beyond the limit on either side count.

    Examples
    --------
    The three-sigma chart:

    >>> round(float(shewhart_run_length(3.0, two_sided=True)), 1)
    370.4

    References
    ----------
    .. [1] W. Feller, An Introduction to Probability Theory and Its Applications, vol. 1, 3rd ed., Wiley, 1968.
    """
    shift, scale = np.asarray(shift, dtype=np.float64), np.asarray(scale, dtype=np.float64)
    p = scipy.special.ndtr((shift - limit) / scale)
    if two_sided:
        p = p + scipy.special.ndtr((-limit - shift) / scale)
    # (1 − pʳ)/(1 − p) = 1 + p + … + pʳ⁻¹ also holds at p = 1
    partial_sum = sum((p**i for i in range(1, consecutive)), start=np.ones_like(p))
    return np.asarray(partial_sum / np.maximum(p**consecutive, 1.0 / _LONGEST))


def _normal_cdf(points: FloatArray, shift: npt.ArrayLike, scale: npt.ArrayLike) -> FloatArray:
    """Return P(residual ≤ point), shape (*distributions, *points)."""
    shift, scale = np.broadcast_arrays(np.asarray(shift, dtype=np.float64), np.asarray(scale, dtype=np.float64))
    expand = (...,) + (None,) * points.ndim
    return np.asarray(scipy.special.ndtr((points - shift[expand]) / scale[expand]))


def _first_passage(transition: FloatArray, duration: FloatArray, start_cell: int) -> FloatArray:
    """Return the mean time until the chain leaves its cells; ``duration`` is of a stay, shape (..., n_cells, 1)."""
    surviving = (1.0 - 1.0 / _LONGEST) * transition
    return np.asarray(np.linalg.solve(np.eye(transition.shape[-1]) - surviving, duration)[..., start_cell, 0])


def _require_positive(limit: float) -> None:
    if not limit > 0.0:
        raise OutsideValidityError(f"limit must be positive; got {limit}")
