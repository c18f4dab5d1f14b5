"""Make a session, a motion record or an FRF set of raw files and their channel map."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recording import SESSION_GAP, Conditions, Direction, MotionRecord, Session, Window, span_of
from monitor_core.recordings import motion_csv
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.raw.channel_kind import rate_of_number
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.mapping.channel_map import facts_required
from monitor_core.recordings.raw.mapping.commanded import with_commanded_force
from monitor_core.recordings.raw.mapping.doubts import (
    doubts_of_numbers,
    doubts_of_rate,
    doubts_of_session,
    doubts_of_travel,
    require_place,
    require_vibration_rate,
)
from monitor_core.recordings.raw.mapping.map_records import (
    ChannelMap,
    Cutting,
    MappedChannel,
    MotionSignals,
    SessionSignals,
    Tolerances,
    WindowFacts,
    WindowsIn,
)
from monitor_core.recordings.raw.mapping.mapped import Record, signal_of, starts_of_windows, take_records
from monitor_core.recordings.raw.mapping.relative import with_relative_displacement
from monitor_core.recordings.raw.stated_numbers import doubts_of_sampling, number_named

#: Called with the name of each file before it is read.
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A part of a raw file that is not in what was made of it, and why."""

    what: str
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class ImportedSession:
    """A session of raw files, and what is to be said of it."""

    session: Session
    left_out: tuple[LeftOut, ...] = ()
    remarks: tuple[str, ...] = ()  # what was resampled with which error, and numbers in doubt
    tolerances: Tolerances = field(default_factory=Tolerances)


@dataclass(frozen=True, slots=True, eq=False)
class ImportedMotion:
    """A motion record of a raw file, and what is to be said of it."""

    record: MotionRecord
    left_out: tuple[LeftOut, ...] = ()
    remarks: tuple[str, ...] = ()


def import_session(
    paths: Sequence[Path],
    channel_map: ChannelMap,
    progress: Progress | None = None,
    seen: Callable[[Channels], None] | None = None,
) -> ImportedSession:
    """Make one session of raw files in SI units, told apart by the endings of their names, windows in time order.

    Windows of a file are one measurement, unless the map says otherwise. ``seen`` is called with the channels of each
    file as they were read, those that become no window included. ``RecordingFormatError`` if the map is none of
    a session, or files and map do not fit each other: a channel that is not there, a unit that contradicts the file,
    lengths, rates or starts that differ, something stated twice or not at all, numbers that cannot be what they are
    said to be, or files that overlap in time.
    """
    signals = channel_map.signals
    if not isinstance(signals, SessionSignals):
        raise RecordingFormatError(f"{_names(paths)}: expected a map of a session; got one of a {channel_map.kind}")
    _require_files(paths)
    windows: list[tuple[Window, Path]] = []
    left_out, remarks = list[LeftOut](), _unused(paths, channel_map)
    if channel_map.cutting.file_interval is not None and len(paths) > 1:
        remarks.append(f"files follow each other in the order given: {', '.join(path.name for path in paths)}")
    for number, path in enumerate(paths):
        if progress is not None:
            progress(path.name)
        made = _windows_of_file(paths, number, signals, channel_map, seen)
        windows += [(window, path) for window in made.windows]
        left_out += made.left_out
        remarks += made.remarks
    windows.sort(key=lambda window: window[0].started_at)
    _require_apart(windows)
    in_order = tuple(window for window, _ in windows)
    if channel_map.cutting.position_step is not None:
        in_order = tuple(_numbered(in_order, channel_map.cutting.position_step))
    session = Session(channel_map.axis_id, in_order, channel_map.description)
    remarks += doubts_of_session(session, signals)
    return ImportedSession(session, tuple(left_out), tuple(dict.fromkeys(remarks)), channel_map.tolerances)


def import_motion(paths: Sequence[Path], channel_map: ChannelMap, progress: Progress | None = None) -> ImportedMotion:
    """Make a motion record of a raw file; raises as :func:`import_session`.

    A motion is uninterrupted, so there is one file only.
    """
    signals = channel_map.signals
    if not isinstance(signals, MotionSignals):
        raise RecordingFormatError(f"{_names(paths)}: expected a map of a motion; got one of a {channel_map.kind}")
    if len(paths) != 1:
        raise RecordingFormatError(f"expected one file of an uninterrupted motion; got {len(paths)}: {_names(paths)}")
    (path,) = paths
    if progress is not None:
        progress(path.name)
    sources = [signals.position, signals.drive, *([] if signals.reference is None else [signals.reference])]
    channels = read_channels(path, channel_map.text)
    record, *others = take_records(channels, sources, channel_map)
    if others:
        raise RecordingFormatError(f"{others[0].remarks[-1]}; expected an uninterrupted motion")
    position, drive, *reference = (samples.astype(np.float64) for samples in record.signals)
    if position.ndim != 1 or position.size < motion_csv.FEWEST_SAMPLES:
        raise RecordingFormatError(
            f"{path.name}: expected a motion of at least {motion_csv.FEWEST_SAMPLES} samples, one column each; got "
            f"shape {position.shape}"
        )
    require_place(position, path.name)
    with naming(path.name):
        motion = MotionRecord(
            record.sample_rate, position, drive, signals.quantity, reference[0] if reference else None
        )
    remarks = [
        *record.remarks,
        *doubts_of_rate(record.sample_rate, path.name),
        *_doubts_of_channels(channels, sources),
        *(() if channel_map.resampling else doubts_of_sampling(channels, record.sample_rate, position.size)),
        *doubts_of_travel([position], signals.position),
    ]
    return ImportedMotion(motion, tuple(_delayed(record)), tuple(remarks))


@dataclass(frozen=True, slots=True, eq=False)
class _FileWindows:
    windows: list[Window]
    left_out: list[LeftOut]
    remarks: list[str]


def _windows_of_file(
    paths: Sequence[Path],
    number: int,
    signals: SessionSignals,
    channel_map: ChannelMap,
    seen: Callable[[Channels], None] | None,
) -> _FileWindows:
    path = paths[number]
    named = (signals.response, signals.motor, signals.position, signals.reference)
    sources = [source for source in named if source is not None]
    if signals.sweep is None:
        sources.insert(0, signals.excitation)
    channels = read_channels(path, channel_map.text)
    if seen is not None:
        seen(channels)
    channel_map = with_numbers_of(channels, channel_map)
    records, doubts = take_records(channels, sources, channel_map), _doubts_of_channels(channels, sources)
    n_samples = sum(record.signals[0].size for record in records)
    if channel_map.resampling is None and records[0].signals[0].ndim == 1:
        doubts += doubts_of_sampling(channels, records[0].sample_rate, n_samples)
    if signals.sweep is not None:
        records = tuple(with_commanded_force(record, signals.sweep) for record in records)
    if signals.motor is not None:
        records = tuple(with_relative_displacement(record) for record in records)
    steps = [signal_of(channels, source)[1].step for source in (signals.response, signals.motor) if source is not None]
    resolution = None if None in steps else math.hypot(*(step for step in steps if step is not None))
    del channels  # what is not in the records is not needed any more
    facts = facts_of_file(path, channel_map)
    if signals.position is None:
        facts_required(facts, signals, f"{path.name} [window]")
    made = _FileWindows([], _delayed(records[0]), [])
    kinds = list[tuple[float, int, int]]()  # of windows: those of one measurement are of one rate, length and session
    n_sessions, end = 0, 0.0
    for record in records:
        n_sessions += record.delay - end > SESSION_GAP.total_seconds()
        end = record.delay + record.signals[0].size / record.sample_rate
        require_vibration_rate(record.sample_rate, path.name)
        start = _started_at(record, number, len(paths), facts, channel_map)
        pieces, rest = _cut(record, channel_map.cutting)
        made.left_out.extend(rest)
        made.remarks.extend(record.remarks)
        made.remarks.extend(doubts_of_rate(record.sample_rate, path.name))
        if not pieces:
            continue
        seconds = pieces[0][0].size / record.sample_rate
        begins = [timedelta(seconds=i * seconds) for i in range(len(pieces))]
        kind = (record.sample_rate, pieces[0][0].size, n_sessions)
        kinds += [] if kind in kinds else [kind]
        if record.signals[0].ndim == 2:
            begins = starts_of_windows(record, len(pieces), channel_map.cutting.window_interval)
        with naming(path.name):
            made.windows.extend(
                _window(
                    signals,
                    facts,
                    piece,
                    sample_rate=record.sample_rate,
                    started_at=start + begin,
                    path=path,
                    part=kinds.index(kind) + 1,
                    resolution=resolution,
                )
                for piece, begin in zip(pieces, begins, strict=True)
            )
    if not made.windows:
        size, length = max(record.signals[0].size for record in records), channel_map.cutting.samples_per_window or 1
        raise RecordingFormatError(
            f"{path.name}, {records[0].names[0]}: expected at least one window of {length} samples; got {size} samples"
            + (" without a break at most" if len(records) > 1 else "")
        )
    made.remarks.extend(doubts)
    return made


def with_numbers_of(channels: Channels, channel_map: ChannelMap) -> ChannelMap:
    """Return the map of one file, with the numbers that it leaves to the file, which may differ from file to file.

    ``RecordingFormatError`` if the file has no such number, or one that cannot be what the map takes it for.
    """
    named, cutting, rate = channel_map.named, channel_map.cutting, channel_map.sample_rate
    if named.sample_rate is not None:
        number = number_named(channels, named.sample_rate, "sample_rate_hz")
        rate = rate_of_number(named.sample_rate, number) or number  # "dt" is a step
    if named.samples_per_window is not None:
        samples = number_named(channels, named.samples_per_window, "samples_per_window")
        if not samples.is_integer():
            raise RecordingFormatError(
                f"{channels.file_name}: expected a whole number {named.samples_per_window!r}, which samples_per_window "
                f"of the map names; got {samples:g}"
            )
        cutting = replace(cutting, samples_per_window=int(samples))
    return replace(channel_map, sample_rate=rate, cutting=cutting)


def _window(
    signals: SessionSignals,
    facts: WindowFacts,
    piece: tuple[SampleArray, ...],
    *,
    sample_rate: float,
    started_at: datetime,
    path: Path,
    part: int,
    resolution: float | None,
) -> Window:
    position, span, trace = facts.position, facts.position_span, None
    if signals.position is not None:
        trace = piece[2].astype(np.float64)
        finite = trace[np.isfinite(trace)]  # the gate refuses a window with others
        position, span = float(np.mean(finite)) if finite.size else 0.0, span_of(trace)
    elif span is None:  # of a scale, see facts_required
        span = span_of(piece[1 if signals.motor is None else -1].astype(np.float64))
    require_place(position or 0.0, path.name)
    return Window(
        excitation=piece[0],
        response=piece[1],
        sample_rate=sample_rate,
        started_at=started_at,
        conditions=Conditions(position or 0.0, facts.payload_mass, facts.temperature, facts.preload),
        measurement=(facts.measurement or path.stem) + (f", part {part}" if part > 1 else ""),
        excitation_quantity=signals.quantity,
        excitation_source=signals.source,
        direction=facts.direction or Direction.BOTH,
        position_span=span or 0.0,
        position_trace=trace,
        reference=None if signals.reference is None else piece[2 if signals.position is None else 3],
        response_quantity=signals.response_quantity,
        response_resolution=resolution,
    )


def facts_of_file(path: Path, channel_map: ChannelMap) -> WindowFacts:
    """Return the facts of one file: its own, where ``[[files]]`` states some, before those of all."""
    own = dict(channel_map.files).get(path.name)
    if own is None:
        return channel_map.window
    stated = {f.name: value for f in fields(WindowFacts) if (value := getattr(own, f.name)) is not None}
    return replace(channel_map.window, **stated)


def _started_at(record: Record, number: int, n_files: int, facts: WindowFacts, channel_map: ChannelMap) -> datetime:
    """Return when the first window of a file begins."""
    where, interval = record.file_name, channel_map.cutting.file_interval
    own = dict(channel_map.files).get(where)
    if record.started_at is not None and facts.started_at is not None:
        raise RecordingFormatError(
            f"{where}: expected the start stated once; got {record.started_at.isoformat()} in the file and "
            f"{facts.started_at.isoformat()} in the map"
        )
    delay = timedelta(seconds=record.delay)
    if record.started_at is not None:
        return record.started_at + delay
    if facts.started_at is None:
        raise RecordingFormatError(
            f"{where}: expected a start with zone; neither the file nor started_at of the map states one"
        )
    if own is not None and own.started_at is not None:
        return own.started_at + delay
    if n_files > 1 and interval is None:
        raise RecordingFormatError(
            f"{where}: expected file_interval_s, or a start of each file in [[files]]; got {n_files} files and one "
            "start"
        )
    return facts.started_at + delay + timedelta(seconds=number * (interval or 0.0))


def _cut(record: Record, cutting: Cutting) -> tuple[list[tuple[SampleArray, ...]], list[LeftOut]]:
    """Cut the signals of a file into windows; the rest of the last one is left out."""
    signals, length = record.signals, cutting.samples_per_window
    where = f"{record.file_name}, {record.names[0]}"
    shape = signals[0].shape
    if signals[0].ndim == 2:
        if cutting.windows_in is None or length is not None:
            raise RecordingFormatError(
                f"{where}: expected windows_in (and no samples_per_window), or a row or column as the channel, for an "
                f"array of shape {shape}"
            )
        turned = signals if cutting.windows_in is WindowsIn.ROWS else tuple(values.T for values in signals)
        if not turned[0].size:
            raise RecordingFormatError(f"{where}: expected windows of samples; got an array of shape {shape}")
        return list(zip(*turned, strict=True)), []
    if cutting.windows_in is not None:
        raise RecordingFormatError(f"{where}: expected a two-dimensional array for windows_in; got shape {shape}")
    size = signals[0].size
    length = length or size
    n_windows = size // length if length else 0
    pieces = [tuple(values[i * length : (i + 1) * length] for values in signals) for i in range(n_windows)]
    rest = size - n_windows * length
    if not rest:
        return pieces, []
    of = f"{size} samples of {record.file_name}" + (f" from {record.delay:.6g} s on" if record.delay else "")
    what = f"the last {rest} of {of} ({rest / record.sample_rate:.4g} s)"
    return pieces, [LeftOut(what, f"they make no whole window of {length} samples")]


def _delayed(record: Record) -> list[LeftOut]:
    if record.delay * record.sample_rate < 0.5:
        return []
    return [LeftOut(f"the first {record.delay:.6g} s of {record.file_name}", "not every channel covers them")]


def _numbered(windows: Sequence[Window], step: float) -> list[Window]:
    """Give measurements numbers: windows that follow each other within a step of the first are one [m]."""
    counts: dict[str, int] = {}
    numbered: list[Window] = []
    begun: Window | None = None
    for window in windows:
        if begun is None or not _together(begun, window, step):
            begun = window
            counts[window.measurement] = counts.get(window.measurement, 0) + 1
        numbered.append(replace(window, measurement=f"{window.measurement} {counts[window.measurement]}"))
    return numbered


def _together(first: Window, window: Window, step: float) -> bool:
    def stated(of: Window) -> tuple[object, ...]:
        return of.measurement, of.direction, of.conditions.payload_mass, of.conditions.preload

    return stated(first) == stated(window) and abs(window.conditions.position - first.conditions.position) <= step


def _require_files(paths: Sequence[Path]) -> None:
    if not paths:
        raise RecordingFormatError("expected at least one raw file; got none")
    names = [path.name for path in paths]
    for name in names:
        if names.count(name) > 1:
            raise RecordingFormatError(
                f"{name}: expected files of different names; got {names.count(name)} of this one"
            )


def _require_apart(windows: Sequence[tuple[Window, Path]]) -> None:
    """Refuse files that overlap in time: an axis does one thing at a time."""
    for (window, path), (later, other) in pairwise(windows):
        end = window.started_at + timedelta(seconds=(window.n_samples - 0.5) / window.sample_rate)
        if path != other and later.started_at < end:
            raise RecordingFormatError(
                f"{other.name}: expected a file that begins after {path.name} ends, at {end.isoformat()}; it begins at "
                f"{later.started_at.isoformat()}"
            )


def _unused(paths: Sequence[Path], channel_map: ChannelMap) -> list[str]:
    given = {path.name for path in paths}
    missing = [name for name, _ in channel_map.files if name not in given]
    return [f"[[files]] of the map names {name!r}, which is not given" for name in missing]


def _doubts_of_channels(channels: Channels, sources: Sequence[MappedChannel]) -> list[str]:
    doubts = list[str]()
    for source in sources:
        signal, resolved = signal_of(channels, source)
        if signal.gaps:
            doubts.append(f"{channels.file_name}, {signal.name}: some samples are no numbers: {signal.gaps}")
        doubts += doubts_of_numbers(signal.samples, resolved, f"{channels.file_name}, {signal.name}")
    return doubts


def _names(paths: Sequence[Path]) -> str:
    return ", ".join(path.name for path in paths[:5]) + (", …" if len(paths) > 5 else "")
