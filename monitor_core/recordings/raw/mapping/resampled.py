"""Bring channels of several clocks to one, where the map says so.

What resampling leaves wrong is estimated from the record itself: every other sample is left out and found again by the
same method, which errs more than the method does with all of them. Where the new rate is lower than that of a channel,
the samples are found back from the new ones as well, which shows what lay above half the new rate.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_plausible_length
from monitor_core.recordings.raw.channel_time import ChannelTime
from monitor_core.recordings.raw.mapping.map_records import ResampleMethod, Resampling

_FEWEST_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Resampled:
    """Channels on one even clock, over a time that all of them cover without a break."""

    signals: tuple[FloatArray, ...]
    start: float  # of the first sample behind the zero [s]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Samples of a channel between two breaks, and when they were taken [s]."""

    values: SampleArray
    times: FloatArray

    @property
    def begin(self) -> float:
        return float(self.times[0])

    @property
    def end(self) -> float:
        return float(self.times[-1])


def resample(
    names: Sequence[str], signals: Sequence[SampleArray], times: Sequence[ChannelTime], how: Resampling, where: str
) -> list[Resampled]:
    """Bring channels to one even clock, over each stretch that all of them cover, and estimate the error.

    The times count from one zero. ``RecordingFormatError`` if the file does not say when a run began, if a channel is
    not finite, or if the channels have next to no time in common.
    """
    pieces = [_pieces(values, time, f"{where}, {name}")
              for name, values, time in zip(names, signals, times, strict=True)]  # fmt: skip
    stretches = list(_stretches(pieces))
    found = [made for stretch in stretches if (made := _resampled(names, stretch, how, where)) is not None]
    if not found:
        shared = max(map(_shared, stretches), default=0.0)
        raise RecordingFormatError(
            f"{where}: expected channels that were sampled at the same time; they share {shared:.6g} s"
        )
    return found


def _stretches(pieces: Sequence[Sequence[_Piece]]) -> Iterator[tuple[_Piece, ...]]:
    """Yield the pieces of all channels that share some time, in the order of time: the one that ends first goes on."""
    at = [0] * len(pieces)
    while all(place < len(of_channel) for place, of_channel in zip(at, pieces, strict=True)):
        stretch = tuple(of_channel[place] for place, of_channel in zip(at, pieces, strict=True))
        if _shared(stretch) > 0.0:
            yield stretch
        at[min(range(len(stretch)), key=lambda number: stretch[number].end)] += 1


def _pieces(values: SampleArray, time: ChannelTime, where: str) -> list[_Piece]:
    """Part the samples of a channel at its breaks; the pieces follow each other in time."""
    if not np.all(np.isfinite(values)):
        raise RecordingFormatError(
            f"{where}: expected finite numbers to resample; sample {int(np.argmin(np.isfinite(values)))} is not"
        )
    pieces, at = list[_Piece](), 0
    for run in time.runs:
        if run.start is None and at:
            raise RecordingFormatError(
                f"{where}: expected times from one start to resample; the file does not say when sample {at} was taken"
            )
        steps = np.diff(run.instants, prepend=pieces[-1].end if pieces else -np.inf)
        pieces.append(_Piece(values[at : at + run.n_samples], run.instants))
        if steps.size and not steps.min() > 0.0:
            raise RecordingFormatError(
                f"{where}: expected times that rise from sample to sample; got a step of {steps.min():.6g} s behind "
                f"sample {at - 1 + int(np.argmin(steps))}"
            )
        at += run.n_samples
    return pieces


def _shared(pieces: Sequence[_Piece]) -> float:
    return min(piece.end for piece in pieces) - max(piece.begin for piece in pieces)


def _resampled(names: Sequence[str], pieces: Sequence[_Piece], how: Resampling, where: str) -> Resampled | None:
    """Resample over the time that all pieces cover; ``None`` if that is next to none."""
    begin, end = max(piece.begin for piece in pieces), min(piece.end for piece in pieces)
    n_samples = math.floor((end - begin) * how.sample_rate * (1.0 + 1e-12)) + 1
    if n_samples < _FEWEST_SAMPLES or min(piece.times.size for piece in pieces) < _FEWEST_SAMPLES:
        return None
    require_plausible_length(n_samples, where)
    grid = np.minimum(begin + np.arange(n_samples) / how.sample_rate, end)
    moved, remarks = [], []
    for name, piece in zip(names, pieces, strict=True):
        values, times = piece.values.astype(np.float64), piece.times
        new = _between(times, values, grid, how.method)
        moved.append(new)
        rate = (times.size - 1) / (piece.end - piece.begin)
        remarks.append(_remark(name, _error(times, values, grid, new, how), rate, how))
    return Resampled(tuple(moved), begin, tuple(remarks))


def _between(times: FloatArray, values: FloatArray, wanted: FloatArray, method: ResampleMethod) -> FloatArray:
    if method is ResampleMethod.LINEAR:
        return np.interp(wanted, times, values)
    import scipy.interpolate  # noqa: PLC0415  # not every recording is resampled

    between: FloatArray = scipy.interpolate.CubicSpline(times, values)(wanted)
    return between


def _error(times: FloatArray, values: FloatArray, grid: FloatArray, new: FloatArray, how: Resampling) -> float:
    """Return what resampling leaves wrong, as a share of the rms about the mean; an upper bound [-]."""
    level = float(np.std(values))
    if level == 0.0:
        return 0.0
    last = times.size - 1 + times.size % 2  # the last sample that stays is behind every sample that is found again
    kept, left = slice(0, last, 2), slice(1, last - 1, 2)
    misses = [_between(times[kept], values[kept], times[left], how.method) - values[left]]
    if how.sample_rate < (1.0 - 1e-6) * (times.size - 1) / (times[-1] - times[0]):
        inside = (times >= grid[0]) & (times <= grid[-1])
        misses.append(_between(grid, new, times[inside], how.method) - values[inside])
    return max(float(np.sqrt(np.mean(miss**2))) for miss in misses) / level


def _remark(name: str, error: float, rate: float, how: Resampling) -> str:
    return (
        f"{name}: resampled from {rate:.6g} to {how.sample_rate:g} Hz ({how.method}); error at most "
        f"{100.0 * error:.2g} % of its rms, found again from every other sample"
    )
