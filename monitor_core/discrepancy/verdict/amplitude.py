"""Ask whether there were enough levels of excitation to tell what goes with the amplitude from another law of it.

At one level a nut that gives way under load is a softer nut. At two, a cubic stiffness, a play and a contact that opens
give the same two stiffnesses, and friction may stand in for a part of it: the third level tells which law it is, if
the effect is large enough for the laws to differ there.
"""

from collections.abc import Collection
from typing import Final

import numpy as np

from monitor_core.effects import PREFIX
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import has_lines, levels_of
from monitor_core.fitting.evidence import VERY_STRONG

#: What may be there in the place of an effect at fewer levels than these: its key, for it is none of the catalogue.
AMPLITUDE_LAW: Final = "amplitude-law"
_ENOUGH_LEVELS = 3
#: Levels that are nearer to each other, as a ratio, are one.
_ANOTHER_LEVEL = 1.5
#: Of what an effect does to the data, what another law does otherwise (choices): within the responses where it agrees
#: at one or two levels, and at the third.
_WITHIN_RESPONSES, _AT_THIRD_LEVEL = 0.1, 0.2
#: What a nut that goes with the amplitude passes for: at one or two levels it is a softer one, at one it follows the
#: preload, too, since a stiffer nut is deflected less.
WRONG_NUT_STIFFNESS, PRELOAD_EXPONENT = f"{PREFIX}nut_stiffness_n_per_m", "preload-exponent"


def n_levels(layout: Layout) -> int:
    """Return at how many levels of excitation was measured; settings without one do not count, and 1 if none has one.

    Any difference lets an effect be tested (``varied_conditions``); to tell laws from each other levels must be apart.
    """
    stated = levels_of(layout, ConditionAxis.LEVEL)
    known = np.sort(stated[stated > 0.0])
    levels, last = 0, 0.0
    for level in known.tolist():
        if level > _ANOTHER_LEVEL * last:
            levels, last = levels + 1, level
    return max(levels, 1)


def indistinguishable_law(effect: Effect[Physics], gain: float, layout: Layout) -> str:
    r"""Return the key of the law that such data cannot tell from an effect; empty where they can.

    ================================  ===============  =====================================
    effect                            is left open at  unless
    ================================  ===============  =====================================
    what goes with the amplitude      1 level          –
    what goes with the amplitude      2 levels         :math:`\epsilon^2 G` is very strong evidence
    what goes with the amplitude      3 and more       the same, with ε = 0.2
    another stiffness of the nut      1 or 2 levels    –
    another exponent of the preload   1 level          :math:`\epsilon^2 G` is very strong evidence
    ================================  ===============  =====================================

    G is the ``gain``, the ΔBIC of the effect. Another law that agrees where it was measured differs within the
    responses, whose amplitude goes with the frequency, by a share ε = 0.1 of what the effect does (a choice): of that
    the data would show :math:`\epsilon^2 G`. Of natural frequencies alone it is empty: a table does not say at which
    level they are.
    """
    levels = n_levels(layout)
    if not has_lines(layout):
        return ""
    if goes_with_amplitude(effect):
        apart = _AT_THIRD_LEVEL if levels >= _ENOUGH_LEVELS else _WITHIN_RESPONSES
        is_open = levels == 1 or not _shows(apart, gain)
    elif effect.key == WRONG_NUT_STIFFNESS:
        is_open = levels < _ENOUGH_LEVELS
    else:
        is_open = effect.key == PRELOAD_EXPONENT and levels == 1 and not _shows(_WITHIN_RESPONSES, gain)
    return AMPLITUDE_LAW if is_open else ""


def rests_on_levels_of(effect: Effect[Physics], layout: Layout, wrong: Collection[int]) -> bool:
    """Return whether a record was taken out that tells the law of the amplitude; ``wrong`` are settings, from 0.

    That is one at another level of excitation than most. What stands out there from one law may be right by another.
    """
    levels = levels_of(layout, ConditionAxis.LEVEL)
    stated = levels[levels > 0.0]
    if not (goes_with_amplitude(effect) and stated.size):
        return False
    usual = float(np.median(stated))
    here = levels[[index for index in sorted(wrong) if levels[index] > 0.0]]
    return bool(np.any(np.maximum(here / usual, usual / here) > _ANOTHER_LEVEL))


def _shows(apart: float, gain: float) -> bool:
    """Return whether data show what is a share ``apart`` of what they show with a gain of BIC."""
    return apart**2 * gain >= VERY_STRONG


def goes_with_amplitude(effect: Effect[Physics]) -> bool:
    """Return whether an effect changes with the level of the excitation."""
    return ConditionAxis.LEVEL in effect.needs
