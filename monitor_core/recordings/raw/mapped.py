"""Convert a raw file and its channel map to a session: the only place where channels become windows."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.elements.units import canonical_unit
from monitor_core.recordings.raw.channel_map import ChannelMap, MappedChannel, WindowFacts, WindowsIn
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.formats import read_channels

#: Sampling times may be rounded in print; a step that is off by more than this share of it is a gap or jitter.
_STEP_TOLERANCE = 0.01


def read_mapped(path: Path, channel_map: ChannelMap) -> Session:
    """Read a TDMS, UFF58, MAT, NPZ or CSV file, told apart by the ending of the name, as a session in SI units.

    The map says what the channels mean, see :mod:`monitor_core.recordings.raw.channel_map`; all windows belong to one
    measurement. ``RecordingFormatError`` if file and map do not fit each other: a channel that is not there, a unit
    that contradicts the file, lengths, rates or starts that differ, something stated twice or not at all.
    """
    channels = read_channels(path)
    sources = [channel_map.excitation, channel_map.response]
    if channel_map.position is not None:
        sources.append(channel_map.position)
    signals = [_signal(channels, source) for source in sources]
    sample_rate = _sample_rate(channels, signals, channel_map)
    start = _started_at(signals, sample_rate, channel_map.window, path.name)
    parts = [
        _windows(signal, source, channel_map.window, path.name) for signal, source in zip(signals, sources, strict=True)
    ]
    if len({tuple(samples.size for samples in windows) for windows in parts}) > 1:
        lengths = ", ".join(f"{signal.name!r} {signal.samples.shape}" for signal in signals)
        raise RecordingFormatError(f"{path.name}: expected channels of one length; got {lengths}")
    interval = _interval(signals[0], parts[0][0].size / sample_rate, channel_map.window, path.name)
    with naming(path.name):
        windows = tuple(
            _window(channel_map, window_parts, sample_rate, start + number * interval, path.stem)
            for number, window_parts in enumerate(zip(*parts, strict=True))
        )
    return Session(channel_map.axis_id, windows, channel_map.description)


def _window(
    channel_map: ChannelMap, parts: tuple[SampleArray, ...], sample_rate: float, started_at: datetime, stem: str
) -> Window:
    facts = channel_map.window
    position, span, trace = facts.position, facts.position_span, None
    if position is None or span is None:
        trace = parts[2].astype(np.float64)
        position, span = float(np.mean(trace)), float(np.ptp(trace))
    return Window(
        excitation=parts[0],
        response=parts[1],
        sample_rate=sample_rate,
        started_at=started_at,
        conditions=Conditions(position, facts.payload_mass, facts.temperature, facts.preload),
        measurement=facts.measurement or stem,
        excitation_quantity=channel_map.excitation_quantity,
        excitation_source=channel_map.excitation_source,
        direction=facts.direction,
        position_span=span,
        position_trace=trace,
    )


def _signal(channels: Channels, source: MappedChannel) -> Channel:
    channel = channels.channel(source.channel)
    in_file, in_map = canonical_unit(channel.unit), canonical_unit(source.unit)
    if in_file is not None and in_file != in_map:
        raise RecordingFormatError(
            f"{channels.file_name}, {channel.name}: expected {source.unit!r} as the map says; "
            f"the file says {channel.unit!r}"
        )
    return channel


def _sample_rate(channels: Channels, signals: list[Channel], channel_map: ChannelMap) -> float:
    where, stated = channels.file_name, channel_map.window.sample_rate
    in_file = [signal.sample_rate for signal in signals if signal.sample_rate is not None]
    if in_file and not np.allclose(in_file, in_file[0], rtol=1e-9):
        raise RecordingFormatError(
            f"{where}: expected channels of one sample rate; got {', '.join(f'{rate:g} Hz' for rate in in_file)}"
        )
    rates = {"the file": in_file[0]} if in_file else {}
    if channel_map.time is not None:
        rates["the channel of [time]"] = _rate_of_times(channels, channel_map.time)
    if stated is not None:
        rates["sample_rate_hz of the map"] = stated
    if len(rates) != 1:
        got = " and ".join(f"{rate} Hz in {place}" for place, rate in rates.items())
        raise RecordingFormatError(f"{where}: expected the sample rate stated once; got {got or 'none'}")
    return next(iter(rates.values()))


def _rate_of_times(channels: Channels, source: MappedChannel) -> float:
    channel = _signal(channels, source)
    where = f"{channels.file_name}, {channel.name}"
    times = channel.samples.astype(np.float64) * source.factor
    if times.ndim != 1 or times.size < 2 or not np.all(np.isfinite(times)) or not times[-1] > times[0]:
        raise RecordingFormatError(f"{where}: expected rising sampling times; got shape {times.shape}")
    steps = np.diff(times)
    step = float(times[-1] - times[0]) / steps.size
    worst = int(np.argmax(np.abs(steps - step)))
    if abs(steps[worst] - step) > _STEP_TOLERANCE * step:
        raise RecordingFormatError(
            f"{where}: expected uniform sampling every {step:.6g} s; got a step of {steps[worst]:.6g} s "
            f"behind sample {worst}"
        )
    return 1.0 / step


def _started_at(signals: list[Channel], sample_rate: float, facts: WindowFacts, where: str) -> datetime:
    starts = [signal.started_at for signal in signals if signal.started_at is not None]
    if starts and facts.started_at is not None:
        raise RecordingFormatError(
            f"{where}: expected the start stated once; got {starts[0].isoformat()} in the file and "
            f"{facts.started_at.isoformat()} in the map"
        )
    if facts.started_at is not None:
        return facts.started_at
    if not starts:
        raise RecordingFormatError(f"{where}: expected a start with zone; neither the file nor started_at states one")
    if (apart := (max(starts) - min(starts)).total_seconds()) > 0.5 / sample_rate:
        raise RecordingFormatError(f"{where}: expected channels that start together; they start {apart} s apart")
    return starts[0]


def _windows(signal: Channel, source: MappedChannel, facts: WindowFacts, file_name: str) -> list[SampleArray]:
    """Return the windows of one channel in SI."""
    where = f"{file_name}, {signal.name}"
    samples = signal.samples if source.factor == 1.0 else signal.samples * source.factor
    if samples.ndim == 2:
        if facts.windows_in is None or facts.samples_per_window is not None:
            raise RecordingFormatError(
                f"{where}: expected windows_in (and no samples_per_window) for an array of shape {samples.shape}"
            )
        return list(samples if facts.windows_in is WindowsIn.ROWS else samples.T)
    if facts.windows_in is not None:
        raise RecordingFormatError(
            f"{where}: expected a two-dimensional array for windows_in; got shape {samples.shape}"
        )
    length = facts.samples_per_window or samples.size
    if length == 0 or samples.size % length:
        raise RecordingFormatError(
            f"{where}: expected a whole number of windows of {length} samples; got {samples.size} samples"
        )
    return np.split(samples, samples.size // length)


def _interval(signal: Channel, duration: float, facts: WindowFacts, where: str) -> timedelta:
    """Return the time from the start of one window to the start of the next."""
    if signal.samples.ndim == 1:
        return timedelta(seconds=duration)
    if facts.window_interval is None:
        raise RecordingFormatError(
            f"{where}: expected window_interval_s, the time from the start of one window to the next; it is missing"
        )
    return timedelta(seconds=facts.window_interval)
