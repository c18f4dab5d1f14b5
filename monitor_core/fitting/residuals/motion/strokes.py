"""Cut a motion into strokes, each from one reversal to the next."""

from collections.abc import Sequence

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Setting
from monitor_core.fitting.conditions.groups import Indices

#: A way back that is shorter is a hesitation and no reversal, as a share of the whole way.
_HESITATION = 0.01


def strokes_of(position: FloatArray) -> tuple[Indices, tuple[int, ...]]:
    """Cut a motion at its reversals: the first value of each stroke, and its direction.

    The first stroke begins with value 0. A direction is +1 towards higher positions, −1 towards lower ones.
    """
    shortest = _HESITATION * float(np.ptp(position))
    first, directions, furthest = [0], [0], 0
    for now, at in enumerate(position.tolist()):
        way = at - float(position[furthest])
        if way * directions[-1] > 0.0:
            furthest = now
        elif abs(way) > shortest:
            direction = 1 if way > 0.0 else -1
            if directions == [0]:  # what comes before the first stroke belongs to it
                directions = [direction]
            else:
                first.append(furthest)
                directions.append(direction)
            furthest = now
    return np.array(first, dtype=np.intp), tuple(directions)


def stroke_settings(time: FloatArray, first: Indices, directions: Sequence[int]) -> tuple[Setting, ...]:
    """Return each stroke as a setting: a stretch of time [s] and a direction."""
    last = np.r_[first[1:], time.size] - 1
    return tuple(
        Setting(
            f"stroke {number} ({time[start]:.3g} s to {time[stop]:.3g} s)", {ConditionAxis.DIRECTION: float(direction)}
        )
        for number, (start, stop, direction) in enumerate(zip(first, last, directions, strict=True), 1)
    )
