r"""Move a fit to the mode of its posterior, where the condition errors depend on what was fitted.

Least squares take the covariance V of the misfit as it is at each step. Some condition errors act more on the data the
larger an effect is (a table that stands 0.3 mm from its stated position, under a preload that varies over a lead of
6 mm). They make the effect too large, because a wider V makes a misfit count less and costs nothing. The term
:math:`\ln \det V` is that cost; but V is a linearisation, and with it the effect becomes too small. So the error that
acts strongly is integrated (:func:`integrated_cost`), and the minimum of that cost is sought in coordinates in which
data and priors together determine every direction to one standard deviation.
"""

import math

import numpy as np
from scipy.optimize import minimize

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.solver.hypothesis_fit import Fitted, resolved_at
from monitor_core.fitting.solver.integrated_cost import integrated_cost

#: Of its standard deviation: where ln det V draws no parameter of an effect further away, a fit is left as it is.
_NEGLIGIBLE = 0.25
_STEP = 0.1  # of a standard deviation, for derivatives of a cost that is smooth to far less
_NEAR = 0.15  # of a standard deviation: so near the mode the search ends
_SETTLED = 0.02  # of half the cost, where a step gains no more (a cost around likely errors is no smoother)
_MOST_ITERATIONS = 12
_FARTHEST = 5.0  # standard deviations: beyond lies no mode of what least squares have found
_LEAST_PRECISION = 1e-3  # of a coordinate's own scale, inverse squared: what is known less has no scale but its own
_NO_ANSWER = 1e6  # in the place of half the cost


def at_mode(fitted: Fitted[Physics]) -> Fitted[Physics]:
    """Return a fit at the mode of its posterior, or the same fit where it is already as good.

    The same fit is also returned where the model has no answer with the table four standard deviations off.
    """
    hypothesis = fitted.hypothesis
    if not hypothesis.effects:
        return fitted
    scales = _scales(fitted)

    def at(z: FloatArray) -> Fitted[Physics] | None:
        try:
            return resolved_at(fitted, np.clip(fitted.coordinates + scales @ z, *hypothesis.bounds))
        except OutsideValidityError:
            return None

    still, here = np.zeros(hypothesis.n_coordinates), _log_determinant(fitted)
    slope = np.array([_log_determinant(at(_STEP * direction)) - here for direction in np.eye(still.size)]) / _STEP
    of_effects = scales[hypothesis.n_uncertain :]
    if np.all(np.abs(of_effects @ slope) / 2.0 < _NEGLIGIBLE * np.linalg.norm(of_effects, axis=1)):
        return fitted
    start = _integrated(fitted)
    if not math.isfinite(start):
        return fitted

    def half_cost(z: FloatArray) -> float:  # above that of the fit; its second derivatives are about one
        return min(0.5 * (_integrated(at(z)) - start), _NO_ANSWER)

    options = {"eps": _STEP, "gtol": _NEAR, "ftol": _SETTLED, "maxiter": _MOST_ITERATIONS}
    found = minimize(
        half_cost, still, method="L-BFGS-B", bounds=[(-_FARTHEST, _FARTHEST)] * still.size, options=options
    )
    mode = at(found.x)
    return mode if mode is not None and found.fun < 0.0 else fitted


def _integrated(there: Fitted[Physics] | None) -> float:
    try:
        return math.inf if there is None else integrated_cost(there)
    except OutsideValidityError:
        return math.inf


def _scales(fitted: Fitted[Physics]) -> FloatArray:
    """Return the principal directions of data and priors as columns, each one standard deviation long."""
    values, vectors = np.linalg.eigh(fitted.precision())
    return np.asarray(vectors / np.sqrt(np.maximum(values, _LEAST_PRECISION)))


def _log_determinant(fitted: Fitted[Physics] | None) -> float:
    return np.nan if fitted is None else fitted.around.whitened_by.log_determinant(fitted.fitted)
