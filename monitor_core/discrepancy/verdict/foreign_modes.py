"""Find effects that natural frequencies alone cannot exclude: modes that the drive has no part in."""

from collections.abc import Sequence

import numpy as np

from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.conditions.groups import modes_that_stay
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: A frequency that is off by more, in ln f, is of a mode that the model has not.
_ANOTHER_MODE = 0.25


def foreign_modes(without: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> tuple[str, ...]:
    """Return the keys of effects that may have made a mode which a fit lacks, and which only responses would show.

    Such a mode stays at one frequency under all conditions. What resonates there by itself moves no mode of the drive.
    """
    layout = without.comparison.layout
    frequencies = []
    for channel in modes_that_stay(layout):
        at = without.fitted & (layout.channel == channel)
        if np.any(at) and np.min(np.abs(without.misfit[at])) > _ANOTHER_MODE:
            frequencies.append(float(np.exp(np.mean(np.log(layout.frequency[at])))))
    return tuple(
        effect.key for effect in effects if any(_may_hide_at(effect, frequency, without) for frequency in frequencies)
    )


def _may_hide_at(effect: Effect[Physics], frequency: float, without: Fitted[Physics]) -> bool:
    """Return whether an effect resonates at a frequency and moves no other, so that no measurement shows it."""
    resonance = effect.frequency
    if resonance is None or not resonance.lower <= frequency <= resonance.upper:
        return False
    if not effect.applies(without.physics()):
        return False
    hypothesis = without.hypothesis.with_effect(effect)
    there = hypothesis.carried_over(without.hypothesis, without.coordinates)
    of_effect = there[there.size - len(effect.parameters) :]
    of_effect[0] = 1.0
    of_effect[effect.parameters.index(resonance)] = (frequency - resonance.null) / resonance.scale
    return np.array_equal(without.around.misfit(hypothesis.physics(there)), without.misfit)
