"""Take the channels that a map names out of a raw file, in SI, on one even clock, a record for each run of samples."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import Quantity, factor_to_si
from monitor_core.recordings.raw.channel_kind import unit_in_name
from monitor_core.recordings.raw.channel_time import (
    ChannelTime,
    Run,
    are_together,
    from_one_zero,
    is_same_rate,
    missing_samples,
    place_of_break,
    printed_digit,
    seconds_apart,
    time_of_samples,
)
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.mapping.counts import unwrapped
from monitor_core.recordings.raw.mapping.map_records import ChannelMap, MappedChannel, TimeSource
from monitor_core.recordings.raw.mapping.resampled import resample
from monitor_core.recordings.raw.mapping.stated_units import agreed_unit, resolved, unknown_unit
from monitor_core.recordings.raw.mapping.times import times_of

#: So far may the start of a window be off what the map says: programs write clocks to the second [s].
_SAME_START = 1.0
#: Whole numbers that rise by one so often number the samples.
_NUMBERED = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Signals of one file in SI without a break, in the order in which they were asked for."""

    file_name: str
    names: tuple[str, ...]  # of the channels
    signals: tuple[SampleArray, ...]  # of one shape: (n_samples,), or two-dimensional arrays of windows
    sample_rate: float  # [Hz]
    started_at: datetime | None  # of the first sample of the file, where it says it
    delay: float  # of the first sample of the record behind that [s]
    remarks: tuple[str, ...]
    starts: tuple[float, ...] = ()  # of the rows of arrays behind that of the first, where the file says them [s]


def take_records(channels: Channels, sources: Sequence[MappedChannel], channel_map: ChannelMap) -> tuple[Record, ...]:
    """Take the channels of a file that the sources name, in SI, on one even clock: a record for each run of samples.

    ``RecordingFormatError`` if file and map do not fit each other: a channel that is not there, a unit that contradicts
    the file, a sample rate stated twice or not at all, lengths, clocks or breaks that differ where nothing is to be
    resampled.
    """
    where = channels.file_name
    found = [signal_of(channels, source) for source in sources]
    signals = [signal for signal, _ in found]
    stated, remarks = _times(channels, signals, sources, channel_map)
    values = [_in_si(*of, time.runs, f"{where}, {of[0].name}") for of, time in zip(found, stated, strict=True)]
    times = from_one_zero(stated)
    names, shapes = tuple(signal.name for signal in signals), [signal.samples.shape for signal in signals]
    remarks += _rates_open(names, stated)
    for signal, source in found:
        remarks += unknown_unit(source.unit, signal.unit, f"{where}, {signal.name}")
    how, flat = channel_map.resampling, all(samples.ndim == 1 for samples in values)
    zero, first = times[0].zero, min((of.runs[0].start or 0.0) for of in times)
    started_at = None if zero is None else zero + timedelta(seconds=first)
    if how is not None and not flat:
        raise RecordingFormatError(f"{where}: expected one-dimensional channels to resample; got shapes {shapes}")
    together = len(set(shapes)) == 1 and are_together(times)
    if how is not None and not (together and all(is_same_rate(rate, how.sample_rate) for rate in times[0].rates)):
        remarks += _starts_assumed(stated, where)
        records, end = list[Record](), 0.0
        for made in resample(names, values, times, how, where):
            delay = made.start - first
            lost = [_missing(where, f"until {delay:.6g} s behind its start", delay - end)] if records else []
            records.append(
                Record(where, names, made.signals, how.sample_rate, started_at, delay, (*made.remarks, *lost))
            )
            end = delay + made.signals[0].size / how.sample_rate
    else:
        _require_one_clock(names, shapes, times, where)
        records = list(_cut_at_breaks(where, names, values, times, started_at, first=first))
    records[0] = replace(records[0], remarks=(*remarks, *records[0].remarks))
    return tuple(records)


def _cut_at_breaks(
    where: str, names: tuple[str, ...], values: Sequence[SampleArray], times: Sequence[ChannelTime],
    started_at: datetime | None, *, first: float,
) -> Iterator[Record]:  # fmt: skip
    """Yield a record for each run of channels that were sampled together, and say what is missing between them."""
    runs, at, end = times[0].runs, 0, 0.0
    if values[0].ndim > 1:  # an array of windows, which is cut by the map
        yield Record(where, names, tuple(values), runs[0].sample_rate or 0.0, started_at, 0.0, (), _starts(runs))
        return
    for run in runs:
        remarks = list[str]()
        delay = end if run.start is None else max(run.start - first, 0.0) if at else 0.0
        rate = run.sample_rate or 0.0
        if at and run.start is not None and delay - end < 0.5 / rate:
            remarks.append(f"{where}: sampled at {rate:.10g} Hz behind sample {at - 1}; no window crosses it")
        elif at:
            remarks.append(_missing(where, place_of_break(at, run.mark), None if run.start is None else delay - end))
        taken = values if len(runs) == 1 else [samples[at : at + run.n_samples] for samples in values]
        yield Record(where, names, tuple(taken), rate, started_at, delay, tuple(remarks))
        at, end = at + run.n_samples, delay + run.n_samples / rate


def _starts(runs: Sequence[Run]) -> tuple[float, ...]:
    """Return when the rows of an array began, behind the first [s]; nothing where the file does not say it."""
    starts = [run.start for run in runs if run.start is not None]
    known = len(starts) == len(runs) > 1 and all(later > start for start, later in pairwise(starts))
    return tuple(start - starts[0] for start in starts) if known else ()


def _missing(where: str, place: str, seconds: float | None) -> str:
    return f"{where}: {missing_samples(place, seconds)}"


def signal_of(channels: Channels, source: MappedChannel) -> tuple[Channel, MappedChannel]:
    """Return a channel that the map names, or the row or column of it, and what its numbers are in.

    Raises as :func:`resolved`, and if there is no such channel.
    """
    channel = channels.channel(source.channel)
    source = resolved(source, channel, f"{channels.file_name}, {channel.name}")
    return _part(channel, source.row, source.column, channels.file_name), source


def _in_si(channel: Channel, source: MappedChannel, runs: Sequence[Run], where: str) -> SampleArray:
    """Return the samples in SI, unwrapped; single precision stays single."""
    samples = unwrapped(channel.samples, source, where, runs)
    if source.offset != 0.0:
        samples = samples - samples.dtype.type(source.offset)
    samples = samples if source.factor == 1.0 else samples * source.factor
    samples.setflags(write=False)  # so that windows need not copy their part
    return samples


def _part(channel: Channel, row: int | None, column: int | None, file_name: str) -> Channel:
    if row is None and column is None:
        return channel
    samples, (word, number) = channel.samples, ("row", row) if row is not None else ("column", column)
    where = f"{file_name}, {channel.name}"
    if samples.ndim != 2:
        raise RecordingFormatError(f"{where}: expected a two-dimensional array for {word}; got shape {samples.shape}")
    there = samples.shape[0 if row is not None else 1]
    if number is None or number >= there:
        raise RecordingFormatError(f"{where}: expected a {word} up to {there}; got {(number or 0) + 1}")
    taken = samples[number] if row is not None else samples[:, number].copy()
    time = channel.time
    if time.runs:
        run = time.runs[number] if row is not None and len(time.runs) == there else time.runs[0]
        time = replace(time, runs=(replace(run, n_samples=taken.size),))
    return replace(channel, stored=taken, name=f"{channel.name}, {word} {number + 1}", time=time)


def _times(
    channels: Channels, signals: Sequence[Channel], sources: Sequence[MappedChannel], channel_map: ChannelMap
) -> tuple[list[ChannelTime], tuple[str, ...]]:
    """Return when the samples of each signal were taken, and what is to be said of it."""
    taken: dict[tuple[object, ...], tuple[ChannelTime, tuple[str, ...]]] = {}
    times, all_remarks = list[ChannelTime](), dict[str, None]()
    if channel_map.sample_rate is not None:
        _require_no_leap(channels, signals[0])
    for signal, source in zip(signals, sources, strict=True):
        in_file = signal.time.in_runs(signal.samples.size)
        stated: dict[str, ChannelTime] = {}
        if in_file.rates:
            stated["the file"] = in_file
        for place, name, unit in _clocks_of(signal, source, channel_map.time):
            key = (name, unit)
            if key not in taken:
                taken[key] = _time_of_clock(channels, name, unit, channel_map.time, in_file.runs)
            of_clock, remarks = taken[key]
            zero = of_clock.zero if of_clock.zero is not None else in_file.zero
            stated[place] = replace(of_clock, zero=zero, offset=in_file.offset)
            all_remarks.update(dict.fromkeys(remarks))
            n_times = sum(run.n_samples for run in of_clock.runs)
            if signal.samples.ndim == 1 and n_times != signal.samples.size:
                raise RecordingFormatError(
                    f"{channels.file_name}, {signal.name}: expected a time for each sample; got {n_times} for "
                    f"{signal.samples.size}"
                )
        if channel_map.sample_rate is not None:
            stated["sample_rate_hz of the map"] = in_file.at_rate(channel_map.sample_rate)
        if len(stated) != 1:
            got = " and ".join(f"{_rates_shown(time)} in {place}" for place, time in stated.items())
            raise RecordingFormatError(
                f"{channels.file_name}: expected the sample rate stated once; got {got or 'none'}"
                + ("" if got else f" for {signal.name!r}: a file that states none needs [time] or sample_rate_hz")
            )
        times += stated.values()
    return times, tuple(all_remarks)


def _require_no_leap(channels: Channels, signal: Channel) -> None:
    """Refuse a rate for all samples where a channel numbers them and leaps where the file shows no break."""
    breaks = np.cumsum([run.n_samples for run in signal.time.runs], dtype=np.int64)[:-1] - 1

    def steps_of(numbers: SampleArray) -> SampleArray:
        steps = np.diff(numbers)
        steps[breaks[breaks < steps.size]] = 1.0  # counted there
        return steps

    def are_numbered(steps: SampleArray) -> bool:
        return steps.size > 0 and bool(steps.min() == 1.0 and np.mean(steps == 1.0) > _NUMBERED)

    for channel in channels.channels if len(signal.shape) == 1 else ():
        # a channel that does not begin so need not be read
        if channel.shape != signal.shape or not are_numbered(steps_of(channel.head)):
            continue
        steps = steps_of(channel.samples)
        if are_numbered(steps) and steps.max() > 1.0:
            at = int(np.argmax(steps))
            raise RecordingFormatError(
                f"{channels.file_name}: expected samples without a gap, as the map says; {channel.name!r} "
                f"numbers them, and leaps by {steps[at]:g} behind sample {at}: a table [time] with this channel and "
                "sample_rate_hz minds the gap"
            )


def _rates_shown(time: ChannelTime) -> str:
    rates = dict.fromkeys("uneven times" if run.sample_rate is None else f"{run.sample_rate} Hz" for run in time.runs)
    return " then ".join(rates)


def _clocks_of(signal: Channel, source: MappedChannel, time: TimeSource | None) -> list[tuple[str, str, str | None]]:
    """Return which channels hold the sampling times of a signal: the place that says it, name, and unit of the map."""
    unit = None if time is None else time.unit
    sources = list[tuple[str, str, str | None]]()
    if signal.time.clock is not None:
        sources.append(("a channel that the file names", signal.time.clock, unit if source.time is None else None))
    if source.time is not None:
        sources.append(("the channel of time", source.time, unit))
    elif time is not None and time.channel is not None:
        sources.append(("the channel of [time]", time.channel, unit))
    return sources


def _time_of_clock(
    channels: Channels, name: str, unit: str | None, time: TimeSource | None, parted: Sequence[Run]
) -> tuple[ChannelTime, tuple[str, ...]]:
    where = f"{channels.file_name}, {name}"
    if time is not None and time.form is not None and name == time.channel:
        dates = None if time.date is None else channels.text(time.date)
        texts = channels.text(name)
        seconds, start = times_of(texts, time.form, time.zone, dates, where)
        found, remarks = time_of_samples(seconds, printed_digit(seconds), where, parted, texts)
        return replace(found, zero=start), remarks
    channel = channels.channel(name)
    if time is not None and name == time.channel:
        channel = _part(channel, time.row, time.column, channels.file_name)
    unknown: tuple[str, ...] = ()
    if time is not None and time.counts_at is not None:
        factor = 1.0 / time.counts_at
    else:
        unknown = unknown_unit(unit or "", channel.unit, where)
        stated = agreed_unit(channel.unit, unit_in_name(channel.name), unit or "", where)
        factor = factor_to_si(stated, Quantity.TIME, where)
    times: FloatArray = channel.samples.astype(np.float64) * factor
    printed = printed_digit(channel.samples.reshape(-1)) * factor
    found, remarks = time_of_samples(times, printed, where, channel.time.runs)
    return replace(found, zero=channel.time.zero), (*unknown, *remarks)


def _rates_open(names: Sequence[str], times: Sequence[ChannelTime]) -> tuple[str, ...]:
    """Say of a step that is printed to few digits which rates it may be."""
    return tuple(
        f"{name}: the digits of its step leave the rate open by {100.0 * time.open_by:.2g} %: {time.rates[0]:.10g} Hz"
        for name, time in zip(names, times, strict=True)
        if time.open_by and time.rates
    )


def _starts_assumed(times: Sequence[ChannelTime], where: str) -> tuple[str, ...]:
    """Refuse times of several kinds, which cannot be brought together; say it where all starts are assumed."""
    timed = [time.runs[0].start is not None for time in times]
    dated = [time.zero is not None for time in times]
    if any(timed) and not all(timed):
        raise RecordingFormatError(
            f"{where}: expected a start or times of every channel to resample; got {sum(timed)} of {len(timed)}"
        )
    if any(dated) and not all(dated):
        raise RecordingFormatError(f"{where}: expected a start of every channel or of none; got {sum(dated)}")
    return () if any(timed) else (f"{where}: no channel says when it starts; all are taken to start together",)


def _require_one_clock(
    names: Sequence[str], shapes: Sequence[tuple[int, ...]], times: Sequence[ChannelTime], where: str
) -> None:
    """Refuse channels that were not sampled together, each for its own reason."""
    for time in times:
        if time.unevenness:
            raise RecordingFormatError(time.unevenness)
    advice = "a table [resample] with sample_rate_hz and method brings them to one clock"
    rates = [[run.sample_rate or 0.0 for run in time.runs] for time in times]
    if not all(is_same_rate(of[0], rates[0][0]) for of in rates):
        got = ", ".join(f"{of[0]:.10g} Hz" for of in rates)
        raise RecordingFormatError(f"{where}: expected channels of one sample rate; got {got}: {advice}")
    apart = max(seconds_apart(time.runs[0], times[0].runs[0]) for time in times)
    if apart > 0.5 / rates[0][0]:
        raise RecordingFormatError(
            f"{where}: expected channels that start together; they start {apart:.6g} s apart: {advice}"
        )
    if len(set(shapes)) > 1:
        got = ", ".join(f"{name!r} {shape}" for name, shape in zip(names, shapes, strict=True))
        raise RecordingFormatError(f"{where}: expected channels of one length; got {got}")
    if not are_together(times):
        got = "; ".join(f"{name!r} of {_runs_shown(time)}" for name, time in zip(names, times, strict=True))
        raise RecordingFormatError(f"{where}: expected channels with the same breaks; got {got}: {advice}")


def _runs_shown(time: ChannelTime) -> str:
    shown = [f"{run.n_samples} samples at {run.sample_rate:.10g} Hz from {run.start or 0.0:.6g} s on"
             for run in time.runs[:5]]  # fmt: skip
    return ", ".join(shown) + (", …" if len(time.runs) > 5 else "")


def starts_of_windows(record: Record, n_windows: int, window_interval: float | None) -> list[timedelta]:
    """Return when the windows of a two-dimensional array begin behind the first, as the file says, else the map."""
    if len(record.starts) == n_windows:
        stated = np.arange(n_windows) * window_interval if window_interval is not None else np.array(record.starts)
        off = np.abs(stated - np.array(record.starts))
        if off.max() > _SAME_START:
            place = int(np.argmax(off > _SAME_START))
            raise RecordingFormatError(
                f"{record.file_name}: expected windows {window_interval} s apart as window_interval_s of the map says; "
                f"window {place + 1} of the file begins {record.starts[place]:.6g} s behind the first"
            )
        return [timedelta(seconds=start) for start in record.starts]
    if window_interval is None:
        raise RecordingFormatError(
            f"{record.file_name}: expected window_interval_s, the time from the start of one window to the next; it is "
            "missing"
        )
    return [timedelta(seconds=number * window_interval) for number in range(n_windows)]
