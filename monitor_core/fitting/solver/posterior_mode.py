r"""Move a fit to the mode of its posterior, integrated over condition errors that act too strongly to be linear.

Least squares take the covariance V of the misfit as it is at each step. Some condition errors act more on the data the
larger an effect is (a table that stands 0.3 mm from its stated position, under a preload that varies over a lead of
6 mm). They make the effect too large, because a wider V makes a misfit count less and costs nothing. The term
:math:`\ln \det V` is that cost; but V is a linearisation, and with it the effect becomes too small. So the error that
acts strongly is integrated (:func:`integrated_cost`), and the minimum of that cost is sought in coordinates in which
data and priors together determine every direction to one standard deviation.

A preload that varies by a third over a lead of 6 mm differs at 0.3 mm from the stated position by more than its slope
says, and near an extreme to the same side whichever way the table is off. With that error e of a setting
held, the others (preload, gains) still act linearly and go out in closed form,

.. math::

    q(e) = r^T (I - T^T (I + T T^T)^{-1} T) r + \ln \det (I + T T^T) + e^2, \qquad
    -2 \ln L = -2 \ln \int \frac{e^{-q/2}}{\sqrt{2 \pi}} de

with misfit r and its changes T by the others, both in standard deviations, at e. As functions of e both are smooth:
polynomials through some nodes. Settings count as independent here; what they share, the error of a model's form at one
frequency, is as the linearisation has it.
"""

import math

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.solver.hypothesis_fit import Fitted, resolved_at
from monitor_core.fitting.solver.linearised import linearise_again

#: The first condition error is the error that may act strongly: where the table stood.
_INTEGRATED = 0
_REACH = 4.0  # standard deviations to either side
_NODES = _REACH * np.cos(np.pi * (np.arange(7) + 0.5) / 7)  # Chebyshev's
_GRID, _GRID_STEP = np.linspace(-_REACH, _REACH, 321, retstep=True)
_AT_GRID = np.vander(_GRID / _REACH, _NODES.size) @ np.linalg.inv(np.vander(_NODES / _REACH, _NODES.size))
_PAIRS_AT_GRID = (_AT_GRID[:, :, None] * _AT_GRID[:, None, :]).reshape(_GRID.size, -1)  # of two polynomials
#: An error that the data determine to better than that acts linearly, and would fall between the points of the grid.
_WELL_KNOWN = 2.0 * _GRID_STEP


def integrated_cost(fitted: Fitted[Physics]) -> float:
    """Return :attr:`Fitted.cost` with that error of each setting integrated in place of its linearisation.

    Where it would lie out of reach, because something else is missing, the linearisation stays.

    Raises OutsideValidityError if the model has no answer at one of the errors.
    """
    whitened_by = fitted.around.whitened_by
    n_others = fitted.around.errors.shape[1] - 1
    if n_others < 0:
        return fitted.cost
    rows = _rows_at_nodes(fitted)
    linear = _linearised(fitted)
    in_use = np.logical_or.reduceat(fitted.fitted, whitened_by.starts)
    ends = np.r_[whitened_by.starts[1:], rows.shape[2]]
    change = 0.0
    deviation, likely = _deviations(fitted), np.abs(whitened_by.errors(fitted.misfit)[:, _INTEGRATED])
    for setting in np.flatnonzero(in_use & (deviation > _WELL_KNOWN) & (likely + 2.0 * deviation < _REACH)):
        of_setting = rows[:, :, whitened_by.starts[setting] : ends[setting]]
        flat = of_setting.reshape(-1, of_setting.shape[2])
        products = (flat @ flat.T).reshape(1 + n_others, _NODES.size, 1 + n_others, _NODES.size)
        change += _marginal(products) - linear[setting]
    return float(fitted.cost + change)


def _rows_at_nodes(fitted: Fitted[Physics]) -> FloatArray:
    """Return the misfit and its changes by the other errors at each node, shape (1 + n_others, n_nodes, n_values)."""
    around, physics = fitted.around, fitted.physics()
    layout = around.comparison.layout
    rows = []
    for node in _NODES:
        moved = np.zeros_like(around.errors)
        moved[:, _INTEGRATED] = node - around.errors[:, _INTEGRATED]
        there = around.comparison.shifted(moved)
        misfit = there.misfit(physics)
        others = np.delete(there.condition_errors(physics, misfit), _INTEGRATED, axis=0)
        likely = np.delete(around.errors, _INTEGRATED, axis=1)[layout.setting]
        rows.append(np.vstack([misfit - np.einsum("kv,vk->v", others, likely), others]) / layout.standard_deviation)
    return np.asarray(np.stack(rows, axis=1))


def _marginal(products: FloatArray) -> float:
    """Return −2 ln L of a setting from the inner products of its rows at nodes."""
    n_rows = products.shape[0]
    of_pairs = products.transpose(1, 3, 0, 2).reshape(-1, n_rows * n_rows)
    inner = (_PAIRS_AT_GRID @ of_pairs).reshape(-1, n_rows, n_rows)
    gram = np.eye(n_rows - 1) + inner[:, 1:, 1:]
    along = inner[:, 1:, 0]
    taken = np.einsum("gk,gk->g", along, np.linalg.solve(gram, along[..., None])[..., 0])
    exponent = inner[:, 0, 0] - taken + np.linalg.slogdet(gram)[1] + _GRID**2
    least = float(np.min(exponent))
    return least - 2.0 * float(np.log(np.sum(np.exp(-0.5 * (exponent - least))) * _GRID_STEP / np.sqrt(2.0 * np.pi)))


def _linearised(fitted: Fitted[Physics]) -> FloatArray:
    """Return −2 ln L of each setting as :attr:`Fitted.cost` has it, shape (n_settings,)."""
    whitened_by = fitted.around.whitened_by
    scaled = fitted.misfit / whitened_by.deviation
    along = np.stack([np.add.reduceat(scaled * row, whitened_by.starts) for row in whitened_by.directions], axis=-1)
    covariance = np.eye(along.shape[1]) + whitened_by.grams
    taken = np.einsum("sk,sk->s", along, np.linalg.solve(covariance, along[..., None])[..., 0])
    return np.asarray(np.add.reduceat(scaled**2, whitened_by.starts) - taken + np.linalg.slogdet(covariance)[1])


def _deviations(fitted: Fitted[Physics]) -> FloatArray:
    """Return the standard deviation of that error as the data of each setting determine it, shape (n_settings,)."""
    grams = fitted.around.whitened_by.grams
    return np.asarray(np.sqrt(np.linalg.inv(np.eye(grams.shape[1]) + grams)[:, _INTEGRATED, _INTEGRATED]))


#: Of its standard deviation: where ln det V draws no parameter of an effect further away, a fit is left as it is.
_NEGLIGIBLE = 0.25
_STEP = 0.1  # of a standard deviation, for derivatives of a cost that is smooth to far less
_NEAR = 0.15  # of a standard deviation: so near the mode the search ends
_SETTLED = 0.005  # of half the cost, where a step gains no more (a cost around likely errors is no smoother)
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

    slope, of_effects = _slope_of_log_determinant(fitted, scales), scales[hypothesis.n_uncertain :]
    if np.all(np.abs(of_effects @ slope) / 2.0 < _NEGLIGIBLE * np.linalg.norm(of_effects, axis=1)):
        return fitted
    start = _integrated(fitted)
    if not math.isfinite(start):
        return fitted

    def half_cost(z: FloatArray) -> float:  # above that of the fit; its second derivatives are about one
        return min(0.5 * (_integrated(at(z)) - start), _NO_ANSWER)

    still = np.zeros(hypothesis.n_coordinates)
    options = {"eps": _STEP, "gtol": _NEAR, "ftol": _SETTLED, "maxiter": _MOST_ITERATIONS}
    result = scipy.optimize.minimize(
        half_cost, still, method="L-BFGS-B", bounds=[(-_FARTHEST, _FARTHEST)] * still.size, options=options
    )
    mode = at(result.x)
    return mode if mode is not None and result.fun < 0.0 else fitted


def _integrated(there: Fitted[Physics] | None) -> float:
    try:
        return math.inf if there is None else integrated_cost(there)
    except OutsideValidityError:
        return math.inf


def _scales(fitted: Fitted[Physics]) -> FloatArray:
    """Return the principal directions of data and priors as columns, each one standard deviation long."""
    values, vectors = np.linalg.eigh(fitted.precision())
    return np.asarray(vectors / np.sqrt(np.maximum(values, _LEAST_PRECISION)))


def _slope_of_log_determinant(fitted: Fitted[Physics], scales: FloatArray) -> FloatArray:
    """Return the derivatives of ln det V along the columns of ``scales``, NaN where there is no answer; (n_columns,).

    So near to the fit the condition errors are those that are likely at the fit.
    """
    around, slopes = fitted.around, []
    here = around.whitened_by.log_determinant(fitted.fitted)
    for direction in scales.T:
        coordinates = np.clip(fitted.coordinates + _STEP * direction, *fitted.hypothesis.bounds)
        try:
            there = linearise_again(around, fitted.hypothesis.physics(coordinates)).whitened_by
            slopes.append((there.log_determinant(fitted.fitted) - here) / _STEP)
        except OutsideValidityError:
            slopes.append(np.nan)
    return np.array(slopes)
