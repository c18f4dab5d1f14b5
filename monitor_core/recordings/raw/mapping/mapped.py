"""Take the channels that a map names out of a raw file, in SI, on one even clock."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import Quantity, factor_to_si
from monitor_core.recordings.raw.channel_kind import unit_in_name
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.mapping.clocks import (
    Clock,
    clock_of_times,
    of_one_clock,
    printed_digit,
    resample,
    seconds_apart,
)
from monitor_core.recordings.raw.mapping.counts import unwrapped
from monitor_core.recordings.raw.mapping.map_records import ChannelMap, MappedChannel, TimeSource
from monitor_core.recordings.raw.mapping.stated_units import agreed_unit, resolved
from monitor_core.recordings.raw.mapping.times import times_of


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Signals of one file in SI, in the order in which they were asked for."""

    file_name: str
    names: tuple[str, ...]  # of the channels
    signals: tuple[SampleArray, ...]  # of one shape: (n_samples,), or two-dimensional arrays of windows
    sample_rate: float  # [Hz]
    started_at: datetime | None  # of the first sample, where the file says it
    delay: float  # of the first sample behind the first of the file, where resampling left some out [s]
    remarks: tuple[str, ...]


def take_record(channels: Channels, sources: Sequence[MappedChannel], channel_map: ChannelMap) -> Record:
    """Take the channels of a file that the sources name, in SI, on one even clock.

    ``RecordingFormatError`` if file and map do not fit each other: a channel that is not there, a unit that contradicts
    the file, a sample rate stated twice or not at all, lengths or clocks that differ where nothing is to be resampled.
    """
    where = channels.file_name
    taken = [signal_of(channels, source) for source in sources]
    signals = [signal for signal, _ in taken]
    values = [in_si(signal, source, f"{where}, {signal.name}") for signal, source in taken]
    clocks, remarks = _clocks(channels, signals, sources, channel_map)
    names, lengths = tuple(signal.name for signal in signals), [signal.samples.shape for signal in signals]
    started_at = next((clock.started_at for clock in clocks if clock.started_at is not None), None)
    flat = all(samples.ndim == 1 for samples in values)
    together = of_one_clock(clocks)
    how = channel_map.resampling
    if how is not None and flat and not (together and len(set(lengths)) == 1 and _is_rate(clocks, how.sample_rate)):
        moved = resample(names, values, clocks, how, where)
        earliest = min((c.started_at for c in clocks if c.started_at is not None), default=None)
        return Record(where, names, moved.signals, how.sample_rate, earliest, moved.delay, (*remarks, *moved.remarks))
    if how is not None and not flat:
        raise RecordingFormatError(f"{where}: expected one-dimensional channels to resample; got shapes {lengths}")
    _require_one_clock(clocks, where)
    if len(set(lengths)) > 1:
        got = ", ".join(f"{name!r} {shape}" for name, shape in zip(names, lengths, strict=True))
        raise RecordingFormatError(f"{where}: expected channels of one length; got {got}")
    return Record(where, names, tuple(values), clocks[0].sample_rate or 0.0, started_at, 0.0, remarks)


def signal_of(channels: Channels, source: MappedChannel) -> tuple[Channel, MappedChannel]:
    """Return a channel that the map names, or the row or column of it, and what its numbers are in.

    Raises as :func:`resolved`, and if there is no such channel.
    """
    channel = channels.channel(source.channel)
    source = resolved(source, channel, f"{channels.file_name}, {channel.name}")
    return _part(channel, source.row, source.column, channels.file_name), source


def in_si(channel: Channel, source: MappedChannel, where: str) -> SampleArray:
    """Return the samples in SI, unwrapped; single precision stays single."""
    samples = unwrapped(channel.samples, source, where)
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
    return replace(channel, samples=taken, name=f"{channel.name}, {word} {number + 1}")


def _clocks(
    channels: Channels, signals: Sequence[Channel], sources: Sequence[MappedChannel], channel_map: ChannelMap
) -> tuple[list[Clock], tuple[str, ...]]:
    """Return the clock of each signal, and what is to be said of them."""
    taken: dict[tuple[object, ...], tuple[Clock, tuple[str, ...]]] = {}
    clocks, all_remarks = list[Clock](), dict[str, None]()
    for signal, source in zip(signals, sources, strict=True):
        stated: dict[str, Clock] = {}
        if signal.sample_rate is not None:
            stated["the file"] = Clock(signal.sample_rate, started_at=signal.started_at)
        timed = _times_of(signal, source, channel_map.time)
        for place, name, unit in timed:
            key = (name, unit)
            if key not in taken:
                taken[key] = _clock_of_channel(channels, name, unit, channel_map.time)
            clock, remarks = taken[key]
            stated[place] = clock if clock.started_at is not None else replace(clock, started_at=signal.started_at)
            all_remarks.update(dict.fromkeys(remarks))
        if channel_map.sample_rate is not None:
            stated["sample_rate_hz of the map"] = Clock(channel_map.sample_rate, started_at=signal.started_at)
        if len(stated) != 1:
            got = " and ".join(
                f"{'uneven times' if clock.sample_rate is None else f'{clock.sample_rate} Hz'} in {place}"
                for place, clock in stated.items()
            )
            raise RecordingFormatError(
                f"{channels.file_name}: expected the sample rate stated once; got {got or 'none'}"
                + ("" if got else f" for {signal.name!r}: a file that states none needs [time] or sample_rate_hz")
            )
        clocks += stated.values()
    return clocks, tuple(all_remarks)


def _times_of(signal: Channel, source: MappedChannel, time: TimeSource | None) -> list[tuple[str, str, str | None]]:
    """Return which channels hold the sampling times of a signal: the place that says it, name, and unit of the map."""
    unit = None if time is None else time.unit
    sources = list[tuple[str, str, str | None]]()
    if signal.clock is not None:
        sources.append(("a channel that the file names", signal.clock, unit if source.time is None else None))
    if source.time is not None:
        sources.append(("the channel of time", source.time, unit))
    elif time is not None and time.channel is not None:
        sources.append(("the channel of [time]", time.channel, unit))
    return sources


def _clock_of_channel(
    channels: Channels, name: str, unit: str | None, time: TimeSource | None
) -> tuple[Clock, tuple[str, ...]]:
    where = f"{channels.file_name}, {name}"
    if time is not None and time.form is not None and name == time.channel:
        dates = None if time.date is None else channels.text(time.date)
        seconds, start = times_of(channels.text(name), time.form, time.zone, dates, where)
        clock, remarks = clock_of_times(seconds, printed_digit(seconds), where)
        return replace(clock, started_at=start), remarks
    channel = channels.channel(name)
    stated = agreed_unit(channel.unit, unit_in_name(channel.name), unit or "", where)
    if time is not None and name == time.channel:
        channel = _part(channel, time.row, time.column, channels.file_name)
    factor = factor_to_si(stated, Quantity.TIME, where)
    times: FloatArray = channel.samples.astype(np.float64) * factor
    clock, remarks = clock_of_times(times, printed_digit(channel.samples.reshape(-1)) * factor, where)
    return replace(clock, started_at=channel.started_at), remarks


def _is_rate(clocks: Sequence[Clock], sample_rate: float) -> bool:
    rate = clocks[0].sample_rate
    return rate is not None and abs(rate - sample_rate) <= 1e-9 * sample_rate


def _require_one_clock(clocks: Sequence[Clock], where: str) -> None:
    """Refuse clocks that differ, each for its own reason."""
    for clock in clocks:
        if clock.sample_rate is None:
            raise RecordingFormatError(clock.unevenness)
    if of_one_clock(clocks):
        return
    rates = [clock.sample_rate or 0.0 for clock in clocks]
    advice = "a table [resample] with sample_rate_hz and method brings them to one clock"
    if max(rates) - min(rates) > 1e-9 * rates[0]:
        got = ", ".join(f"{rate:.10g} Hz" for rate in rates)
        raise RecordingFormatError(f"{where}: expected channels of one sample rate; got {got}: {advice}")
    apart = max(seconds_apart(clock, clocks[0]) for clock in clocks)
    raise RecordingFormatError(
        f"{where}: expected channels that start together; they start {apart:.6g} s apart: {advice}"
    )


def interval_of(record: Record, window_interval: float | None) -> timedelta:
    """Return the time from the start of one window of a two-dimensional array to that of the next."""
    if window_interval is None:
        raise RecordingFormatError(
            f"{record.file_name}: expected window_interval_s, the time from the start of one window to the next; it is "
            "missing"
        )
    return timedelta(seconds=window_interval)
