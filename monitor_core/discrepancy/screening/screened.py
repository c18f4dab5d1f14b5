"""Record what the screening of an effect predicts."""

from dataclasses import dataclass
from typing import Generic

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Effect, Physics

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
