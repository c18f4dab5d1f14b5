r"""A fit moved half way to the mode of its posterior, where the errors of the settings depend on what was fitted.

Least squares take the covariance V of the misfit as it is at each step. Where the errors of the settings act the more
on the data the larger an effect is (a table that stands 0.3 mm beside its tag, under a preload that varies over a lead
of 6 mm), they make the effect too large: the wider V is, the less of a misfit counts, and that is free. What counts
it is :math:`\ln \det V` (:attr:`Fitted.cost`). But V is a linearisation, in the place of an integral over those errors,
and the minimum of all of that is too small an effect: the middle between both is nearer to the truth than either. The
minimum is sought in coordinates in which the data and the priors tell every direction to one.
"""

from typing import TypeVar

import numpy as np
from scipy.optimize import minimize

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.searching.fit import Fitted, resolved_at
from monitor_core.errors import OutsideValidityError

Physics = TypeVar("Physics")

#: Of its standard deviation: where ln det V draws no parameter of an effect further away, a fit is left as it is.
_NEGLIGIBLE = 0.25
_STEP = 0.1  # of a standard deviation, for derivatives of a cost that is smooth to far less
_NEAR = 0.15  # of a standard deviation: so near the mode the search ends
_SETTLED = 0.02  # of half the cost, where a step gains no more (a cost around likely errors is no smoother)
_MOST_ITERATIONS = 12
_LEAST_TOLD = 1e-3  # of a coordinate's own scale, inverse squared: what is told less has no scale but its own
_NO_ANSWER = 1e6  # in the place of half the cost


def half_way_to_mode(fitted: Fitted[Physics]) -> Fitted[Physics]:
    """Return a fit half way to the mode of its posterior; the same one where that is as good as where it is."""
    hypothesis = fitted.hypothesis
    if not hypothesis.effects:
        return fitted
    scales = _scales(fitted)

    def at(z: FloatArray) -> Fitted[Physics] | None:
        try:
            return resolved_at(fitted, np.clip(fitted.coordinates + scales @ z, *hypothesis.bounds))
        except OutsideValidityError:
            return None

    def half_cost(z: FloatArray) -> float:  # above that of the fit; its second derivatives are about one
        there = at(z)
        return _NO_ANSWER if there is None else 0.5 * (there.cost - fitted.cost)

    still, here = np.zeros(hypothesis.n_coordinates), _log_determinant(fitted)
    slope = np.array([_log_determinant(at(_STEP * one)) - here for one in np.eye(still.size)]) / _STEP
    of_effects = scales[hypothesis.n_uncertain :]
    if np.all(np.abs(of_effects @ slope) / 2.0 < _NEGLIGIBLE * np.linalg.norm(of_effects, axis=1)):
        return fitted
    options = {"eps": _STEP, "gtol": _NEAR, "ftol": _SETTLED, "maxiter": _MOST_ITERATIONS}
    mode = at(minimize(half_cost, still, method="L-BFGS-B", options=options).x)
    if mode is None or not mode.cost < fitted.cost:
        return fitted
    return resolved_at(fitted, 0.5 * (fitted.coordinates + mode.coordinates))


def _scales(fitted: Fitted[Physics]) -> FloatArray:
    """Return the directions that data and priors tell, each of one standard deviation, as columns."""
    values, vectors = np.linalg.eigh(fitted.precision())
    return np.asarray(vectors / np.sqrt(np.maximum(values, _LEAST_TOLD)))


def _log_determinant(fitted: Fitted[Physics] | None) -> float:
    return np.nan if fitted is None else fitted.around.whitened_by.log_determinant(fitted.fitted)
