"""Group the values of a comparison by what they have in common: a band, a position, a preload, a direction."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.comparison import Layout

Indices = npt.NDArray[np.intp]


class Dimension(StrEnum):
    """What a part of the data extends over."""

    POSITION = "position"
    PRELOAD = "preload"
    PAYLOAD = "payload"
    TEMPERATURE = "temperature"
    LEVEL = "excitation level"
    DIRECTION = "direction"
    RECORD = "record"
    BAND = "band"
    MODE = "mode"
    CHANNEL = "channel"
    SETTINGS = "settings"  # one after the other, as those of a motion record follow in time


CONDITIONS = tuple(axis for axis in ConditionAxis if axis is not ConditionAxis.FREQUENCY)
_OF_FREQUENCY = frozenset({Dimension.BAND, Dimension.MODE})
_WITHOUT_ORDER = frozenset({Dimension.DIRECTION, Dimension.RECORD, Dimension.CHANNEL, Dimension.SETTINGS})
#: More levels than these are put together with their neighbours.
_MOST_LEVELS = 12
#: With fewer values with a frequency in a setting and channel they are natural frequencies and not lines of a response.
_FEWEST_LINES = 8
#: Natural frequencies this much further up, relatively, belong to another mode.
_NEXT_MODE = 1.2
#: With fewer positions a mode may seem to stay where it is by chance.
_FEWEST_POSITIONS = 3
#: Of modes that stay where they are, the share whose frequencies scatter by no more than is taken for scatter.
_SCATTER = 0.99


@dataclass(frozen=True, slots=True)
class Extent:
    """A part of the data: a range of a condition or of frequency, or channels, directions, records or settings."""

    dimension: Dimension
    numbers: tuple[float, ...] = ()  # both ends of a range, or each direction or record; SI
    names: tuple[str, ...] = ()  # each channel, or the first and the last of the settings


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """One way to group values; groups count from 0 in the order of the dimension."""

    dimension: Dimension
    group: Indices  # of each value, −1 where the dimension is not stated, shape (n_values,)
    parts: tuple[Extent, ...]  # each group

    @property
    def n_groups(self) -> int:
        """How many groups there are."""
        return len(self.parts)

    @property
    def axis(self) -> ConditionAxis | None:
        """Which condition it is, or frequency; None for channels and settings."""
        if self.dimension in _OF_FREQUENCY:
            return ConditionAxis.FREQUENCY
        return None if self.dimension in (Dimension.CHANNEL, Dimension.SETTINGS) else ConditionAxis(self.dimension)

    @property
    def ordered(self) -> bool:
        """Whether neighbouring groups make a range."""
        return self.dimension not in _WITHOUT_ORDER

    def holds(self, groups: Sequence[int]) -> BoolArray:
        """Return which values are in one of the groups, shape (n_values,)."""
        return np.isin(self.group, groups)

    def extent(self, groups: Sequence[int]) -> Extent:
        """Return the groups together."""
        parts = [self.parts[group] for group in groups]
        if self.ordered:
            return Extent(self.dimension, (parts[0].numbers[0], parts[-1].numbers[-1]))
        numbers = tuple(number for part in parts for number in part.numbers)
        names = tuple(name for part in parts for name in part.names)
        return Extent(self.dimension, numbers, names)

    def sums(self, values: FloatArray, of: BoolArray) -> FloatArray:
        """Return the sums of the chosen values over the groups, shape (n_groups,)."""
        stated = of & (self.group >= 0)
        sums = np.bincount(self.group[stated], weights=values[stated], minlength=self.n_groups)
        return np.asarray(sums, dtype=np.float64)


def groupings(layout: Layout, n_bands: int) -> tuple[Grouping, ...]:
    """Return every grouping with at least two groups: conditions, channels, and modes or so many logarithmic bands."""
    groups = [by_condition(layout, axis) for axis in CONDITIONS]
    groups += [_by_channel(layout), by_frequency(layout, n_bands)]
    return tuple(grouping for grouping in groups if grouping is not None and grouping.n_groups > 1)


def by_frequency(layout: Layout, n_bands: int) -> Grouping | None:
    """Group lines by bands and natural frequencies by modes; None where no value has a frequency."""
    stated = np.isfinite(layout.frequency)
    if not np.any(stated):
        return None
    frequency = layout.frequency[stated]
    dimension, edges = Dimension.MODE, _gaps(frequency)
    if has_lines(layout):
        dimension, edges = Dimension.BAND, np.geomspace(np.min(frequency), np.max(frequency), n_bands + 1)[1:-1]
    group = np.full(layout.n_values, -1, dtype=np.intp)
    _, group[stated] = np.unique(np.searchsorted(edges, frequency, side="right"), return_inverse=True)
    of_groups = [layout.frequency[group == number] for number in range(int(np.max(group)) + 1)]
    ends = (tuple(float(f"{end(within):.3g}") for end in (np.min, np.max)) for within in of_groups)
    return Grouping(dimension, group, tuple(Extent(dimension, each) for each in ends))


@lru_cache(maxsize=4)  # it is asked hundreds of times of the layout at hand
def has_lines(layout: Layout) -> bool:
    """Return whether the values are lines of responses rather than natural frequencies or forces."""
    series = series_of(layout)[np.isfinite(layout.frequency)]
    return bool(series.size) and bool(np.median(np.unique_counts(series).counts) >= _FEWEST_LINES)


def modes_that_stay(layout: Layout) -> tuple[int, ...]:
    """Return the channels of natural frequencies that stay where they are, at all positions that were measured.

    A mode of the drive goes with the table; one that does not may be of something that the drive stands on or carries.
    """
    if has_lines(layout):
        return ()
    staying = []
    for channel in range(len(layout.channels)):
        of_mode = (layout.channel == channel) & np.isfinite(layout.frequency)
        positions = levels_of(layout, ConditionAxis.POSITION)[layout.setting[of_mode]]
        if np.unique(positions).size < _FEWEST_POSITIONS:
            continue
        logarithm, weight = np.log(layout.frequency[of_mode]), layout.standard_deviation[of_mode] ** -2.0
        apart = logarithm - np.average(logarithm, weights=weight)
        if weight @ apart**2 <= scipy.special.chdtri(logarithm.size - 1, 1.0 - _SCATTER):
            staying.append(channel)
    return tuple(staying)


def by_condition(layout: Layout, axis: ConditionAxis) -> Grouping | None:
    """Group values by the level of one condition; None where no setting states it."""
    dimension, levels = Dimension(axis.value), levels_of(layout, axis)
    stated = np.isfinite(levels)
    distinct = sorted({float(f"{level:.6g}") for level in levels[stated]})
    if not distinct:
        return None
    n_groups = len(distinct) if dimension in _WITHOUT_ORDER else min(len(distinct), _MOST_LEVELS)
    parts = [part.tolist() for part in np.array_split(np.array(distinct), n_groups)]
    between = [0.5 * (below[-1] + above[0]) for below, above in itertools.pairwise(parts)]
    of_setting = np.where(stated, np.searchsorted(between, np.nan_to_num(levels)), -1)
    ends = (part if dimension in _WITHOUT_ORDER else (part[0], part[-1]) for part in parts)
    return Grouping(dimension, of_setting[layout.setting], tuple(Extent(dimension, tuple(each)) for each in ends))


def levels_of(layout: Layout, axis: ConditionAxis) -> FloatArray:
    """Return what each setting states of an axis, NaN for nothing, shape (n_settings,)."""
    return np.array([setting.values.get(axis, np.nan) for setting in layout.settings], dtype=np.float64)


def series_of(layout: Layout) -> Indices:
    """Return the series of each value: those of one setting and channel follow one another, shape (n_values,)."""
    return layout.setting * len(layout.channels) + layout.channel


def previous_in_series(layout: Layout) -> Indices:
    """Return the value before each one in its series, −1 for the first, shape (n_values,)."""
    series = series_of(layout)
    order = np.argsort(series, kind="stable")
    follows = series[order][1:] == series[order][:-1]
    previous = np.full(layout.n_values, -1, dtype=np.intp)
    previous[order[1:][follows]] = order[:-1][follows]
    return previous


def by_stretch(layout: Layout, n_stretches: int) -> Grouping:
    """Group values by consecutive settings, as those of a motion record follow in time."""
    parts = np.array_split(np.arange(len(layout.settings)), min(n_stretches, len(layout.settings)))
    of_setting = np.repeat(np.arange(len(parts)), [part.size for part in parts])
    names = (tuple(layout.settings[index].name for index in (part[0], part[-1])) for part in parts)
    stretches = tuple(Extent(Dimension.SETTINGS, names=first_and_last) for first_and_last in names)
    return Grouping(Dimension.SETTINGS, of_setting[layout.setting], stretches)


def _by_channel(layout: Layout) -> Grouping:
    channels = tuple(Extent(Dimension.CHANNEL, names=(channel,)) for channel in layout.channels)
    return Grouping(Dimension.CHANNEL, layout.channel, channels)


def _gaps(frequencies: FloatArray) -> FloatArray:
    rising = np.unique(frequencies)
    return rising[1:][rising[1:] > _NEXT_MODE * rising[:-1]]
