r"""A cheap look at each effect from where a fit stands: a few sizes, everything else refitted linearly.

A score test looks at the slope where the effect is absent. That slope deceives where an effect makes a resonance, or
where the gap is large, so sizes over decades are tried as well; at each the other coordinates of the fit take up what
they can, which is a projection:

.. math::

    \Delta\chi^2 = \lVert r \rVert^2 - \lVert (I - Q Q^T) r' \rVert^2

with the residuals r of the fit, r' with the effect, and Q an orthonormal basis of the fit's derivatives and priors.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.hypothesis import Hypothesis, is_size, searched_coordinates
from monitor_core.fitting.solver.hypothesis_fit import Fitted, derivative

Physics = TypeVar("Physics")

#: Sizes in scales of the parameter.
_SIZES = (0.1, 0.4, 1.5, 6.0, 25.0, 100.0)
#: Natural frequencies tell of a mode only from nearby, and go with the root of a stiffness: closer sizes.
_SIZES_FOR_MODES = tuple(0.1 * 2.0**n for n in range(11))
#: Steps of ln ratio: one of them brings a mode into the reach of its measured frequency.
_RATIO_STEP = 0.5
_RIDGE = 10.0  # of χ², between one minimum and another
_FINER_STEPS = (0.25, 0.125)  # about the best of them: a coarse one may pass by a narrow minimum
_FREQUENCIES = 12  # of something that resonates, over the measured band
_STARTS = 2  # kept of all sizes and shapes that were tried
_FAR_STARTS = (0.4, 1.5, 6.0)  # in scales: where a gap is large, what looks promising may lead into a false minimum
_PEAKS = 4  # of the misfit, where something may resonate, too
_BEYOND_BAND = 1.4  # a resonance outside the band still shows in it


@dataclass(frozen=True, eq=False)
class Scanned(Generic[Physics]):
    """What a look at an effect promises."""

    effect: Effect[Physics]
    starts: tuple[FloatArray, ...]  # of a fit with the effect, most promising first, shape (n_coordinates,) each
    decrease: float  # of χ² at the first of them, the other coordinates refitted linearly
    score: float  # decrease that the slope at the null value promises
    #: χ² per square of the first parameter's scale, the rest refitted: d' is its root times the size. Of what may
    #: resonate anywhere in the measured band, where it is seen least.
    information: float
    elsewhere: FloatArray | None = None  # a start in another minimum, where looks tell little

    @property
    def promise(self) -> float:
        """Decrease of χ² that the best size or the slope promises."""
        return max(self.decrease, self.score)


class Projection:
    """The fit's own coordinates, but for those of one effect if it is left out, projected out of residuals."""

    def __init__(self, fitted: Fitted[Physics], without: Effect[Physics] | None = None) -> None:
        self._chosen = fitted.fitted
        self.n_coordinates = fitted.hypothesis.n_coordinates
        left_out = None if without is None else without.key
        unknowns = [effect.key != left_out for effect, _ in fitted.hypothesis.unknowns]
        kept = np.array([True] * fitted.hypothesis.n_uncertain + unknowns, dtype=np.bool_)
        self._prior_residuals = fitted.coordinates[: fitted.hypothesis.n_uncertain]
        prior = np.eye(self._prior_residuals.size, self.n_coordinates)
        stacked = np.vstack([fitted.jacobian[self._chosen], prior]) * kept
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
        """Return the decrease of χ² without the prior of an uncertain parameter, and what one deviation of it brings.

        A row of residual u and leverage h leaves a linear least-squares problem with u²/(1 − h) less; and a parameter
        one deviation off its prior has u = 1 − h.
        """
        row = self._basis[self._basis.shape[0] - self._prior_residuals.size + index]
        rest = max(1.0 - float(row @ row), 1e-12)
        return float(self._prior_residuals[index]) ** 2 / rest, rest

    def _left(self, values: FloatArray) -> FloatArray:
        return values - self._basis @ (self._basis.T @ values)


def scan(fitted: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> tuple[Scanned[Physics], ...]:
    """Look at each effect from where a fit stands.

    Parameters
    ----------
    fitted : Fitted
    effects : sequence of Effect
        None of them part of the fit.

    Returns
    -------
    tuple of Scanned
        Those that have an answer somewhere, most promising first.
    """
    projection = Projection(fitted)
    looks = [look for effect in effects if (look := _look(fitted, projection, effect)) is not None]
    return tuple(sorted(looks, key=lambda one: one.promise, reverse=True))


def _look(fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics]) -> Scanned[Physics] | None:
    uncertain = effect.key.removeprefix(PREFIX)
    if effect.key.startswith(PREFIX) and uncertain in fitted.hypothesis.uncertain:
        return _freed(fitted, projection, effect, fitted.hypothesis.uncertain.index(uncertain))
    return _Look(fitted, projection, effect).best()


def _freed(fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics], index: int) -> Scanned[Physics]:
    """Look at an uncertain parameter without the tolerance that holds it: the residuals stay, its prior goes."""
    decrease, of_one_deviation = projection.freed(index)
    one, hypothesis = effect.parameters[0], fitted.hypothesis
    spread = hypothesis.subject.uncertain[hypothesis.uncertain[index]]
    information = of_one_deviation * (one.scale / spread) ** 2
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
        far = [at_ratio(ratio) for ratio in sorted(_ratios(one))]
        elsewhere = _beyond_a_ridge(far, index, float(fitted.coordinates[index]))
        for step in _FINER_STEPS if far else ():
            nearest = spread * max(far, key=lambda pair: pair[0])[1][index]
            far += [at_ratio(nearest + way) for way in (step, -step) if one.lower <= nearest + way <= one.upper]
        tried += [pair for pair in far if math.isfinite(pair[0])]
    tried.sort(key=lambda pair: pair[0], reverse=True)
    with_effect = hypothesis.with_effect(effect)
    starts = tuple(with_effect.carried_over(hypothesis, at) for _, at in tried[:_STARTS])
    apart = None if elsewhere is None else with_effect.carried_over(hypothesis, elsewhere)
    return Scanned(effect, starts, tried[0][0], decrease, information, apart)


def _beyond_a_ridge(tried: Sequence[tuple[float, FloatArray]], index: int, at_fit: float) -> FloatArray | None:
    """Return the best of the coordinates that lie in another minimum than those of the fit; None if none does.

    Where a parameter brings another mode to a measured frequency, χ² falls again beyond a ridge. What a look finds
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


def _ratios(one: EffectParameter) -> Iterator[float]:
    """Yield logarithms of ratios over the range of a parameter."""
    for ratio in np.arange(_RATIO_STEP, max(-one.lower, one.upper) + _RATIO_STEP / 2.0, _RATIO_STEP).tolist():
        yield from (sign * ratio for sign in (1.0, -1.0) if one.lower <= sign * ratio <= one.upper)


class _Look(Generic[Physics]):
    """One effect, tried at several sizes and shapes."""

    def __init__(self, fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics]) -> None:
        self.fitted, self.projection, self.effect = fitted, projection, effect
        self.hypothesis: Hypothesis[Physics] = fitted.hypothesis.with_effect(effect)
        self.at = self.hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
        self.tail = self.at.size - len(effect.parameters)
        self.here = projection.residuals(fitted.standardised)
        lines = np.any(np.isfinite(fitted.comparison.layout.frequency))
        one = effect.frequency if lines else None
        self.resonance = None if one is None else (effect.parameters.index(one), one)

    def best(self) -> Scanned[Physics] | None:
        """Return the most promising size and shape; None where the model has no answer with the effect."""
        sizes = [index for index, one in enumerate(self.effect.parameters) if is_size(one)]
        slopes = [
            (shape, index, slope)
            for shape in self._shapes()
            for index in sizes
            if (slope := self._slope(shape, index)) is not None
        ]
        if not slopes:
            return None
        tried, score = [(0.0, self.at)], 0.0
        for shape, index, slope in slopes:
            linear, gain = self._linear(slope, index)
            score = max(score, gain)
            sizes_tried = dict.fromkeys((linear, *self._sizes(index))) if np.any(slope) else ()
            tried += [self._tried(shape, index, size) for size in sizes_tried]
        tried.sort(key=lambda one: one[0], reverse=True)
        starts = [coordinates for decrease, coordinates in tried[:_STARTS] if np.isfinite(decrease)]
        starts += [self._sized(tried[0][1], sizes[0], size) for size in _FAR_STARTS if size <= self._range(sizes[0])[1]]
        first = [(shape, float(slope @ slope)) for shape, index, slope in slopes if index == sizes[0]]
        seen = [information for shape, information in first if self._resonates_in_band(shape)]
        information = min(seen, default=max((one for _, one in first), default=0.0))
        return Scanned(self.effect, tuple(starts), tried[0][0], score, information)

    def _sized(self, best: FloatArray, index: int, size: float) -> FloatArray:
        """Return the coordinates of the fit with the effect at a size, of the shape that was best."""
        trial = self.at.copy()
        trial[self.tail :] = best[self.tail :]
        trial[self.tail + index] = size
        return trial

    def _linear(self, slope: FloatArray, index: int) -> tuple[float, float]:
        """Return the size that the slope leads to, and the decrease of χ² that it promises there."""
        square = float(slope @ slope)
        if square <= 0.0:
            return 0.0, 0.0
        low, high = self._range(index)
        along = float(slope @ self.here)
        size = float(np.clip(-along / square, low, high))
        return size, -size * (2.0 * along + size * square)

    def _range(self, index: int) -> tuple[float, float]:
        return searched_coordinates(self.effect, self.effect.parameters[index])

    def _sizes(self, index: int) -> Iterator[float]:
        low, high = self._range(index)
        one = self.effect.parameters[index]
        lines = has_lines(self.fitted.comparison.layout)
        if self.effect.key.startswith(PREFIX) and not lines:
            yield from (ratio / one.scale for ratio in _ratios(one))
        for size in _SIZES if lines else _SIZES_FOR_MODES:
            if size <= high:
                yield size
            if -size >= low:
                yield -size

    def _shapes(self) -> Iterator[FloatArray]:
        """Yield coordinates of the effect with what resonates put at frequencies over the band."""
        null = np.zeros(len(self.effect.parameters))
        if self.resonance is None:
            yield null
            return
        index, one = self.resonance
        lowest, highest = self._band
        low, high = max(one.lower, lowest / _BEYOND_BAND), min(one.upper, highest * _BEYOND_BAND)
        peaks = [value for value in self._peaks_of_misfit() if low <= value <= high]
        for value in [*np.geomspace(low, high, _FREQUENCIES).tolist(), *peaks]:
            shape = null.copy()
            shape[index] = (value - one.null) / one.scale
            yield shape

    def _resonates_in_band(self, shape: FloatArray) -> bool:
        if self.resonance is None:
            return True
        index, one = self.resonance
        return bool(self._band[0] <= one.null + one.scale * shape[index] <= self._band[1])

    @property
    def _band(self) -> tuple[float, float]:
        """Lowest and highest measured frequency. [Hz]."""
        frequency = self.fitted.comparison.layout.frequency
        return float(np.nanmin(frequency)), float(np.nanmax(frequency))

    def _peaks_of_misfit(self) -> list[float]:
        """Return the frequencies at which most is left unexplained, all settings together. [Hz]."""
        frequency = self.fitted.comparison.layout.frequency
        chosen = self.fitted.fitted & np.isfinite(frequency)
        lines, index = np.unique(frequency[chosen], return_inverse=True)
        energy = np.bincount(index, weights=self.fitted.standardised[chosen] ** 2)
        padded = np.concatenate([[0.0], energy, [0.0]])
        peaks = np.flatnonzero((energy >= padded[:-2]) & (energy >= padded[2:]))
        highest = peaks[np.argsort(energy[peaks])[::-1][:_PEAKS]]
        return [float(one) for one in lines[highest]]

    def _slope(self, shape: FloatArray, index: int) -> FloatArray | None:
        """Return the derivative by a size that is null, as far as nothing else can take it up."""
        trial = self.at.copy()
        trial[self.tail :] = shape
        around = self.fitted.around
        try:
            misfit = around.misfit(self.hypothesis.physics(trial))
            slope = derivative(around, self.hypothesis, trial, misfit, self.tail + index)
        except OutsideValidityError:
            return None
        return self.projection.direction(around.whitened_by(slope))

    def _tried(self, shape: FloatArray, index: int, size: float) -> tuple[float, FloatArray]:
        """Return the decrease of χ² at a size, and the coordinates there; −∞ where the model has no answer."""
        trial = self.at.copy()
        trial[self.tail :] = shape
        trial[self.tail + index] = size
        try:
            standardised = self.fitted.around.residuals(self.hypothesis.physics(trial))
        except OutsideValidityError:
            return -np.inf, trial
        left = self.projection.residuals(standardised)
        trial[: self.tail] += self.projection.step(standardised)
        return float(self.here @ self.here - left @ left), trial
