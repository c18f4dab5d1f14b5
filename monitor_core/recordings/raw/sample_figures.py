"""Gather figures of a channel piece by piece: what all samples show, and a bounded part, spread over the record."""

import hashlib
import math
from typing import cast

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.recordings.raw.channel_time import RunningClock

#: So many samples that follow each other are kept or left out together.
_STRETCH = 4096
#: So many samples of a channel are kept at most, fewer where a file has many channels, and so many of all together.
_MOST_KEPT, _FEWEST_KEPT, _MOST_OF_ALL = 2**17, 2**13, 2**21
_NOTHING: FloatArray = np.empty(0)


class SampleFigures:
    """Figures of the samples of one channel, and those that are kept of them; what is not finite is counted alone."""

    def __init__(self, n_channels: int = 1) -> None:
        """``n_channels``: of the file, whose samples are in memory together."""
        self.size = 0
        self.n_not_finite = 0
        self.clock: RunningClock | None = RunningClock()  # none of what does not rise throughout
        self._top, self._bottom = _End(), _End()
        self._most = min(_MOST_KEPT, max(_FEWEST_KEPT, _MOST_OF_ALL // n_channels))
        self._kept: list[SampleArray] = []
        self._n_kept = self._n_stretches = 0
        self._one_in = 1
        self._hash = hashlib.blake2b(digest_size=16)

    @np.errstate(over="ignore", invalid="ignore")  # numbers near the largest there is are shown like all others
    def add(self, piece: SampleArray) -> None:
        """Take the samples that come next, shape (n_samples,)."""
        if not piece.size:
            return
        self.size += piece.size
        self._hash.update(np.add.reduce(np.ascontiguousarray(piece).view(f"u{piece.itemsize}")).tobytes())
        low, high = piece.min(), piece.max()
        if not (math.isfinite(low) and math.isfinite(high)):
            finite: SampleArray = piece[np.isfinite(piece)]
            self.n_not_finite += piece.size - finite.size
            self.clock = None
            if not finite.size:
                return
            piece, low, high = finite, finite.min(), finite.max()
        self._top.add(piece, high, at_top=True)
        self._bottom.add(piece, low, at_top=False)
        if self.clock is not None:
            self.clock.add(piece)
            self.clock = self.clock if self.clock.shortest > 0.0 else None
        self._keep(piece)

    @property
    def minimum(self) -> float | None:
        """The lowest finite sample; None if none is finite."""
        return self._bottom.value

    @property
    def maximum(self) -> float | None:
        """The highest finite sample; None if none is finite."""
        return self._top.value

    @property
    def n_at_ends(self) -> int:
        """How many samples are the lowest or the highest."""
        return self._top.count + (self._bottom.count if self._bottom.value != self._top.value else 0)

    @property
    def n_finite(self) -> int:
        """How many samples are finite."""
        return self.size - self.n_not_finite

    def kept(self) -> SampleArray:
        """Return the finite samples; of many those from the beginning on, and stretches all over the record."""
        return cast(SampleArray, np.concatenate(self._kept)) if self._kept else _NOTHING

    def ends(self) -> tuple[SampleArray, SampleArray]:
        """Return the samples in which the highest and the lowest value show: all, or those around them."""
        if self._one_in == 1:
            kept = self.kept()
            return kept, kept
        return self._top.around, self._bottom.around

    def digest(self) -> bytes:
        """Return what equal samples have alike: the sums of all their bits, and the bits of those that are kept."""
        both = self._hash.copy()
        both.update(np.ascontiguousarray(self.kept()).data.cast("B"))
        return both.digest()

    def _keep(self, piece: SampleArray) -> None:
        for start in range(0, piece.size, _STRETCH):
            if self._n_stretches % self._one_in == 0:
                self._kept.append(piece[start : start + _STRETCH].copy())
                self._n_kept += self._kept[-1].size
            self._n_stretches += 1
        while self._n_kept > self._most and len(self._kept) > 1:
            self._kept = self._kept[::2]
            self._n_kept = sum(stretch.size for stretch in self._kept)
            self._one_in *= 2


class _End:
    """The highest or the lowest sample so far, how many are as high, and those around where most are."""

    def __init__(self) -> None:
        self.value: float | None = None
        self.count = 0
        self.around: SampleArray = _NOTHING
        self._most = 0

    def add(self, piece: SampleArray, end: float, *, at_top: bool) -> None:
        """Take a piece whose own end is given."""
        if self.value is not None and (end < self.value if at_top else end > self.value):
            return
        at_end = piece == end
        count = int(np.count_nonzero(at_end))
        if self.value is None or end != self.value:
            self.value, self.count, self._most = float(end), 0, 0
        self.count += count
        if count > self._most:
            first = int(np.argmax(at_end))
            self._most, self.around = count, piece[max(first - _STRETCH, 0) : first + _STRETCH].copy()
