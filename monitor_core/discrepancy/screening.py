r"""Screen effects from where a fit stands: try a few sizes of each, with everything else refitted linearly.

A score test follows the slope where the effect is absent. That slope deceives where an effect makes a resonance, or
where the gap is large, so sizes over decades are tried as well. At each size the other coordinates of the fit take up
what they can, which is a projection:

.. math::

    \Delta\chi^2 = \lVert r \rVert^2 - \lVert (I - Q Q^T) r' \rVert^2

with the residuals r of the fit, r' with the effect, and Q an orthonormal basis of the fit's derivatives and priors. An
uncertain parameter is screened without the tolerance that holds it.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, EffectParameter, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.hypothesis import Hypothesis, is_size, searched_coordinates
from monitor_core.fitting.problem import prior_jacobian, prior_residuals
from monitor_core.fitting.solver.derivatives import derivative
from monitor_core.fitting.solver.hypothesis_fit import Fitted

N_STARTS = 2  # kept of all sizes and shapes that were tried


@dataclass(frozen=True, eq=False)
class Screened(Generic[Physics]):
    """An effect with what a refit with it would gain, and where such a refit should start."""

    effect: Effect[Physics]
    starts: tuple[FloatArray, ...]  # of a fit with the effect, most promising first, shape (n_coordinates,) each
    decrease: float  # of χ² at the first of them, the other coordinates refitted linearly
    score: float  # decrease of χ² that the slope at the null value predicts
    #: χ² per square of the first parameter's scale, the rest refitted: d' is its root times the size. For an effect
    #: that may resonate anywhere in the measured band, at the frequency where it is seen least.
    information: float
    elsewhere: FloatArray | None = None  # a start in another minimum, about which screening tells little

    @property
    def predicted_gain(self) -> float:
        """Decrease of χ² that the best size or the slope predicts."""
        return max(self.decrease, self.score)


#: Sizes in scales of the parameter.
_SIZES = (0.1, 0.4, 1.5, 6.0, 25.0, 100.0)
#: Natural frequencies show a mode only from nearby, and go with the root of a stiffness: closer sizes.
_SIZES_FOR_MODES = tuple(0.1 * 2.0**n for n in range(11))
#: Steps of ln ratio: each brings a mode into the reach of its measured frequency.
_RATIO_STEP = 0.5
_FREQUENCIES = 12  # of something that resonates, over the measured band
_PEAKS = 4  # of the misfit, where something may resonate, too
_BEYOND_BAND = 1.4  # a resonance outside the band still shows in it
#: Of the largest plausible frequency over the least: below it the description tells it, but for how ends are held.
_TOLD = 4.0
_BELOW_NULL, _FROM_NULL = 3, 8  # frequencies that are tried of such a one


def signed_ratios(parameter: EffectParameter) -> Iterator[float]:
    """Yield logarithms of ratios over the range of a parameter."""
    largest = max(-parameter.lower, parameter.upper)
    for ratio in np.arange(_RATIO_STEP, largest + _RATIO_STEP / 2.0, _RATIO_STEP).tolist():
        yield from (sign * ratio for sign in (1.0, -1.0) if parameter.lower <= sign * ratio <= parameter.upper)


def signed_sizes(effect: Effect[Physics], parameter: EffectParameter, *, has_lines: bool) -> Iterator[float]:
    """Yield the sizes at which a parameter is tried, in its scale."""
    low, high = searched_coordinates(effect, parameter)
    if effect.key.startswith(PREFIX) and not has_lines:
        yield from (ratio / parameter.scale for ratio in signed_ratios(parameter))
    for size in _SIZES if has_lines else _SIZES_FOR_MODES:
        if size <= high:
            yield size
        if -size >= low:
            yield -size


def measured_band(fitted: Fitted[Physics]) -> tuple[float, float]:
    """Return the lowest and highest measured frequency. [Hz]."""
    frequency = fitted.comparison.layout.frequency
    return float(np.nanmin(frequency)), float(np.nanmax(frequency))


def resonances(fitted: Fitted[Physics], parameter: EffectParameter) -> list[float]:
    """Return frequencies at which a resonance is tried, over the measured band and at peaks of the misfit. [Hz].

    One that the description tells is tried where it is told to be: it may be the first of many, and below the band.
    """
    if parameter.upper < _TOLD * parameter.lower:
        below = np.geomspace(parameter.lower, parameter.null, _BELOW_NULL)[:-1]
        return [*below.tolist(), *np.geomspace(parameter.null, parameter.upper, _FROM_NULL).tolist()]
    lowest, highest = measured_band(fitted)
    low, high = max(parameter.lower, lowest / _BEYOND_BAND), min(parameter.upper, highest * _BEYOND_BAND)
    peaks = [frequency for frequency in _peaks_of_misfit(fitted).tolist() if low <= frequency <= high]
    return [*np.geomspace(low, high, _FREQUENCIES).tolist(), *peaks]


def _peaks_of_misfit(fitted: Fitted[Physics]) -> FloatArray:
    """Return the frequencies at which most is left unexplained, all settings together. [Hz]."""
    frequency = fitted.comparison.layout.frequency
    chosen = fitted.fitted & np.isfinite(frequency)
    lines, index = np.unique(frequency[chosen], return_inverse=True)
    energy = np.bincount(index, weights=fitted.standardised[chosen] ** 2)
    padded = np.concatenate([[0.0], energy, [0.0]])
    peaks = np.flatnonzero((energy >= padded[:-2]) & (energy >= padded[2:]))
    return lines[peaks[np.argsort(energy[peaks])[::-1][:_PEAKS]]]


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


_RIDGE = 10.0  # of χ², between one minimum and another
_FINER_STEPS = (0.25, 0.125)  # of ln ratio, about the best: a coarse step may miss a narrow minimum


def screen_without_tolerance(
    fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics], index: int
) -> Screened[Physics]:
    """Screen an uncertain parameter without its tolerance: the residuals stay, its prior goes.

    ``effect`` calls the parameter wrong; ``index`` is its place among the uncertain ones.
    """
    decrease, of_one_deviation = projection.freed(index)
    parameter, hypothesis = effect.parameters[0], fitted.hypothesis
    spread = hypothesis.axis.uncertain[hypothesis.uncertain[index]]
    information = of_one_deviation * (parameter.scale / spread) ** 2
    here = projection.residuals(fitted.standardised)
    tried = [(decrease, fitted.coordinates)]

    def at_ratio(ratio: float) -> tuple[float, FloatArray]:
        trial = fitted.coordinates.copy()
        trial[index] = ratio / spread
        try:
            left = projection.residuals(fitted.around.residuals(hypothesis.physics(trial)))
        except OutsideValidityError:
            return -math.inf, trial
        return float(here @ here - left @ left), trial

    elsewhere: FloatArray | None = None
    if not has_lines(fitted.comparison.layout):
        far = [at_ratio(ratio) for ratio in sorted(signed_ratios(parameter))]
        elsewhere = _beyond_a_ridge(far, index, float(fitted.coordinates[index]))
        for step in _FINER_STEPS if far else ():
            nearest = spread * max(far, key=lambda pair: pair[0])[1][index]
            around = (nearest + step, nearest - step)
            far += [at_ratio(ratio) for ratio in around if parameter.lower <= ratio <= parameter.upper]
        tried += [pair for pair in far if math.isfinite(pair[0])]
    tried.sort(key=lambda pair: pair[0], reverse=True)
    with_effect = hypothesis.with_effect(effect)
    starts = tuple(with_effect.carried_over(hypothesis, coordinates) for _, coordinates in tried[:N_STARTS])
    apart = None if elsewhere is None else with_effect.carried_over(hypothesis, elsewhere)
    return Screened(effect, starts, tried[0][0], decrease, information, apart)


def _beyond_a_ridge(tried: Sequence[tuple[float, FloatArray]], index: int, at_fit: float) -> FloatArray | None:
    """Return the best of the coordinates that lie in another minimum than those of the fit; None if none does.

    Where a parameter brings another mode to a measured frequency, χ² falls again beyond a ridge. What screening finds
    there is still far from the data: a fit comes nearer. Where the model has no answer there is no ridge.
    """
    tried = [pair for pair in tried if math.isfinite(pair[0])]
    below = sorted((pair for pair in tried if pair[1][index] < at_fit), key=lambda pair: -pair[1][index])
    above = sorted((pair for pair in tried if pair[1][index] > at_fit), key=lambda pair: pair[1][index])
    beyond: list[tuple[float, FloatArray]] = []
    for side in (below, above):
        ridges = np.minimum.accumulate([decrease for decrease, _ in side])
        beyond += [pair for pair, ridge in zip(side, ridges, strict=True) if min(pair[0], 0.0) > ridge + _RIDGE]
    return max(beyond, key=lambda pair: pair[0])[1] if beyond else None


_FAR_STARTS = (0.4, 1.5, 6.0)  # in scales: where a gap is large, the most promising size may lead into a false minimum


def screen(
    fitted: Fitted[Physics],
    effects: Sequence[Effect[Physics]],
    progress: Callable[[str], None] = lambda _sentence: None,
) -> tuple[Screened[Physics], ...]:
    """Predict what each effect would gain from where a fit without them stands.

    Returned are those that have an answer somewhere, most promising first.
    """
    projection, screened = Projection(fitted), []
    for number, effect in enumerate(effects, 1):
        progress(f"screening {effect.key} ({number} of {len(effects)})")
        if (result := _screen_effect(fitted, projection, effect)) is not None:
            screened.append(result)
    return tuple(sorted(screened, key=lambda result: result.predicted_gain, reverse=True))


def _screen_effect(
    fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics]
) -> Screened[Physics] | None:
    parameter = effect.key.removeprefix(PREFIX)
    if effect.key.startswith(PREFIX) and parameter in fitted.hypothesis.uncertain:
        index = fitted.hypothesis.uncertain.index(parameter)
        return screen_without_tolerance(fitted, projection, effect, index)
    return _EffectTrials(fitted, projection, effect).best()


_MOST_WORSE = 2  # sizes one after the other that are worse than none, and than the one before


class _EffectTrials(Generic[Physics]):
    """An effect, tried at several sizes and shapes."""

    def __init__(self, fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics]) -> None:
        self.fitted, self.projection, self.effect = fitted, projection, effect
        self.hypothesis: Hypothesis[Physics] = fitted.hypothesis.with_effect(effect)
        self.at = self.hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
        self.tail = self.at.size - len(effect.parameters)
        self.here = projection.residuals(fitted.standardised)
        has_frequencies = np.any(np.isfinite(fitted.comparison.layout.frequency))
        parameter = effect.frequency if has_frequencies else None
        self.resonance = None if parameter is None else (effect.parameters.index(parameter), parameter)

    def best(self) -> Screened[Physics] | None:
        """Return the most promising size and shape; None where the model has no answer with the effect."""
        sizes = [index for index, parameter in enumerate(self.effect.parameters) if is_size(parameter)]
        slopes = [
            (shape, index, slope)
            for shape in self._shapes()
            for index in sizes
            if (slope := self._slope(shape, index)) is not None
        ]
        if not slopes:
            return None
        lines = has_lines(self.fitted.comparison.layout)
        tried, score = [(0.0, self.at)], 0.0
        for shape, index, slope in slopes:
            linear, gain = self._linear(slope, index)
            score = max(score, gain)
            if not np.any(slope):
                continue
            tried.append(self._tried(shape, index, linear))
            others = {*signed_sizes(self.effect, self.effect.parameters[index], has_lines=lines)} - {linear}
            for sign in (1.0, -1.0):
                outwards = sorted((size for size in others if sign * size > 0.0), key=abs)
                tried += self._outwards(shape, index, outwards, may_return=not lines)
        tried.sort(key=lambda trial: trial[0], reverse=True)
        starts = [coordinates for decrease, coordinates in tried[:N_STARTS] if np.isfinite(decrease)]
        best_shape, largest = tried[0][1][self.tail :], self._range(sizes[0])[1]
        starts += [self._sized(best_shape, sizes[0], size) for size in _FAR_STARTS if size <= largest]
        first = [(shape, float(slope @ slope)) for shape, index, slope in slopes if index == sizes[0]]
        seen = [information for shape, information in first if self._resonates_in_band(shape)]
        information = min(seen, default=max((information for _, information in first), default=0.0))
        return Screened(self.effect, tuple(starts), tried[0][0], score, information)

    def _outwards(
        self, shape: FloatArray, index: int, sizes: Sequence[float], *, may_return: bool
    ) -> Iterator[tuple[float, FloatArray]]:
        """Yield trials of rising sizes, until one after the other has only taken the model further from the data.

        A natural frequency that has left its measured one ``may_return`` to the next: then all are tried.
        """
        before, worse = 0.0, 0
        for size in sizes:
            trial = self._tried(shape, index, size)
            yield trial
            worse = worse + 1 if trial[0] <= min(before, 0.0) else 0
            before = trial[0]
            if worse == _MOST_WORSE and not may_return:
                return

    def _sized(self, shape: FloatArray, index: int, size: float | None = None) -> FloatArray:
        """Return the coordinates of the fit with the effect of a shape, and at a size where one is given."""
        trial = self.at.copy()
        trial[self.tail :] = shape
        if size is not None:
            trial[self.tail + index] = size
        return trial

    def _linear(self, slope: FloatArray, index: int) -> tuple[float, float]:
        """Return the size that the slope leads to, and the decrease of χ² that it predicts there."""
        square = float(slope @ slope)
        if square <= 0.0:
            return 0.0, 0.0
        low, high = self._range(index)
        along = float(slope @ self.here)
        size = float(np.clip(-along / square, low, high))
        return size, -size * (2.0 * along + size * square)

    def _range(self, index: int) -> tuple[float, float]:
        return searched_coordinates(self.effect, self.effect.parameters[index])

    def _shapes(self) -> Iterator[FloatArray]:
        """Yield coordinates of the effect, with a resonance put at frequencies over the band."""
        null = np.zeros(len(self.effect.parameters))
        if self.resonance is None:
            yield null
            return
        index, parameter = self.resonance
        for frequency in resonances(self.fitted, parameter):
            shape = null.copy()
            shape[index] = (frequency - parameter.null) / parameter.scale
            yield shape

    def _resonates_in_band(self, shape: FloatArray) -> bool:
        if self.resonance is None:
            return True
        index, parameter = self.resonance
        lowest, highest = measured_band(self.fitted)
        return bool(lowest <= parameter.null + parameter.scale * shape[index] <= highest)

    def _slope(self, shape: FloatArray, index: int) -> FloatArray | None:
        """Return the derivative by a size that is null, as far as nothing else can take it up."""
        trial, around = self._sized(shape, index), self.fitted.around
        try:
            self.hypothesis.physics(trial)
            # without a size the misfit is that of the fit, whatever the shape
            slope = derivative(around, self.hypothesis, trial, self.fitted.misfit, self.tail + index)
        except OutsideValidityError:
            return None
        return self.projection.direction(around.whitened_by(slope))

    def _tried(self, shape: FloatArray, index: int, size: float) -> tuple[float, FloatArray]:
        """Return the decrease of χ² at a size, and the coordinates there; −∞ where the model has no answer."""
        trial = self._sized(shape, index, size)
        try:
            standardised = self.fitted.around.residuals(self.hypothesis.physics(trial))
        except OutsideValidityError:
            return -np.inf, trial
        left = self.projection.residuals(standardised)
        trial[: self.tail] += self.projection.step(standardised)
        return float(self.here @ self.here - left @ left), trial
