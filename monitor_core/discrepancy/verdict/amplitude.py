"""Ask whether there were enough levels of excitation to tell what goes with the amplitude from another law of it.

At one level a nut that gives way under load is a softer nut. At two, a cubic stiffness, a play and a contact that opens
give the same two stiffnesses, and friction may stand in for a part of it: the third level tells which law it is.
"""

from typing import Final

import numpy as np

from monitor_core.effects import PREFIX
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import has_lines, levels_of

#: What may be there in the place of an effect at fewer levels than these: its key, for it is none of the catalogue.
AMPLITUDE_LAW: Final = "amplitude-law"
_ENOUGH_LEVELS = 3
#: Levels that are nearer to each other, as a ratio, are one.
_ANOTHER_LEVEL = 1.5
#: What a nut that goes with the amplitude is where the excitation does not vary.
_SOFTER_NUT = f"{PREFIX}nut_stiffness_n_per_m"


def n_levels(layout: Layout) -> int:
    """Return at how many levels of excitation was measured; what is not stated is one."""
    stated = levels_of(layout, ConditionAxis.LEVEL)
    known = np.sort(np.abs(stated[np.isfinite(stated) & (stated != 0.0)]))
    levels, last = 0, 0.0
    for level in known.tolist():
        if level > _ANOTHER_LEVEL * last:
            levels, last = levels + 1, level
    return max(levels, 1)


def law_not_told_from(effect: Effect[Physics], layout: Layout) -> str:
    """Return the key of the law that such data cannot tell from an effect; empty where they can.

    Of natural frequencies alone it is empty: of what level they are, a table does not say.
    """
    is_of_amplitude = ConditionAxis.LEVEL in effect.needs or effect.key == _SOFTER_NUT
    few = has_lines(layout) and n_levels(layout) < _ENOUGH_LEVELS
    return AMPLITUDE_LAW if few and is_of_amplitude else ""
