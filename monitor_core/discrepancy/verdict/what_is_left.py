"""Say what would tell what nothing explains, by where it lies: a record, a band, a position, a channel, a level.

Each check is one sentence with a quantity of this machine; what is cheapest to look at comes first.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from monitor_core.discrepancy.localisation.localise import narrow
from monitor_core.effects.effect import ConditionAxis, Physics
from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import Grouping, groupings, has_lines, levels_of
from monitor_core.fitting.conditions.settings import known_mass, varied_conditions
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: A record stands out by more than any of a hundred right ones would. [standard deviations]
_STANDS_OUT = 4.0
#: Variance of what settings are pulled by, from which on they drift, as in the verdict. [-]
_DRIFTS = 3.0
#: Of the misfit of a channel, in squares: more in its mean alone is a constant factor. [-]
_IN_THE_MEAN = 0.8
#: A line in a quarter of the half-power width of a peak of 2 % damping. [of its frequency]
_LINE_SPACING = 0.01
_BANDS = 24


def checks_of_what_is_left(fitted: Fitted[Physics], sizes: MachineSizes | None) -> tuple[str, ...]:
    """Return what to check or repeat, cheapest first; never empty."""
    return tuple(_checks(fitted, sizes))


def plain(value: float, digits: int = 3) -> str:
    """Return a number with so many digits and without a power of ten, where one can read it so."""
    return f"{float(f'{value:.{digits}g}'):g}"


def _checks(fitted: Fitted[Physics], sizes: MachineSizes | None) -> Iterator[str]:
    layout = fitted.comparison.layout
    yield from _record_that_stands_out(fitted)
    yield from _constant_factor(fitted)
    every = np.ones(layout.n_values, dtype=np.bool_)
    ways = groupings(layout, _BANDS)
    chosen = narrow(ways, fitted.standardised**2, every)
    for index, groups in chosen.items():
        yield from _closer_look(ways[index], groups, fitted, sizes)
    if not any(ConditionAxis.POSITION in setting.values for setting in layout.settings):
        yield from _another_motion(sizes)
    elif ConditionAxis.LEVEL not in varied_conditions(layout) and has_lines(layout):
        yield (
            f"measure {layout.settings[0].name} at a third of the excitation, too: what then changes depends on the "
            "amplitude, as friction and play do"
        )
    yield (
        f"repeat {layout.settings[0].name}, the first that was measured, in the middle and at the end: what differs is "
        "a drift, and no model has it"
    )


def _record_that_stands_out(fitted: Fitted[Physics]) -> Iterator[str]:
    """Yield which tag to check: of the setting that is pulled most, or of all where they drift."""
    settings, names = fitted.comparison.layout.settings, fitted.comparison.condition_error_names
    if not names:
        return
    pulls = np.abs(np.nan_to_num(fitted.around.whitened_by.pulls(fitted.misfit)))
    setting, kind = (int(place) for place in np.unravel_index(np.argmax(pulls), pulls.shape))
    others = float(np.median(pulls[:, kind]))
    if pulls[setting, kind] > _STANDS_OUT * max(1.0, others):
        yield (
            f"check the tag of {settings[setting].name}: its {_tag(names[kind])} would have to be "
            f"{plain(pulls[setting, kind], 2)} of its standard deviations from what is stated, where others have "
            f"{plain(others, 1)}"
        )
    elif (spread := float(np.var(pulls[:, kind]))) > _DRIFTS:
        yield (
            f"read the {_tag(names[kind])} of every record again, first that of {settings[setting].name}: they "
            f"scatter {plain(math.sqrt(spread), 2)} times as much as is stated"
        )


def _tag(error: str) -> str:
    """Return what an error is called: "gain 2" is that of a channel."""
    return f"gain (channel {error.removeprefix('gain ')})" if error.startswith("gain") else error


def _constant_factor(fitted: Fitted[Physics]) -> Iterator[str]:
    """Yield the channel whose amplitude is off by one factor at all frequencies: a unit, a gain, a wrong side."""
    layout = fitted.comparison.layout
    if not has_lines(layout):
        return
    for channel, name in enumerate(layout.channels):
        at = (layout.channel == channel) & np.isinf(layout.period)  # a phase is known but for whole turns
        if not np.any(at):
            continue
        weight = layout.standard_deviation[at] ** -2.0
        mean = float(np.average(fitted.misfit[at], weights=weight))
        if mean**2 * np.sum(weight) > _IN_THE_MEAN * np.sum(weight * fitted.misfit[at] ** 2) and abs(mean) > 0.0:
            low, high = np.min(layout.frequency[at]), np.max(layout.frequency[at])
            yield (
                f"check unit and gain of {name}: it is {plain(math.exp(-mean))} times the model's from {plain(low)} to "
                f"{plain(high)} Hz alike"
            )


def _closer_look(
    grouping: Grouping, groups: Sequence[int], fitted: Fitted[Physics], sizes: MachineSizes | None
) -> Iterator[str]:
    """Yield what would tell more of a place that holds the misfit."""
    layout = fitted.comparison.layout
    lowest, highest = grouping.lowest[groups[0]], grouping.highest[groups[-1]]
    match grouping.axis:
        case ConditionAxis.FREQUENCY if has_lines(layout):
            low, high = float(lowest), float(highest)
            yield (
                "put a second accelerometer elsewhere, on the bed, the nut or a cover, and measure from "
                f"{plain(0.8 * low)} to {plain(1.2 * high)} Hz with lines at most {plain(_LINE_SPACING * low, 2)} Hz "
                "apart: a peak that stays there at all positions is of what swings by itself, one that wanders is of "
                "the drive"
            )
        case ConditionAxis.FREQUENCY:
            yield f"measure whole responses about {lowest} Hz: one frequency does not say what its mode moves"
        case ConditionAxis.POSITION:
            yield _finer_positions(layout, lowest, highest, sizes)
        case ConditionAxis.PRELOAD:
            yield f"measure more preloads about {lowest} to {highest} N, one of them twice, newly set each time"
        case ConditionAxis.PAYLOAD:
            yield f"weigh what is on the table at {highest} kg, and measure without and with half of it"
        case ConditionAxis.TEMPERATURE:
            yield f"measure {highest} K warmer and cold again: what does not come back is no temperature"
        case ConditionAxis.LEVEL:
            yield f"measure {layout.settings[0].name} at levels of {lowest} to {highest} and two between them"
        case None:
            yield (
                f"measure {layout.settings[0].name} again with another sensor and cable for "
                f"{lowest.strip(chr(34))}, which alone holds most of what is left"
            )


def _finer_positions(layout: Layout, lowest: str, highest: str, sizes: MachineSizes | None) -> str:
    positions = np.unique(levels_of(layout, ConditionAxis.POSITION))
    spacing = min(
        (1e3 * (after - before) for before, after in pairwise(positions[np.isfinite(positions)])), default=0.0
    )
    length = None if sizes is None else sizes.values.get(Reference.LENGTH)
    step = 0.5 * spacing or (25.0 * length if length else 10.0)
    where = f"about {lowest} mm" if lowest == highest else f"between {lowest} and {highest} mm"
    return (
        f"measure {where} in steps of {plain(step, 2)} mm, and at three positions within one turn of the screw: what "
        "comes and goes with the turn is of the thread"
    )


def _another_motion(sizes: MachineSizes | None) -> Iterator[str]:
    """Yield what else to do with a rigid axis in motion."""
    values = {} if sizes is None else sizes.values
    speed, mass = values.get(Reference.VELOCITY), values.get(Reference.MOVING_MASS)
    if speed is not None:
        yield (
            f"repeat the motion forward and backward at half and at twice the speed, {plain(0.5 * speed, 2)} and "
            f"{plain(2.0 * speed, 2)} m/s: friction goes with speed and direction, a mass with the acceleration alone"
        )
    if mass is not None:
        yield f"measure it with a known mass of {known_mass(mass):g} kg on the table, too"
