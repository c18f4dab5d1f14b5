"""Compare what windows state twice: each pair is a row with what is stated, what is seen, and what follows."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from monitor_core.recording import Doubt, DoubtReason, Window

#: What two numbers in different units differ by, and the unit that one of them is in instead.
_UNITS = (
    (1e6, "10⁶, as of µm for m"),
    (1e3, "1000, as of mm for m, g for kg, or kHz for Hz"),
    (9.80665, "9.81, as of g for m/s², or kgf for N"),
    (2.0 * math.pi, "2π, as of turns for radians, or rad/s for Hz"),
    (60.0, "60, as of minutes for seconds, or 1/min for Hz"),
    (180.0 / math.pi, "57.3, as of degrees for radians"),
)
#: Two numbers of one quantity that were read apart agree to this, relative; 57.3 and 60 are 4.6 % apart [-].
_SAME = 0.02


def looks_like_unit(ratio: float, uncertainty: float = 0.0) -> str | None:
    """Return the unit that two numbers of one quantity look like having been mixed up, or ``None``.

    Their ratio with its relative standard uncertainty; a factor or its reciprocal is found, of either sign.

    Examples
    --------
    >>> looks_like_unit(0.001003)
    'a factor of 1000, as of mm for m, g for kg, or kHz for Hz'
    >>> looks_like_unit(1.4)

    """
    if not (math.isfinite(ratio) and ratio != 0.0):
        return None
    off, unit = min((abs(abs(math.log(abs(ratio))) - math.log(factor)), unit) for factor, unit in _UNITS)
    return f"a factor of {unit}" if off < _SAME + 2.0 * uncertainty else None


@dataclass(frozen=True, slots=True)
class StatedTwice:
    """A quantity that is stated in two ways, in one unit."""

    doubt: DoubtReason  # what a contradiction is called
    quantity: str  # what is stated, and what it is compared with
    stated: float
    seen: float
    tolerance: float  # a larger difference is a contradiction
    unit: str
    consequence: str  # what is done where they contradict

    @property
    def contradiction(self) -> Doubt | None:
        """The doubt in one sentence; ``None`` where the two agree."""
        if abs(self.stated - self.seen) <= self.tolerance:
            return None
        unit = looks_like_unit(self.stated / self.seen) if self.seen else None
        return Doubt(
            self.doubt,
            f"expected {self.quantity}, {self.seen:.4g} {self.unit} to within {self.tolerance:.2g} {self.unit}; got "
            f"{self.stated:.4g} {self.unit}{'' if unit is None else f', which looks like {unit}'}: {self.consequence}",
        )


@dataclass(frozen=True, slots=True, eq=False)
class CrossChecked:
    """The windows of a measurement as they are believed, and what in them contradicts itself."""

    windows: tuple[Window, ...]
    doubts: tuple[Doubt, ...] = ()


#: A position tag is rounded, and read off another scale than the trace [m]. It may mean any place of the travel.
_TAG_TOLERANCE = 0.003


def cross_checked(windows: Sequence[Window]) -> CrossChecked:
    """Compare what the windows of one measurement state twice; where they contradict themselves, say what is believed.

    A position trace is measured where a tag is typed: the mean of the trace is the position of a window whose tag lies
    off the travel.
    """
    rows = [_position(window) for window in windows]
    contradictions = [None if row is None else row.contradiction for row in rows]
    believed = tuple(
        window if row is None or found is None else _at(window, 1e-3 * row.seen)
        for window, row, found in zip(windows, rows, contradictions, strict=True)
    )
    first = next((found for found in contradictions if found is not None), None)
    return CrossChecked(believed, () if first is None else (first,))


def _position(window: Window) -> StatedTwice | None:
    """Compare position tag and trace; a trace that passes through zero counts from a start of its own, and is none."""
    trace, tag = window.position_trace, window.conditions.position
    if trace is None:
        return None
    low, high = float(trace.min()), float(trace.max())
    if low <= 0.0 <= high or low - _TAG_TOLERANCE <= tag <= high + _TAG_TOLERANCE:
        return None
    return StatedTwice(
        DoubtReason.POSITION_CONTRADICTS_TRACE,
        "the position tag where the position trace runs",
        1e3 * tag,
        1e3 * float(trace.mean()),
        1e3 * (0.5 * (high - low) + _TAG_TOLERANCE),
        "mm",
        "the trace is taken for the position",
    )


def _at(window: Window, position: float) -> Window:
    return replace(window, conditions=replace(window.conditions, position=position))
