"""Import raw files with their channel map: the only place where the service calls what the command line calls."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from monitor_core.recording import Session
from monitor_core.recordings.raw.channel_map import read_channel_map
from monitor_core.recordings.raw.channels import Channel
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.mapped import read_mapped


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something of a recording that became no window."""

    what: str
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """A session made of raw files."""

    session: Session
    left_out: tuple[LeftOut, ...] = ()


def import_raw(paths: Sequence[Path], map_path: Path) -> Imported:
    """Make a session of raw files; raises RecordingFormatError as the readers do."""
    channel_map = read_channel_map(map_path)
    sessions = [read_mapped(path, channel_map) for path in paths]
    windows = sorted((window for session in sessions for window in session.windows), key=lambda w: w.started_at)
    return Imported(Session(channel_map.axis_id, tuple(windows), channel_map.description))


def channels_of(path: Path) -> tuple[Channel, ...]:
    """Return the channels of a raw file."""
    return read_channels(path).channels
