"""When the samples of a channel were taken: a zero, and runs of samples without a break between them.

A channel that pauses has several runs, which are never glued. Sampling counts as even where each step of a run is
within 1 % of its mean one, or where all times agree with an even clock to the digits they are printed with. Anything
else is resampled where ``[resample]`` says how, or refused.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError

#: A step of time that is off by more than this share of the mean one is a gap or jitter.
STEP_TOLERANCE = 0.01
#: By which times may miss an even clock, as a share of the digit they are printed to: half of it and a little.
_PRINTED = 0.55
#: Digits coarser than this share of a step could hide a sample that is missing.
_COARSEST = 0.25
_MOST_DECIMALS = 12
#: By which a rate of sampling times is open at least (no quartz is that good), and at most.
_LEAST_OPEN, _MOST_OPEN = 1e-9, 1e-5
_LAST = 10_000
#: So many times are looked at together; of so many that follow each other the ends of what they miss the clock of the
#: first ones by are kept, which is the same as theirs within hundredths of a digit where they are even at all.
_PIECE, _TOGETHER = 2**18, 32
#: A pause longer than this many usual steps is a gap: nothing between its ends can be known.
GAP = 4.5
#: Of fewer samples between their gaps on average, times are uneven rather than interrupted.
_FEWEST_BETWEEN_GAPS = 16
_MANY_DIGITS = 5
#: Numbers from 0 or 1 on that rise by one so often number the samples; the rest are leaps.
_NUMBERED = 0.9
#: By which rates may differ and still be one.
_SAME_RATE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Samples of a channel that follow each other without a break: evenly, or at times."""

    n_samples: int
    start: float | None = None  # of its first sample behind the zero [s]; None: the file does not say
    sample_rate: float | None = None  # [Hz]; None: uneven, or the file does not say
    times: FloatArray | None = None  # of its samples behind the zero [s], where they are given one by one
    mark: str = ""  # what stands in the file in front of it, where that shows the break
    n_lost: int | None = None  # samples that are missing in front of it, where the file counts them

    @property
    def instants(self) -> FloatArray:
        """Times of all samples behind the zero [s]."""
        if self.times is not None:
            return self.times
        return (self.start or 0.0) + np.arange(self.n_samples) / (self.sample_rate or math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelTime:
    """When the samples of a channel were taken, as far as its file says it."""

    zero: datetime | None = None  # with a time zone
    offset: float = 0.0  # of what runs and clock count from, behind the zero, or behind that of the other channels [s]
    runs: tuple[Run, ...] = ()  # none: one run of all samples, at a rate that the file does not say
    clock: str | None = None  # name of the channel of the same file that holds the sampling times
    unevenness: str = ""  # why there is no rate, for the message
    open_by: float = 0.0  # share by which the rate is open, for the digits of its step, where that is worth a word

    @property
    def rates(self) -> tuple[float, ...]:
        """The rates of its runs that are known, each once [Hz]."""
        return tuple(dict.fromkeys(run.sample_rate for run in self.runs if run.sample_rate is not None))

    @property
    def sample_rate(self) -> float | None:
        """Rate of all samples [Hz]; ``None`` where runs have several, or none."""
        return self.rates[0] if len(self.rates) == 1 else None

    @property
    def started_at(self) -> datetime | None:
        """When the first sample was taken, where the file says it."""
        start = self.runs[0].start if self.runs else None
        return None if self.zero is None or start is None else self.zero + timedelta(seconds=self.offset + start)

    def in_runs(self, n_samples: int) -> "ChannelTime":
        """Return the same with its runs: one of all samples, where the file parts them by none."""
        return self if self.runs else replace(self, runs=(Run(n_samples),))

    def at_rate(self, sample_rate: float) -> "ChannelTime":
        """Return the same with a rate that the file does not say [Hz]."""
        runs, end = list[Run](), 0.0
        for run in self.runs:
            start = run.start if run.n_lost is None else end + run.n_lost / sample_rate
            if run.n_lost == 0 and runs:
                runs[-1] = replace(runs[-1], n_samples=runs[-1].n_samples + run.n_samples)
            else:
                runs.append(replace(run, sample_rate=sample_rate, start=start))
            end = (end if start is None else start) + run.n_samples / sample_rate
        return replace(self, runs=tuple(runs))


def even_time(
    n_samples: int, sample_rate: float | None, start: float | None = None, zero: datetime | None = None
) -> ChannelTime:
    """Return the time of samples at one rate [Hz] without a break; ``start`` is behind the zero [s]."""
    return ChannelTime(zero, runs=(Run(n_samples, start, sample_rate),))


def time_of_step(n_samples: int, step: float, n_digits: int, start: float | None = None) -> ChannelTime:
    """Return the time of samples at a step that is printed to so many digits [s]: at the plainest rate that it allows.

    Of fewer than five digits the step itself is taken: much would be as plain.

    Examples
    --------
    >>> time_of_step(10, 1.95313e-05, n_digits=6).rates  # 1 / 51200 Hz
    (51200.0,)

    """
    last = 10.0 ** (math.floor(math.log10(step)) - n_digits + 1)
    open_by = _PRINTED * last / step
    rate = plainest(1.0 / step, open_by if n_digits >= _MANY_DIGITS else _LEAST_OPEN)
    is_said = abs(rate * step - 1.0) <= _LEAST_OPEN and open_by <= STEP_TOLERANCE
    return ChannelTime(runs=(Run(n_samples, start, rate),), open_by=0.0 if is_said else open_by)


def place_of_break(n_before: int, mark: str) -> str:
    """Say behind which sample a break is, and what stands there in the file."""
    return f"behind sample {n_before - 1}" + (f", where {mark} stands" if mark else "")


def missing_samples(place: str, seconds: float | None, n_lost: int | None = None, unit: str = "s") -> str:
    """Say that samples are missing at a place, and for how long [s], or how many; ``None``: the file does not say."""
    much = "how many, the file does not say" if n_lost is None else f"{n_lost} of them"
    much = much if seconds is None else f"for {seconds:.6g} {unit}"
    return f"samples are missing {place}: {much}; no window crosses it"


def from_one_zero(times: Sequence[ChannelTime]) -> list[ChannelTime]:
    """Count the times of channels from one zero: the earliest that the file says."""
    zero = min((time.zero for time in times if time.zero is not None), default=None)
    earliest = min(time.offset for time in times) if zero is None else 0.0
    return [_counted_from(time, zero, earliest) for time in times]


def _counted_from(time: ChannelTime, zero: datetime | None, earliest: float) -> ChannelTime:
    late = 0.0 if time.zero is None or zero is None else (time.zero - zero).total_seconds()
    late += time.offset - earliest
    runs = tuple(_later(run, late) for run in time.runs) if late else time.runs
    return replace(time, zero=zero, offset=0.0, runs=runs)


def _later(run: Run, late: float) -> Run:
    return replace(
        run,
        start=None if run.start is None else run.start + late,
        times=None if run.times is None else run.times + late,
    )


def are_together(times: Sequence[ChannelTime]) -> bool:
    """Tell whether channels were sampled together, evenly, with the same breaks; their zero is one."""
    first = times[0].runs
    return all(not time.unevenness and len(time.runs) == len(first) for time in times) and all(
        run.n_samples == other.n_samples
        and is_same_rate(run.sample_rate, other.sample_rate)
        and seconds_apart(run, other) <= 0.5 / (other.sample_rate or math.inf)
        for time in times
        for run, other in zip(time.runs, first, strict=True)
    )


def is_same_rate(rate: float | None, other: float | None) -> bool:
    """Tell whether two rates are known and one."""
    return rate is not None and other is not None and abs(rate - other) <= _SAME_RATE * other


def seconds_apart(run: Run, other: Run) -> float:
    """Return how far apart two runs begin, as far as their file says it [s]."""
    return 0.0 if run.start is None or other.start is None else abs(run.start - other.start)


@dataclass(frozen=True, slots=True)
class EvenSteps:
    """Step of an even clock that sampling times agree with, and what is to be said of it."""

    step: float
    said: str


class RunningClock:
    """Tells of sampling times, piece by piece, whether an even clock explains them to their digits."""

    def __init__(self) -> None:
        self.size = 0
        self.shortest, self.longest = math.inf, -math.inf  # step
        self.last: SampleArray = np.empty(0)  # samples, which show the digits, see :func:`printed_digit`
        self._first = self._step = 0.0  # of the first piece; by how much times are off its clock:
        self._sum = self._moment = 0.0
        self._ends = list[FloatArray]()  # lowest and highest of so many, and the middle

    def add(self, piece: SampleArray) -> None:
        """Take the times that come next, shape (n_samples,)."""
        times = piece.astype(np.float64, copy=False)
        steps = np.diff(times, prepend=self.last[-1:].astype(np.float64))
        if not self.size:
            self._first = float(times[0])
            about_middle = np.arange(times.size) - 0.5 * (times.size - 1)
            self._step = float(about_middle @ (times - times[0])) / max(float(about_middle @ about_middle), 1.0)
        if steps.size:
            self.shortest = min(self.shortest, float(steps.min()))
            self.longest = max(self.longest, float(steps.max()))
        del steps
        numbers = np.arange(self.size, self.size + times.size, dtype=np.float64)
        off = times - self._first
        off -= self._step * numbers
        self._sum += float(off.sum())
        self._moment += float(off @ numbers)
        begins = np.arange(0, times.size, _TOGETHER)
        middles = 0.5 * (begins + np.minimum(begins + _TOGETHER, times.size) - 1.0) + self.size
        self._ends.append(np.array([np.minimum.reduceat(off, begins), np.maximum.reduceat(off, begins), middles]))
        self.size += times.size
        self.last = np.concatenate([self.last.astype(piece.dtype, copy=False), piece[-_LAST:]])[-_LAST:]

    def even(self, printed: float, where: str, unit: str = "s", factor: float = 1.0) -> EvenSteps | None:
        """Return the step of the clock that explains the times; ``None`` if none does, or there are too few.

        ``printed`` is the digit that they are known to; in messages both stand in ``unit``, by a ``factor``.
        """
        n = self.size
        if n < 2:
            return None
        step = (float(self.last[-1]) - self._first) / (n - 1)
        worst = max(self.longest - step, step - self.shortest)
        if step > 0.0 and worst <= STEP_TOLERANCE * step:
            return EvenSteps(step, "")
        if not worst <= 2.0 * _PRINTED * printed:
            return None
        tilt = 12.0 * (self._moment - 0.5 * (n - 1) * self._sum) / (n * (n * n - 1.0))  # least squares
        lowest, highest, middles = np.concatenate(self._ends, axis=1)
        distance = 0.5 * float(np.max(highest - tilt * middles) - np.min(lowest - tilt * middles))
        line_step = self._step + tilt
        if not (printed <= _COARSEST * line_step and distance <= _PRINTED * printed):
            return None
        share = 100.0 * printed / line_step
        said = f"{where}: times are printed to {printed * factor:.2g} {unit}, {share:.2g} % of a step"
        return EvenSteps(line_step, f"{said}; taken as even, as they agree")


def time_of_samples(
    times: FloatArray,
    printed: float,
    where: str,
    parted: Sequence[Run] = (),
    texts: Sequence[str] = (),
    *,
    unit: str = "s",
) -> tuple[ChannelTime, tuple[str, ...]]:
    """Part sampling times into runs, and find the rate of each.

    Parameters
    ----------
    times : ndarray, shape (n_samples,)
        Sampling times. [s]
    printed : float
        The digit that they are known to, see :func:`printed_digit`. [s]
    where : str
        File and channel, for messages.
    parted : sequence of Run
        Runs in which the file parts the samples, as by a row of words among the numbers. Where the times go on evenly
        over such a place, no sample is missing there, and there is no break.
    texts : sequence of str
        The times as the file writes them, for messages.
    unit : str
        That of the times, for messages: a count of samples is no time.

    Returns
    -------
    ChannelTime
        Runs between the breaks and the gaps, counted as the times are.
    tuple of str
        What is to be said of it.

    Raises
    ------
    RecordingFormatError
        If the times are no times: too few, not finite, or running back where the file shows no break.

    """
    if times.ndim != 1 or times.size < 2:
        raise RecordingFormatError(f"{where}: expected a row of sampling times; got shape {times.shape}")
    if not np.all(np.isfinite(times)):
        raise RecordingFormatError(f"{where}: expected sampling times; number {int(np.argmin(np.isfinite(times)))} is "
                                   f"{times[np.argmin(np.isfinite(times))]}")  # fmt: skip
    steps = np.diff(times)
    usual = float(np.median(steps))
    marks = _marks(parted)
    stated = np.array([place - 1 for place in marks], dtype=np.int64)
    back = steps < 0.0
    back[stated] = False
    if back.any() or usual < 0.0:
        place = int(np.argmax(back))
        raise RecordingFormatError(_ran_back(times, place, printed, texts[place] if texts else "", where, unit=unit))
    gaps = (steps > GAP * usual) & (usual > 0.0)
    if (np.count_nonzero(gaps) + 1) * _FEWEST_BETWEEN_GAPS > times.size:
        gaps[:] = False
    gaps[stated] |= np.abs(steps[stated] - usual) > 0.5 * usual
    parts = np.flatnonzero(gaps) + 1
    del steps, back, gaps  # of a long record all of them are large
    bounds = [0, *parts.tolist(), times.size]
    pieces = [slice(begin, end) for begin, end in pairwise(bounds)]
    rates, remarks, uneven = list[float | None](), dict[str, None](), ""
    for piece in pieces:
        rate, said = _rate_of(times[piece], printed, where, unit)
        if rate is None and piece.stop - piece.start > 1:
            uneven = uneven or _why_uneven(times[piece], piece.start, printed, where, unit)
        elif said:
            remarks[said] = None
        rates.append(rate)
    longest = max(range(len(pieces)), key=lambda i: pieces[i].stop - pieces[i].start)
    # times that begin anew do not say how long the break was
    anew = next((int(part) for part in parts if times[part] <= times[part - 1]), times.size)
    runs = tuple(
        Run(
            piece.stop - piece.start,
            float(times[piece.start])
            if piece.start < anew
            else None,  # begun anew, times do not say how long a break is
            None if uneven else _shared(rate, rates[longest], times[piece], printed),
            times[piece],
            marks.get(piece.start, ""),
        )
        for piece, rate in zip(pieces, rates, strict=True)
    )
    return ChannelTime(runs=runs, unevenness=uneven), tuple(remarks)


def _marks(parted: Sequence[Run]) -> dict[int, str]:
    """Return the numbers of the samples that begin a run, but for the first, and what stands there."""
    begins = np.cumsum([run.n_samples for run in parted]).tolist()
    return {begin: run.mark for begin, run in zip(begins, parted[1:], strict=False)}


def _rate_of(times: FloatArray, printed: float, where: str, unit: str) -> tuple[float | None, str]:
    """Return the rate of a run [Hz], ``None`` if it is uneven, and what is to be said of it."""
    clock = RunningClock()
    for start in range(0, times.size, _PIECE):
        clock.add(times[start : start + _PIECE])
    if (even := clock.even(printed, where, unit)) is None:
        return None, ""
    return _plain_rate(1.0 / even.step, times, printed), even.said


def _shared(rate: float | None, longest: float | None, times: FloatArray, printed: float) -> float | None:
    """Return the rate of the longest run for one that does not contradict it, so that runs of one clock have one."""
    if rate is None or longest is None:
        return longest
    drift = abs(rate / longest - 1.0) * float(times[-1] - times[0])
    return longest if drift <= 2.0 * max(_PRINTED * printed, STEP_TOLERANCE / longest) else rate


def _why_uneven(times: FloatArray, first: int, printed: float, where: str, unit: str) -> str:
    steps = np.diff(times)
    step = float(times[-1] - times[0]) / steps.size
    worst = int(np.argmax(np.abs(steps - step)))
    advice = "a table [resample] with sample_rate_hz and method makes it even"
    if steps.min() == 0.0:
        advice = (
            f"several samples share a time, which is printed to {printed:.2g} {unit} only: leave [time] out and state "
            "sample_rate_hz and started_at in [window]"
        )
    return (
        f"{where}: expected uniform sampling every {step:.6g} {unit}; got a step of {steps[worst]:.6g} {unit} behind "
        f"sample {first + worst} (all of them: {steps.min():.6g} to {steps.max():.6g} {unit}); {advice}"
    )


_HOURS = re.compile(r"(\d{1,2}):\d\d")
#: Counts after which a counter begins anew.
_WRAPS = tuple(2.0**bits for bits in (8, 16, 24, 31, 32))


def _ran_back(times: FloatArray, place: int, printed: float, read: str, where: str, *, unit: str) -> str:
    """Say where times run back, by how much, and what does so; ``read``: the last text in front of that."""
    usual = float(np.median(np.diff(times)))
    back = float(times[place] - times[place + 1])
    lost = back + max(usual, 0.0)  # by which the clock was put back
    why = "the file holds several records, to be given one by one"
    if printed > 0.0 and any(abs(lost / printed - wrap) <= 2.0 + usual / printed for wrap in _WRAPS):
        why = "a counter that wrapped: export times that go on, or give the parts as files of their own"
    elif abs(lost - 3600.0) <= max(10.0 * usual, 1.0):
        hours = _HOURS.findall(read)
        hour = f" at {int(hours[-1]) + 1:02d}:00" if hours else ""
        why = f"clocks were put back{hour} by an hour, as summer time ended: export times in UTC or with their offset"
    elif abs(lost - 86400.0) <= max(10.0 * usual, 1.0):
        why = "times of day over midnight, which need a date"
    at = f"sample {place}, {read[:40]!r}" if read else f"sample {place}"
    return f"{where}: expected rising sampling times; they run back by {back:.6g} {unit} behind {at}: {why}"


def _plain_rate(rate: float, times: FloatArray, printed: float) -> float:
    """Return the plainest rate that the times do not contradict: files of one recorder then have the same [Hz].

    Times that are printed to a digit leave the rate open by twice that over their length.
    """
    return plainest(rate, min(max(2.0 * printed / float(times[-1] - times[0]), _LEAST_OPEN), _MOST_OPEN))


def plainest(rate: float, open_by: float) -> float:
    """Return the number of fewest digits that differs from a rate by a share of ``open_by`` at most."""
    for digits in range(1, 16):
        plain = float(f"{rate:.{digits - 1}e}")
        if abs(plain / rate - 1.0) <= open_by:
            return plain
    return rate


def numbers_samples(head: SampleArray) -> bool:
    """Tell whether values begin as 0, 1, 2, …, with few leaps: the number of a sample, of which no rate is known."""
    start = head[:1000]
    return start.size > 1 and bool(np.mean(np.diff(start) == 1.0) > _NUMBERED) and float(start[0]) in (0.0, 1.0)


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
