"""Find peaks that stand out of their surroundings.

``scipy.signal.find_peaks`` answers the same, but it takes half a second to import, half the start of a command, and
nothing else in measuring modes needs it. ``tests/modal/test_prominence.py`` compares the two.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray

Lines = npt.NDArray[np.intp]


def prominent_peaks(values: FloatArray, least_prominence: float) -> tuple[Lines, FloatArray]:
    """Return where the peaks are that stand out by so much, and by how much each does; both shape (n_peaks,).

    A peak is higher than its neighbours; of a flat one it is the middle line. Neither end is a peak. Its prominence is
    its height over the higher one of the two lowest values between it and the next higher value, or the end, on either
    side.
    """
    peaks = _local_maxima(values)
    if not peaks.size:
        return peaks, np.empty(0)
    heights = values[peaks].tolist()
    valleys = np.minimum.reduceat(values, np.concatenate(([0], peaks))).tolist()  # before, between and behind
    before = _lowest_before(heights, valleys[:-1])
    behind = _lowest_before(heights[::-1], valleys[:0:-1])[::-1]
    prominences = np.array(heights) - np.maximum(before, behind)
    standing_out = prominences >= least_prominence
    return peaks[standing_out], prominences[standing_out]


def _local_maxima(values: FloatArray) -> Lines:
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)  # of stretches of equal values
    level = values[starts]
    above = 1 + np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:]))
    middles: Lines = (starts[above] + starts[above + 1] - 1) // 2
    return middles


def _lowest_before(heights: Sequence[float], valleys: Sequence[float]) -> list[float]:
    """Return for each peak the lowest value between it and the next higher one in front of it.

    ``valleys``: the lowest value right in front of each peak, behind the peak before it.
    """
    lowest, higher = list[float](), list[tuple[float, float]]()  # the peaks that hide those in front of them
    for height, valley in zip(heights, valleys, strict=True):
        low = valley
        while higher and higher[-1][0] <= height:
            low = min(low, higher.pop()[1])
        lowest.append(low)
        higher.append((height, low))
    return lowest
