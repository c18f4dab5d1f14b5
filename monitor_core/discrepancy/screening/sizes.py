"""Choose the sizes, ratios and frequencies at which an effect is tried.

What the screening of an effect predicts at them is recorded here, too.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, EffectParameter, Physics
from monitor_core.fitting.hypothesis import searched_coordinates
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
