"""Look into an uploaded recording before anything of it is stored as a window: each is made and checked once."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Window
from monitor_core.recordings.session_hdf5 import channels_of, open_session, stated_of, write_session
from service.clock import text_of
from service.documents.recording import ChannelEntry
from service.errors import BodyTooLargeError, first_refusal
from service.operations.fields import MOST_SAMPLES, StatedOfWindow
from service.operations.own_process import Progress, Report
from service.store.recordings import Room, not_taken
from service.store.window_format import size_of

if TYPE_CHECKING:
    from monitor_core.recordings.raw.channels import Channel, Channels
    from monitor_core.recordings.raw.mapping.imported import LeftOut

SESSION_SUFFIX = ".session.h5"
#: Samples may take so many times the room of the largest file that is taken: files are compressed.
MOST_EXPANSION = 4
#: The windows of a measurement are averaged together, so they are in memory together.
LARGEST_MEASUREMENT_BYTES = 2**30
#: So many channels are listed.
MOST_CHANNELS = 1000
_LONGEST_TEXT = 200
_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class LookBounds:
    """How large a recording may be."""

    samples_bytes: int  # of all its windows
    measurement_bytes: int  # of the windows of one measurement
    room: Room  # on the disk


def bounds_of(most_bytes: int, room: Room) -> LookBounds:
    """Return the bounds where the files of a recording may be of so many bytes."""
    return LookBounds(MOST_EXPANSION * most_bytes, LARGEST_MEASUREMENT_BYTES, room)


@dataclass(frozen=True, slots=True)
class Look:
    """What was found in a recording, and where the session is whose windows can be taken."""

    session_path: Path
    axis_id: str  # as the recording says
    n_windows: int
    n_measurements: int
    channels: list[ChannelEntry]
    left_out: "tuple[LeftOut, ...]" = ()
    remarks: tuple[str, ...] = ()  # on how the session was made of raw files


def look_into(paths: Sequence[Path], map_path: Path | None, folder: Path, bounds: LookBounds, report: Report) -> Look:
    """Open a session, or make one in a folder of raw files and their map; every window of it is checked.

    Raises RecordingFormatError if it is no session, does not fit its map, or a window is not one that can be taken;
    BodyTooLargeError if its samples take more room than a recording may; MissingReaderError; StorageError.
    """
    from monitor_core.recordings.raw.mapping.channel_map import read_channel_map  # noqa: PLC0415  # a start reads no file
    from monitor_core.recordings.raw.mapping.imported import import_session  # noqa: PLC0415

    windows = _Windows(bounds)
    if map_path is None:
        return _session(paths, windows, report)
    channels: list[ChannelEntry] = []

    def note(read: "Channels") -> None:
        channels.extend(_channel(read.file_name, channel, read.started_at(channel)) for channel in read.channels)

    imported = import_session(
        paths, read_channel_map(map_path), lambda name: report(Progress(len(channels), sentence=name)), seen=note
    )
    session = imported.session
    measurement_of = {id(window): name for name in session.measurements for window in session.windows_of(name)}
    for number, window in enumerate(session.windows, start=1):
        where = f"{paths[0].name}, window number {number}" if len(paths) == 1 else f"window number {number}"
        windows.require_length(window.excitation.size, where)
        windows.require(window, measurement_of[id(window)], where)
    path = folder / f"{paths[0].stem}{SESSION_SUFFIX}"
    bounds.room.require(2 * size_of(session.windows))  # the windows are stored besides
    try:
        write_session(path, session, tolerances=imported.tolerances.attributes)
    except OSError as error:
        raise not_taken(error) from error
    return Look(
        session_path=path,
        axis_id=plain(session.axis_id),
        n_windows=len(session.windows),
        n_measurements=len(session.measurements),
        channels=channels[:MOST_CHANNELS],
        left_out=imported.left_out,
        remarks=imported.remarks,
    )


def _session(paths: Sequence[Path], windows: "_Windows", report: Report) -> Look:
    path = paths[0]
    with path.open("rb") as file:
        is_hdf5 = file.read(len(_HDF5)) == _HDF5
    if not is_hdf5:
        raise RecordingFormatError(
            f"{path.name}: expected a session (HDF5), or a raw file with its channel map in the part 'map'; got "
            "another file without a map"
        )
    if len(paths) > 1:
        raise RecordingFormatError(f"expected one session at once, or raw files with a map; got {len(paths)} files")
    with open_session(path, compared=True) as session:
        seen = _Seen(path.name)
        for number, name in enumerate(session.measurement_of):
            report(Progress(number, len(session.measurement_of)))
            where = f"{path.name} /windows/{name}"
            windows.require_length(session.length(name), where)
            window = session.window(name)
            windows.require(window, session.measurement_of[name], where)
            seen.add(window)
        axis_id = plain(session.axis_id)
        return Look(path, axis_id, len(session.measurement_of), len(session.measurements), seen.channels())


class _Windows:
    """Checks the windows of one recording, one after the other."""

    def __init__(self, bounds: LookBounds) -> None:
        self._bounds = bounds
        self._bytes = 0
        self._by_measurement: Counter[str] = Counter()
        self._last_start: datetime | None = None

    def require_length(self, n_samples: int, where: str) -> None:
        """Refuse a window that is too long, before it is read."""
        if n_samples > MOST_SAMPLES:
            raise RecordingFormatError(
                f"{where}: expected at most {MOST_SAMPLES} samples in a window; got {n_samples}. Cut it into several "
                "(samples_per_window of the map)"
            )

    def require(self, window: Window, measurement: str, where: str) -> None:
        """Refuse a window that could not be sent by itself, or that makes the recording too large."""
        stated = stated_of(window) | {"started_at": window.started_at}
        try:
            StatedOfWindow.model_validate({name: stated[name] for name in StatedOfWindow.model_fields})
        except ValidationError as error:
            raise RecordingFormatError(f"{where}, {first_refusal(error)}") from error
        if window.started_at == self._last_start:
            raise RecordingFormatError(
                f"{where}: expected windows that start at different times; two start at {text_of(window.started_at)}"
            )
        self._last_start = window.started_at
        n_bytes = size_of([window])
        self._bytes += n_bytes
        self._by_measurement[measurement] += n_bytes
        if self._bytes > self._bounds.samples_bytes:
            raise BodyTooLargeError(
                f"{where}: the samples of a recording may take {self._bounds.samples_bytes >> 20} MiB (four times "
                "PRELOAD_MAX_RECORDING_MIB); they take more up to here"
            )
        if self._by_measurement[measurement] > self._bounds.measurement_bytes:
            raise BodyTooLargeError(
                f"{where}: the samples of one measurement may take {self._bounds.measurement_bytes >> 20} MiB; those "
                f"of {measurement!r} take more up to here. Give its parts names of their own"
            )


class _Seen:
    """The channels that the windows of a session have, and how many samples of each."""

    def __init__(self, file_name: str) -> None:
        self._file_name = file_name
        self._n_samples: Counter[tuple[str, str | None, float]] = Counter()
        self._first: dict[tuple[str, str | None, float], datetime] = {}

    def add(self, window: Window) -> None:
        """Note the channels of a window."""
        for name, (_, unit) in channels_of(window).items():
            key = (name, unit, window.sample_rate)
            self._n_samples[key] += window.n_samples
            self._first.setdefault(key, window.started_at)

    def channels(self) -> list[ChannelEntry]:
        """Return them; those of different units or rates are different channels."""
        return [
            ChannelEntry(
                file=self._file_name,
                name=name,
                shape=[n_samples],
                unit=unit,
                sample_rate_hz=rate,
                started_at=self._first[name, unit, rate],
            )
            for (name, unit, rate), n_samples in list(self._n_samples.items())[:MOST_CHANNELS]
        ]


def _channel(file_name: str, channel: "Channel", started_at: datetime | None) -> ChannelEntry:
    """Say of a channel what its file says."""
    rate = channel.time.sample_rate
    return ChannelEntry(
        file=file_name,
        name=plain(channel.name),
        shape=list(channel.shape),
        unit=None if channel.unit is None else plain(channel.unit),
        sample_rate_hz=rate if rate is not None and math.isfinite(rate) else None,
        started_at=started_at,
    )


def plain(text: str) -> str:
    """Return a text of a file as it can be stored and shown anywhere."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]", "\ufffd", text)[:_LONGEST_TEXT]
