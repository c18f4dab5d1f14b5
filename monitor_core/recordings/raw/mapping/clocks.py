"""Tell when the samples of a channel were taken, and bring channels of several clocks to one where the map says so.

Sampling counts as even where each step is within 1 % of the mean one, or where all times agree with an even clock to
the digits they are printed with. Anything else is resampled where ``[resample]`` says how, or refused.

What resampling leaves wrong is estimated from the record itself: every other sample is left out and found again by the
same method, which errs more than the method does with all of them. Where the new rate is lower than that of a channel,
the samples are found back from the new ones as well, which shows what lay above half the new rate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_plausible_length
from monitor_core.recordings.raw.mapping.map_records import ResampleMethod, Resampling

#: A step of time that is off by more than this share of the mean one is a gap or jitter.
_STEP_TOLERANCE = 0.01
#: By which times may miss an even clock, as a share of the digit they are printed to: half of it and a little.
_PRINTED = 0.55
#: Digits coarser than this share of a step could hide a sample that is missing.
_COARSEST = 0.25
_MOST_DECIMALS = 12
#: By which a rate of sampling times is open at least (no quartz is that good), and at most.
_LEAST_OPEN, _MOST_OPEN = 1e-9, 1e-5
_LAST = 10_000
#: A pause longer than this many usual steps is a gap: nothing between its ends can be known.
_GAP = 4.5
_FEWEST_SAMPLES = 8
#: By which rates of channels and of the new clock may differ and still be one.
_SAME_RATE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """When the samples of a channel were taken: at a rate from a start, or at times."""

    sample_rate: float | None  # [Hz]; None: uneven
    times: FloatArray | None = None  # [s], where a channel holds them
    started_at: datetime | None = None  # of the first sample, where the file says it
    unevenness: str = ""  # why there is no rate, for the message


@dataclass(frozen=True, slots=True, eq=False)
class Resampled:
    """Channels on one even clock."""

    signals: tuple[FloatArray, ...]
    delay: float  # from the first sample of the record to the first of the new clock [s]
    remarks: tuple[str, ...]


def clock_of_times(times: FloatArray, printed: float, where: str) -> tuple[Clock, tuple[str, ...]]:
    """Return the clock of sampling times in seconds, and what is to be said of it.

    ``printed`` is the digit that the times are known to [s], see :func:`printed_digit`. ``RecordingFormatError`` if the
    times are no times: too few, not finite, or not rising on the whole.
    """
    if times.ndim != 1 or times.size < 2 or not np.all(np.isfinite(times)) or not times[-1] > times[0]:
        raise RecordingFormatError(f"{where}: expected rising sampling times; got shape {times.shape}")
    steps = np.diff(times)
    step = float(times[-1] - times[0]) / steps.size
    worst = int(np.argmax(np.abs(steps - step)))
    if abs(steps[worst] - step) <= _STEP_TOLERANCE * step:
        return Clock(_plain_rate(1.0 / step, times, printed), times), ()
    line_step, distance = _even_line(times)
    whole = 0.0 < printed <= _COARSEST * line_step and abs(steps[worst] - step) <= 2.0 * _PRINTED * printed
    if whole and distance <= _PRINTED * printed:
        share = 100.0 * printed / line_step
        remark = f"{where}: times are printed to {printed:.2g} s, {share:.2g} % of a step; taken as even, as they agree"
        return Clock(_plain_rate(1.0 / line_step, times, printed), times), (remark,)
    advice = "a table [resample] with sample_rate_hz and method makes it even"
    if steps.min() < 0.0:
        advice = "times run back: the file holds several records, to be given one by one"
    elif steps.min() == 0.0:
        advice = (
            f"several samples share a time, which is printed to {printed:.2g} s only: leave [time] out and state "
            "sample_rate_hz and started_at in [window]"
        )
    elif steps.max() > _GAP * float(np.median(steps)):
        advice = "nothing is known of a gap: give the parts in front of it and behind it as files of their own"
    uneven = (
        f"{where}: expected uniform sampling every {step:.6g} s; got a step of {steps[worst]:.6g} s behind sample "
        f"{worst} (all of them: {steps.min():.6g} to {steps.max():.6g} s); {advice}"
    )
    return Clock(None, times, unevenness=uneven), ()


def _plain_rate(rate: float, times: FloatArray, printed: float) -> float:
    """Return the plainest rate that the times do not contradict: files of one recorder then have the same [Hz].

    Times that are printed to a digit leave the rate open by twice that over their length.
    """
    open_by = min(max(2.0 * printed / float(times[-1] - times[0]), _LEAST_OPEN), _MOST_OPEN)
    for digits in range(1, 16):
        plain = float(f"{rate:.{digits - 1}e}")
        if abs(plain / rate - 1.0) <= open_by:
            return plain
    return rate


def printed_digit(numbers: SampleArray) -> float:
    """Return the digit that numbers are printed to, in their own unit; 0 where they have more than twelve decimals.

    Single precision counts as print. The last numbers decide: they are the larger ones.
    """
    values = np.asarray(numbers[-_LAST:], dtype=np.float64)
    of_single = float(np.spacing(np.float32(np.abs(values).max()))) if numbers.dtype == np.float32 else 0.0
    for decimals in range(_MOST_DECIMALS + 1):
        scaled = values * 10.0**decimals
        if np.all(np.abs(scaled - np.rint(scaled)) <= 1e-12 * np.abs(scaled) + 1e-6):
            return max(10.0**-decimals, of_single)
    return of_single


def _even_line(times: FloatArray) -> tuple[float, float]:
    """Return the step of the even clock nearest to times, and by how much one of them misses it at most [s]."""
    numbers = np.arange(times.size, dtype=np.float64)
    slope, start = np.polyfit(numbers, times, 1)
    misses = times - (start + slope * numbers)
    return float(slope), 0.5 * float(np.ptp(misses))


def of_one_clock(clocks: Sequence[Clock]) -> bool:
    """Tell whether channels of one length were sampled together, evenly."""
    first = clocks[0]
    for clock in clocks:
        if clock.sample_rate is None or first.sample_rate is None:
            return False
        if abs(clock.sample_rate - first.sample_rate) > _SAME_RATE * first.sample_rate:
            return False
        if seconds_apart(clock, first) > 0.5 / first.sample_rate:
            return False
    return True


def seconds_apart(clock: Clock, other: Clock) -> float:
    """Return how far apart two clocks begin, as far as their file says it [s]."""
    apart = 0.0
    if clock.started_at is not None and other.started_at is not None:
        apart = (clock.started_at - other.started_at).total_seconds()
    if clock.times is not None and other.times is not None:
        apart += float(clock.times[0] - other.times[0])
    return abs(apart)


def resample(
    names: Sequence[str], signals: Sequence[SampleArray], clocks: Sequence[Clock], how: Resampling, where: str
) -> Resampled:
    """Bring channels to one even clock, over the time that all of them cover, and estimate the error.

    ``RecordingFormatError`` if times do not rise, leave a gap, or are not of one kind; if a channel is not finite; or
    if the channels have next to no time in common.
    """
    instants, remarks_on_times = _instants(names, signals, clocks, where)
    for name, values, times in zip(names, signals, instants, strict=True):
        _require_samples(values, times, f"{where}, {name}")
    begin, end = max(times[0] for times in instants), min(times[-1] for times in instants)
    n_samples = math.floor((end - begin) * how.sample_rate * (1.0 + 1e-12)) + 1 if end > begin else 0
    if n_samples < _FEWEST_SAMPLES:
        raise RecordingFormatError(
            f"{where}: expected channels that were sampled at the same time; they share {max(end - begin, 0.0):.6g} s"
        )
    require_plausible_length(n_samples, where)
    grid = np.minimum(begin + np.arange(n_samples) / how.sample_rate, end)
    moved, remarks = [], list(remarks_on_times)
    for name, values, times in zip(names, signals, instants, strict=True):
        double = values.astype(np.float64)
        new = _between(times, double, grid, how.method)
        moved.append(new)
        remarks.append(
            _remark(name, _error(times, double, grid, new, how), (times.size - 1) / (times[-1] - times[0]), how)
        )
    return Resampled(tuple(moved), float(begin - min(times[0] for times in instants)), tuple(remarks))


def _instants(
    names: Sequence[str], signals: Sequence[SampleArray], clocks: Sequence[Clock], where: str
) -> tuple[list[FloatArray], tuple[str, ...]]:
    """Return the times of all samples from one zero [s]."""
    timed = [clock.times is not None for clock in clocks]
    if any(timed) and not all(timed):
        without = ", ".join(repr(name) for name, has in zip(names, timed, strict=True) if not has)
        raise RecordingFormatError(
            f"{where}: expected sampling times of every channel to resample; got none of {without}"
        )
    starts = [clock.started_at for clock in clocks if clock.started_at is not None]
    if starts and len(starts) < len(clocks):
        raise RecordingFormatError(f"{where}: expected a start of every channel or of none; got {len(starts)}")
    zero = min(starts) if starts else None
    instants = []
    for values, clock in zip(signals, clocks, strict=True):
        even = np.arange(values.size) / float(clock.sample_rate or math.nan)
        times = even if clock.times is None else clock.times
        late = (clock.started_at - zero).total_seconds() if clock.started_at is not None and zero is not None else 0.0
        instants.append(times + late)
    assumed = not starts and not any(timed)
    return instants, (f"{where}: no channel says when it starts; all are taken to start together",) if assumed else ()


def _require_samples(values: SampleArray, times: FloatArray, where: str) -> None:
    if values.shape != times.shape:
        raise RecordingFormatError(f"{where}: expected a time for each sample; got {times.size} for {values.size}")
    if values.size < _FEWEST_SAMPLES:
        raise RecordingFormatError(f"{where}: expected at least {_FEWEST_SAMPLES} samples; got {values.size}")
    if not np.all(np.isfinite(values)):
        raise RecordingFormatError(
            f"{where}: expected finite numbers to resample; sample {int(np.argmin(np.isfinite(values)))} is not"
        )
    steps = np.diff(times)
    shortest, longest = int(np.argmin(steps)), int(np.argmax(steps))
    if not steps[shortest] > 0.0:
        raise RecordingFormatError(
            f"{where}: expected times that rise from sample to sample; got a step of {steps[shortest]:.6g} s behind "
            f"sample {shortest}"
        )
    if steps[longest] > _GAP * float(np.median(steps)):
        raise RecordingFormatError(
            f"{where}: expected no gap to resample across; got one of {steps[longest]:.6g} s behind sample {longest}, "
            f"where {float(np.median(steps)):.6g} s is usual"
        )


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
