"""What natural frequencies alone cannot exclude: a mode that the drive has no part in."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from scipy import special

from monitor_core.discrepancy.comparing.condition_groups import has_lines
from monitor_core.discrepancy.effect import ConditionAxis, Effect
from monitor_core.discrepancy.searching.fit import Fitted
from monitor_core.discrepancy.searching.scan import resonance_of

Physics = TypeVar("Physics")

#: A frequency that is off by more, in ln f, is of a mode that the model has not.
_ANOTHER_MODE = 0.25
#: Of modes that stay where they are, the share whose frequencies scatter by no more than is taken for scatter.
_LEVEL = 0.99


def modes_of_their_own(without: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> tuple[str, ...]:
    """Return the keys of effects that may have made a mode which a fit has not, and which only responses would show.

    Such a mode stays at one frequency under all conditions, as far as it was measured. Whether base, structure or
    something of the drive makes it, its frequency does not tell.

    Parameters
    ----------
    without : Fitted
        The fit that lacks the mode.
    effects : sequence of Effect
        Whatever the axis may lack.
    """
    layout, found = without.comparison.layout, dict[str, None]()
    if has_lines(layout):
        return ()
    for channel in range(len(layout.channels)):
        at = without.fitted & (layout.channel == channel) & np.isfinite(layout.frequency)
        if np.count_nonzero(at) < 2 or np.min(np.abs(without.misfit[at])) < _ANOTHER_MODE:
            continue
        weight = layout.standard_deviation[at] ** -2.0
        logarithm = np.log(layout.frequency[at])
        mean = np.average(logarithm, weights=weight)
        if weight @ (logarithm - mean) ** 2 > special.chdtri(logarithm.size - 1, 1.0 - _LEVEL):
            continue
        for effect in effects:
            resonance = resonance_of(effect) if ConditionAxis.FREQUENCY in effect.needs else None
            if resonance is not None and resonance[1].lower <= np.exp(mean) <= resonance[1].upper:
                found[effect.key] = None
    return tuple(found)
