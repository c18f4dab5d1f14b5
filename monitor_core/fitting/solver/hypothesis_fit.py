r"""Fit a hypothesis to a comparison: whitened least squares, reached through a tolerance that is taken away.

.. math::

    \chi^2(u) = \lVert V^{-1/2} m(u) \rVert^2 + \sum_i u_i^2

over the coordinates u of a hypothesis, those of uncertain parameters in their prior standard deviations. Far from the
data the logarithmic misfit is first fitted with an extra tolerance under which :math:`\chi^2/n \approx 4`; it shrinks
as the fit improves and is gone at the end. The misfit is taken as linear in the condition errors, around those
that are likely at the coordinates of each step.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Generic

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.problem import prior_jacobian, prior_residuals
from monitor_core.fitting.solver.derivatives import one_sided_derivative, residual_jacobian
from monitor_core.fitting.solver.least_squares import Patience, minimum
from monitor_core.fitting.solver.linearised import Linearised, linearise_at_likely_errors, resolved_at_errors

#: χ² per value that the tolerance is chosen for, and below which none is needed.
_TEMPERED = 4.0
_MOST_STAGES = 8
_STUCK = 0.999  # of the tolerance of the stage before: where it does not shrink the search stands in a false minimum
_MOST_ROUNDS, _SAME_ERRORS = 3, 1e-3  # of likely errors and the misfit around them; in standard deviations
_SAME_MISFIT = 0.02  # standard deviations, rms: by which a misfit may differ once the data are resolved anew
#: Residuals are linearised anew at each step: so small a fall is foretold for nothing, relatively.
_FOR_NOTHING = 1e-3
_TO_MINIMUM = Patience(60, flat=1e-5, for_nothing=_FOR_NOTHING)
#: A stage need not end at its minimum; a fall of χ² that would hardly let the tolerance shrink is not waited for.
_OF_A_STAGE = Patience(8, flat=5e-4, for_nothing=_FOR_NOTHING)
#: A step of a fit without some of its values: of singular values, what is unseen; of the squares of residuals, by how
#: much those after it may differ from what its slope says.
_UNSEEN, _NEARLY_LINEAR = 1e-10, 0.01


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals of values from fits that did not see them."""

    chosen: BoolArray  # which values were held out, shape (n_values,)
    misfit: FloatArray  # shape (n_values,); meaningful where chosen
    standardised: FloatArray  # shape (n_values,); meaningful where chosen


@dataclass(frozen=True, eq=False)
class Fitted(Generic[Physics]):
    """A hypothesis at its best coordinates."""

    comparison: Comparison[Physics]
    hypothesis: Hypothesis[Physics]
    coordinates: FloatArray  # shape (n_coordinates,)
    around: Linearised[Physics]  # around these coordinates
    fitted: BoolArray  # which values took part
    given_up: bool = False  # on the way to a minimum that would have been no better than another one
    tolerance: float = 0.0  # extra, with which it ended where it did not reach the data

    @property
    def misfit(self) -> FloatArray:
        """Misfit of all values, held out or not, shape (n_values,)."""
        return self.around.here

    @cached_property
    def standardised(self) -> FloatArray:
        """Residuals of all values, standard normal and independent where the hypothesis is right, shape (n_values,)."""
        return self.around.whitened_by(self.misfit)

    @cached_property
    def jacobian(self) -> FloatArray:
        """Derivatives of the residuals of all values, shape (n_values, n_coordinates)."""
        return residual_jacobian(self.around, self.hypothesis, self.coordinates, central=True)

    @cached_property
    def n_seen(self) -> int:
        """How many unknowns of the effects move what was measured: frequencies, for one, do not show a damping."""
        unknowns, first = self.hypothesis.unknowns, self.hypothesis.n_uncertain
        others = [n for n, (effect, parameter) in enumerate(unknowns, first) if parameter is not effect.parameters[0]]
        linearisation = (self.around, self.hypothesis, self.coordinates, self.misfit)
        return len(unknowns) - sum(1 for n in others if not np.any(one_sided_derivative(*linearisation, n)))

    @cached_property
    def held_out(self) -> HeldOut | None:
        """Residuals of held-out values; each of several folds is left out of a fit of its own. None without any."""
        folds = self.comparison.layout.held_out
        if not folds:
            return None
        if len(folds) == 1:
            return HeldOut(folds[0], self.misfit, self.standardised)
        misfit, standardised = np.zeros_like(self.misfit), np.zeros_like(self.misfit)
        for fold in folds:
            without = self._stepped_without(fold) or self._refitted(~fold)
            misfit[fold], standardised[fold] = without.misfit[fold], without.standardised[fold]
        return HeldOut(np.any(folds, axis=0), misfit, standardised)

    @property
    def gap(self) -> float:
        """Gap on the fitted values, in the unit of the comparison."""
        return self.comparison.gap(self.misfit, self.standardised, self.fitted)

    @property
    def prior_cost(self) -> float:
        """Sum of squares of the uncertain parameters in their standard deviations."""
        return float(np.sum(prior_residuals(self.hypothesis.priors, self.coordinates) ** 2))

    @cached_property
    def cost(self) -> float:
        """Twice the negative logarithm of the posterior, but for a constant: χ², the priors, and ln det V.

        V is the covariance with the condition errors, which a hypothesis may make larger or smaller.
        """
        chi_squared = float(np.sum(self.standardised[self.fitted] ** 2))
        return chi_squared + self.prior_cost + self.around.whitened_by.log_determinant(self.fitted)

    def precision(self, factor: float = 1.0) -> FloatArray:
        r"""Return :math:`f J^T J + \Pi`, with the priors' precision Π, shape (n_coordinates, n_coordinates).

        ``factor`` f is what a residual counts for.
        """
        jacobian = self.jacobian[self.fitted]
        of_prior = prior_jacobian(self.hypothesis.priors)
        return np.asarray(factor * jacobian.T @ jacobian + of_prior.T @ of_prior)

    def physics(self) -> Physics:
        """Return the axis as fitted."""
        return self.hypothesis.physics(self.coordinates)

    def _stepped_without(self, fold: BoolArray) -> "Fitted[Physics] | None":
        """Return the fit without a fold by one step of Gauss and Newton; None where the misfit is not linear so far.

        A minimum with most of the same values is near by: a whole fit would find hardly more.
        """
        kept, priors = self.fitted & ~fold, self.hypothesis.priors
        slope = np.vstack([self.jacobian[kept], prior_jacobian(priors)])
        here = np.concatenate([self.standardised[kept], prior_residuals(priors, self.coordinates)])
        step, *_ = np.linalg.lstsq(slope, -here, rcond=_UNSEEN)
        coordinates = np.clip(self.coordinates + step, *self.hypothesis.bounds)
        try:
            around = linearise_at_likely_errors(
                self.comparison, self.hypothesis, self.around.errors, self.comparison.layout.standard_deviation,
                coordinates,
            )  # fmt: skip
        except OutsideValidityError:
            return None
        without = Fitted(self.comparison, self.hypothesis, coordinates, around, kept)
        there = np.concatenate([without.standardised[kept], prior_residuals(priors, coordinates)])
        off = there - here - slope @ (coordinates - self.coordinates)
        return without if float(off @ off) < _NEARLY_LINEAR * max(float(here @ here), here.size) else None

    def _refitted(self, chosen: BoolArray) -> "Fitted[Physics]":
        try:
            return fit(self.comparison, self.hypothesis, self.coordinates, chosen)
        except OutsideValidityError:
            return self


def fit(
    comparison: Comparison[Physics],
    hypothesis: Hypothesis[Physics],
    start: FloatArray,
    fitted: BoolArray | None = None,
    *,
    to_beat: float = math.inf,
    errors: FloatArray | None = None,
) -> Fitted[Physics]:
    """Fit a hypothesis from a start of shape (n_coordinates,), to the values that are to be ``fitted``, by default all.

    The condition errors are sought from none, or from ``errors`` that are likely at the start, (n_settings, n_errors).
    A fit that creeps, and would stay above a cost ``to_beat`` if it crept on three times as fast, is given up.

    A fit that does not reach the data ends with the least tolerance that it came to: there a misfit is no noise, and
    values known better than others should not count for more of it. Costs of such fits compare with one another only.
    Raises OutsideValidityError if the model has no answer at the start.
    """
    layout = comparison.layout
    chosen = np.ones(layout.n_values, dtype=np.bool_) if fitted is None else fitted
    coordinates = np.clip(start, *hypothesis.bounds)
    none = np.zeros((len(layout.settings), len(comparison.condition_error_names)))
    sought = none if errors is None else errors
    tolerance, given_up = math.inf, False

    def likely(deviation: FloatArray) -> Callable[[FloatArray], Linearised[Physics]]:
        """Linearise along a search from here, resolution of the data and slopes by the errors as they are here."""
        resolved = resolved_at_errors(comparison, hypothesis, sought, coordinates)
        likely_at = partial(linearise_at_likely_errors, resolved, hypothesis, sought, deviation)
        here = likely_at(coordinates)
        return _remembered(partial(likely_at, estimated_by=here.whitened_by), coordinates, here)

    for _ in range(_MOST_STAGES):
        before = tolerance
        misfit = comparison.shifted(sought).misfit(hypothesis.physics(coordinates))
        tolerance = _tolerance(misfit, layout.standard_deviation, chosen)
        if not tolerance or tolerance > _STUCK * before or not hypothesis.n_coordinates:
            break
        tempered = likely(np.hypot(layout.standard_deviation, tolerance))
        stage = Pace(_OF_A_STAGE)
        coordinates = _nearest_minimum(tempered, hypothesis, coordinates, chosen, stage)
        sought = tempered(coordinates).errors
    around = linearise_at_likely_errors(comparison, hypothesis, sought, layout.standard_deviation, coordinates)
    for _ in range(_MOST_ROUNDS if not tolerance and hypothesis.n_coordinates else 0):
        sought = around.errors
        along = likely(layout.standard_deviation)
        try:
            coordinates = _nearest_minimum(along, hypothesis, coordinates, chosen, Pace(_TO_MINIMUM, to_beat))
        except GivenUpError as creeping:
            coordinates, given_up = creeping.coordinates, True
        # resolved here, at the errors that are likely now
        around = linearise_at_likely_errors(
            comparison, hypothesis, along(coordinates).errors, layout.standard_deviation, coordinates
        )
        off = ((around.here - along(coordinates).here) / layout.standard_deviation)[chosen]
        if given_up or float(np.mean(off**2)) < _SAME_MISFIT**2:
            break
    return Fitted(comparison, hypothesis, coordinates, around, chosen, given_up, tolerance)


def unfitted(like: Fitted[Physics]) -> Fitted[Physics]:
    """Return a hypothesis at its null coordinates, with the tolerance that a fit to the same values begins with there.

    Raises OutsideValidityError if the model has no answer there.
    """
    comparison, hypothesis = like.comparison, like.hypothesis
    deviation, null = comparison.layout.standard_deviation, hypothesis.null
    tolerance = _tolerance(comparison.misfit(hypothesis.physics(null)), deviation, like.fitted)
    errors = np.zeros((len(comparison.layout.settings), len(comparison.condition_error_names)))
    around = linearise_at_likely_errors(comparison, hypothesis, errors, np.hypot(deviation, tolerance), null)
    return Fitted(comparison, hypothesis, null, around, like.fitted, tolerance=tolerance)


def resolved_at(fitted: Fitted[Physics], coordinates: FloatArray) -> Fitted[Physics]:
    """Return the same hypothesis at other coordinates, around the condition errors that are likely there.

    Raises OutsideValidityError if the model has no answer there.
    """
    comparison, hypothesis, errors = fitted.comparison, fitted.hypothesis, fitted.around.errors
    for _ in range(_MOST_ROUNDS):
        around = linearise_at_likely_errors(
            comparison, hypothesis, errors, comparison.layout.standard_deviation, coordinates
        )
        if np.max(np.abs(around.errors - errors), initial=0.0) < _SAME_ERRORS:
            break
        errors = around.errors
    return Fitted(comparison, hypothesis, coordinates, around, fitted.fitted)


def _tolerance(misfit: FloatArray, deviation: FloatArray, chosen: BoolArray) -> float:
    """Return the tolerance with which χ² per value is that of a tempered fit, 0 where it is below without one."""
    square, variance = misfit[chosen] ** 2, deviation[chosen] ** 2
    if np.mean(square / variance) <= _TEMPERED:
        return 0.0
    low, high = 0.0, float(np.sqrt(np.max(square)))
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.mean(square / (variance + middle**2)) > _TEMPERED else (low, middle)
    return high


_PATIENCE, _FASTER = 10, 3.0  # steps before a search may be given up, and how much faster than now it might yet become
#: Phases wrap, so a misfit in logarithms is bounded; anything larger is no fit at all.
_LARGEST_RESIDUAL = 1e6


class GivenUpError(Exception):
    """A search is no longer worth it."""

    def __init__(self, coordinates: FloatArray) -> None:
        super().__init__("the search creeps towards a minimum that is no better than another one")
        self.coordinates = coordinates  # the best so far


class Pace:
    """Watch the costs that a search comes by, and leave it where it creeps and cannot beat a cost any more."""

    def __init__(self, patience: Patience, to_beat: float = math.inf) -> None:
        self.patience = patience
        self._left = patience.most_evaluations
        self._to_beat = to_beat
        self._best: list[float] = []  # costs, each lower than the one before
        self._at = np.zeros(0)

    def require(self, cost: Callable[[], float], coordinates: FloatArray) -> None:
        """Take the next cost down; raises GivenUpError."""
        if math.isinf(self._to_beat):
            return
        self._left -= 1
        here = cost()
        if not self._best or here < self._best[-1]:
            self._best.append(here)
            self._at = coordinates.copy()
        if len(self._best) > _PATIENCE:
            step = (self._best[-1 - _PATIENCE // 2] - self._best[-1]) / (_PATIENCE // 2)
            if self._best[-1] - _FASTER * step * self._left > self._to_beat:
                raise GivenUpError(self._at)


def _remembered(
    around: Callable[[FloatArray], Linearised[Physics]], start: FloatArray, at_start: Linearised[Physics]
) -> Callable[[FloatArray], Linearised[Physics]]:
    """Return the same, computed once where a search has taken its last step, or one that was too long."""
    of_start = start.tobytes()
    linearised_at = lru_cache(maxsize=2)(lambda key: at_start if key == of_start else around(np.frombuffer(key)))
    return lambda coordinates: linearised_at(coordinates.tobytes())


class _Steps(Generic[Physics]):
    """Residuals and their derivatives along a search, linearised anew at each step."""

    def __init__(
        self,
        around: Callable[[FloatArray], Linearised[Physics]],
        hypothesis: Hypothesis[Physics],
        chosen: BoolArray,
        pace: Pace,
    ) -> None:
        self._around, self._hypothesis, self._chosen, self._pace = around, hypothesis, chosen, pace
        self._of_prior = prior_jacobian(hypothesis.priors)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the residuals of the chosen values and the priors, infinite where the search must not go."""
        nowhere = np.full(np.count_nonzero(self._chosen) + len(self._of_prior), np.inf)
        try:
            around = self._around(coordinates)
        except OutsideValidityError:
            return nowhere  # the search shortens its step
        whitened = around.whitened_by(around.here)[self._chosen]
        if not np.max(np.abs(whitened)) < _LARGEST_RESIDUAL:
            return nowhere
        values = np.concatenate([whitened, prior_residuals(self._hypothesis.priors, coordinates)])
        square = float(values @ values)
        self._pace.require(lambda: square + around.whitened_by.log_determinant(self._chosen), coordinates)
        return values

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals."""
        of_values = residual_jacobian(self._around(coordinates), self._hypothesis, coordinates)
        return np.vstack([of_values[self._chosen], self._of_prior])


def _nearest_minimum(
    around: Callable[[FloatArray], Linearised[Physics]],
    hypothesis: Hypothesis[Physics],
    start: FloatArray,
    chosen: BoolArray,
    pace: Pace,
) -> FloatArray:
    """Return the coordinates of the minimum next to a start.

    Raises GivenUpError on the way to a minimum that is no better than what is ``to_beat``.
    """
    steps = _Steps(around, hypothesis, chosen, pace)
    if not np.all(np.isfinite(steps.residuals(start))):
        return start  # too far from the data for a slope to mean anything
    return minimum(steps.residuals, steps.jacobian, start, hypothesis.bounds, pace.patience)
