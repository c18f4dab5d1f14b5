"""Compare the places of one session: the preload of an axis is one, wherever it is measured."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import scipy

from monitor_core.preload.doubts import Doubt, DoubtReason

#: Positions closer than this are one place [m].
_ONE_PLACE = 0.02
#: Probability at which the places of an unchanged axis are said to disagree.
_DISAGREEMENT = 1e-3


@dataclass(frozen=True, slots=True)
class PlaceReading:
    """What the measurements of one session are compared by."""

    position: float  # [m]
    logarithm: float  # ln(preload) [-]
    standard_uncertainty: float  # of it, new in each measurement [-]


@dataclass(frozen=True, slots=True)
class Places:
    """The measurements of one session, as far as they came, summed up."""

    count: int = 0
    weight: float = 0.0  # sum of the reciprocal variances [-]
    mean: float = 0.0  # of ln(preload), weighted [-]
    chi_square: float = 0.0  # of the deviations from it [-]
    nearest: float = 0.0  # position from the fixed bearing [m]
    farthest: float = 0.0
    lowest: float = 0.0  # ln(preload) [-]
    highest: float = 0.0

    def with_reading(self, reading: PlaceReading) -> "Places":
        """Return the sums with one more measurement (weighted mean and squares: West, Comm. ACM 22 (1979) 532–535)."""
        x, y = reading.position, reading.logarithm
        if not reading.standard_uncertainty > 0.0:  # it states no uncertainty: nothing is compared with it
            return self
        own = reading.standard_uncertainty**-2.0
        weight = self.weight + own
        mean = self.mean + (y - self.mean) * own / weight
        first = self.count == 0
        return Places(
            self.count + 1,
            weight,
            mean,
            self.chi_square + own * (y - self.mean) * (y - mean),
            x if first else min(self.nearest, x),
            x if first else max(self.farthest, x),
            y if first else min(self.lowest, y),
            y if first else max(self.highest, y),
        )

    @property
    def disagreement(self) -> Doubt | None:
        """The doubt about a session whose places contradict each other.

        The scatter of ln(preload) about its mean is tested by χ² with the stated uncertainties; ``None`` where fewer
        than two places were measured or they agree.
        """
        if self.count < 2 or self.farthest - self.nearest < _ONE_PLACE:
            return None
        if float(scipy.special.chdtrc(self.count - 1, self.chi_square)) > _DISAGREEMENT:
            return None
        return Doubt(
            DoubtReason.PLACES_DISAGREE,
            f"the places of one session give {math.exp(self.lowest):.0f} to {math.exp(self.highest):.0f} N where their "
            f"uncertainties allow {100.0 * (self.weight / self.count) ** -0.5:.1f} %: are the positions right, and "
            "counted from the fixed bearing?",
        )


def places_disagree(readings: Sequence[PlaceReading]) -> Doubt | None:
    """Test whether the places of one session contradict each other; the preload of an axis is one."""
    places = Places()
    for reading in readings:
        places = places.with_reading(reading)
    return places.disagreement
