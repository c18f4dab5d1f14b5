"""Join readings with what was known of k1…k4 before, or refuse readings that contradict it."""

import math

import numpy as np
from scipy import linalg, special

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload.calibration import COEFFICIENT_NAMES, Weighting
from monitor_core.preload.prior import CoefficientPrior
from monitor_core.preload.regression import CoefficientFit, ReadingRows, excess_variance, weighted_least_squares
from monitor_core.uncertainty import VectorEstimate

#: Readings that a true prior would give less often than this contradict it.
CONTRADICTION = 1e-3
#: Degrees of freedom below which readings, all spent on the coefficients, say nothing of their scatter: rounding.
_SPENT = 1e-9


def fit_with_prior(prior: CoefficientPrior, rows: ReadingRows, weighting: Weighting) -> CoefficientFit:
    r"""Join readings with what was known of k1…k4 before: generalised least squares with the prior as extra rows.

    .. math::

        \min_z \sum_i \frac{w_i^2 (y_i - X_i \beta)^2}{\tau^2} + z^T z, \qquad \beta = \beta_0 + F z, \quad F F^T = C_0

    with :math:`\tau^2` the mean square that the prior expects of a weighted reading. A covariance :math:`C_0` that
    leaves some combination exactly known is no obstacle in this form.

    The columns are those of k1…k4, then of what the prior knows nothing of; the weights are as without a prior.
    ``NotIdentifiableError`` if the readings contradict the prior, or do not determine what it knows nothing of;
    ``OutsideValidityError`` if neither prior nor readings state any scatter.

    The readings bring :math:`\nu_1 = \sum (1 - h_i)` degrees of freedom, h their leverage in the joint fit: n − p where
    the prior says nothing, n where it says all. Their scatter is pooled with that of the prior by degrees of freedom,
    :math:`c^2 = (\nu_0 c_0^2 + \nu_1 c_1^2)/(\nu_0 + \nu_1)`, and :math:`\nu_0 + \nu_1` are those of the result. The
    prior's covariance rests on its scatter, so it follows the pooled one by the same factor; with infinite
    :math:`\nu_0` both stay as stated.

    Readings contradict the prior where the sum above exceeds what a true prior gives once in a thousand: the 0.1 %
    point of χ², or n times that of F(n, ν₀) for a scatter that is itself known with ν₀ degrees of freedom.
    """
    n, n_unknown = rows.design.shape[0], rows.design.shape[1] - len(COEFFICIENT_NAMES)
    expected = _expected_square(prior, rows)
    spread = prior.spread
    n_prior = spread.shape[1]
    basis = linalg.block_diag(spread, np.eye(n_unknown))
    start = np.append(prior.coefficients.values, np.zeros(n_unknown))
    fit = weighted_least_squares(
        np.vstack([rows.design @ basis, np.eye(n_prior, basis.shape[1])]),
        np.append(rows.inverse_square - rows.design @ start, np.zeros(n_prior)),
        np.append(rows.weight, np.full(n_prior, math.sqrt(expected))),
    )
    z, residual, leverage = fit.parameters.values, fit.residual[:n], fit.leverage[:n]
    squares = float(np.sum((rows.weight * residual) ** 2))
    _refuse_contradiction(prior, squares / expected + float(np.sum(z[:n_prior] ** 2)), n - n_unknown)

    own = float(np.sum(1.0 - leverage))  # ν₁
    dof = prior.coefficients.degrees_of_freedom + own
    c_squared = prior.reproducibility**2
    if own > _SPENT:
        c_squared += own / dof * (excess_variance(rows, residual, leverage) - c_squared)
    reproducibility = math.sqrt(max(0.0, c_squared))
    if weighting is Weighting.STD:
        variance = rows.slope**2 * (rows.stated**2 + reproducibility**2)
    else:
        variance = np.full(n, expected + (squares - own * expected) / dof)
    followed = float(np.mean(rows.weight**2 * variance)) / expected
    to_parameters = basis @ fit.estimator
    covariance = (to_parameters * np.append(variance, np.full(n_prior, followed))) @ to_parameters.T
    return CoefficientFit(VectorEstimate(start + basis @ z, covariance, dof), reproducibility, fit.condition_number)


def _expected_square(prior: CoefficientPrior, rows: ReadingRows) -> float:
    """Return τ², what the prior expects of the square of a weighted residual."""
    square = float(np.mean((rows.weight * rows.slope) ** 2 * (rows.stated**2 + prior.reproducibility**2)))
    if not square > 0.0:
        raise OutsideValidityError(
            "a prior without scatter needs readings that state theirs; got a reproducibility of 0 Hz and no "
            "frequency_std"
        )
    return square


def _refuse_contradiction(prior: CoefficientPrior, chi_squared: float, n: int) -> None:
    dof = prior.coefficients.degrees_of_freedom
    limit = special.chdtri(n, CONTRADICTION) if math.isinf(dof) else n * special.fdtri(n, dof, 1.0 - CONTRADICTION)
    if chi_squared > limit:
        raise NotIdentifiableError(
            f"the readings contradict the prior ({prior.source}): χ² of what separates them must be at most "
            f"{limit:.1f} for {n} degrees of freedom; got {chi_squared:.1f}. Check both, or calibrate without the prior"
        )
