"""Read what a command works on: a file of the product, or raw files with the channel map that says what they mean.

The options that say so stand here, too, and those of a session; a file of another kind than a command takes is refused
with what it is and the next step, whatever its name.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar, cast

import click

from monitor_core.pipeline import AxisSettings
from monitor_core.recording import MotionRecord, Window
from monitor_core.recordings.elements.files import listed
from monitor_core.recordings.motion_csv import read_motion_record
from monitor_core.recordings.raw.mapping.channel_map import read_channel_map
from monitor_core.recordings.raw.mapping.imported import ImportedMotion, ImportedSession, import_motion, import_session
from monitor_core.recordings.raw.mapping.map_records import ChannelMap, MapKind
from monitor_core.recordings.recognition import (
    CALIBRATION,
    CHANNEL_MAP,
    FRF_SET,
    KINDS,
    MODAL_TABLE,
    MOTION_RECORD,
    SESSION,
)
from monitor_core.session import RecordedMeasurements
from monitor_core.uncertainty import Estimate
from service.cli.output import print_line, progress_bar
from service.operations.foreign_file import foreign_format, foreign_session, read_foreign, reading
from service.operations.own_process import Progress, Report, Reporting

# an FRF set brings the drive models along, and with them half the start of a command: imported where there is one
if TYPE_CHECKING:
    from monitor_core.recordings.frf_set import FrequencyResponseSet
    from monitor_core.recordings.raw.mapping.imported_frf import ImportedFrfSet

SESSION_SUFFIXES = (".h5", ".hdf5")


class DataKind(StrEnum):
    """What the data of a command are, as a sentence calls it."""

    FRF_SET = "set of frequency responses"
    SESSION = "session"
    MODAL_TABLE = "modal table"
    MOTION = "motion record"


_OF_MAP = {
    MapKind.SESSION: DataKind.SESSION,
    MapKind.MOTION: DataKind.MOTION,
    MapKind.FRF_SET: DataKind.FRF_SET,
}
_OF_FORMAT = {
    SESSION: DataKind.SESSION,
    FRF_SET: DataKind.FRF_SET,
    MOTION_RECORD: DataKind.MOTION,
    MODAL_TABLE: DataKind.MODAL_TABLE,
}
#: So many sentences are printed of each kind: forty files say the same forty times.
_MOST_SAID = 5

data_argument = click.argument("paths", metavar="DATA…", nargs=-1, required=True, type=click.Path(path_type=Path))
map_option = click.option(
    "--map", "map_path", type=click.Path(path_type=Path), metavar="MAP",
    help="Channel map, TOML: says what the channels of raw files mean. With it DATA are one or several raw files.",
)  # fmt: skip
band_option = click.option(
    "--band-hz",
    nargs=2,
    type=click.FloatRange(min=0, min_open=True),
    metavar="LOW HIGH",
    help="Where the axial mode is looked for, and what a fit keeps to; without it nearly everywhere below 0.4 of the "
    "sampling rate.",
)

Imported: TypeAlias = "ImportedSession | ImportedMotion | ImportedFrfSet"
Made = TypeVar("Made", ImportedSession, ImportedMotion, "ImportedFrfSet")


def calibration_at(path: Path) -> Path:
    """Return the path of a calibration; any other file is refused."""
    foreign_format(path, CALIBRATION)
    return path


def require_band(band_hz: tuple[float, float] | None) -> None:
    """Refuse a band that ends before it begins."""
    if band_hz is not None and not band_hz[0] < band_hz[1]:
        raise click.BadParameter(f"--band-hz takes LOW before HIGH; got {band_hz[0]:g} {band_hz[1]:g}")


def axis_settings(band_hz: tuple[float, float] | None, moving_mass: Estimate | None = None) -> AxisSettings:
    """Return the settings that the command's options state."""
    require_band(band_hz)
    return AxisSettings(search_band=band_hz, moving_mass=moving_mass)


@dataclass(frozen=True, slots=True)
class Data:
    """What a command works on."""

    paths: tuple[Path, ...]
    kind: DataKind
    channel_map: ChannelMap | None  # of raw files

    @property
    def name(self) -> str:
        """What a title calls it."""
        return self.paths[0].name + (f" and {len(self.paths) - 1} more" if len(self.paths) > 1 else "")

    @property
    def is_session(self) -> bool:
        """Whether it has windows."""
        return self.kind is DataKind.SESSION

    @property
    def is_frf_set(self) -> bool:
        """Whether it has frequency responses."""
        return self.kind is DataKind.FRF_SET

    @property
    def file(self) -> Path:
        """The one file of the product."""
        return self.paths[0]


def data_of(paths: Sequence[Path], map_path: Path | None, *, takes: Sequence[DataKind]) -> Data:
    """Recognise what a command is given, before any work; what it does not take is refused with the next step."""
    if map_path is None:
        if len(paths) > 1:
            raise click.UsageError(
                f"several files are raw files of one recording, and need --map; got {len(paths)} files without it"
            )
        return Data(tuple(paths), _kind_of_file(paths[0], takes), None)
    foreign_format(map_path, CHANNEL_MAP)
    channel_map = read_channel_map(map_path)
    kind = _OF_MAP[channel_map.kind]
    if kind not in takes:
        raise click.UsageError(f"{map_path.name} makes a {kind} of raw files; expected {_wanted(takes)}")
    return Data(tuple(paths), kind, channel_map)


def _kind_of_file(path: Path, takes: Sequence[DataKind]) -> DataKind:
    """Recognise a file by its content; another kind is refused with what it is and the next step."""
    return _OF_FORMAT[foreign_format(path, *(name for name, kind in _OF_FORMAT.items() if kind in takes))]


@dataclass(frozen=True, slots=True)
class _WatchedSession:
    """A session that counts the measurements taken from it."""

    reader: RecordedMeasurements
    count: Callable[[], None]

    @property
    def measurements(self) -> tuple[str, ...]:
        return self.reader.measurements

    def windows_of(self, measurement: str) -> tuple[Window, ...]:
        self.count()
        return self.reader.windows_of(measurement)


@contextmanager
def counted_session(session: RecordedMeasurements, name: str) -> Iterator[RecordedMeasurements]:
    """Show how many measurements of a session were taken."""
    with progress_bar() as progress:
        task = progress.add_task(name, total=len(session.measurements))
        yield _WatchedSession(session, lambda: progress.advance(task))


@contextmanager
def opened_session(data: Data) -> Iterator[RecordedMeasurements]:
    """Open the session of the data and show how many of its measurements were taken; memory stays flat."""
    if data.channel_map is None:
        with foreign_session(data.file) as reader, counted_session(reader, data.name) as session:
            yield session
        return
    with counted_session(_imported_as(ImportedSession, data).session, data.name) as session:
        yield session


def frf_set_of(data: Data) -> "FrequencyResponseSet":
    """Return the frequency responses of the data."""
    from monitor_core.recordings.frf_set import read_frf_set  # noqa: PLC0415
    from monitor_core.recordings.raw.mapping.imported_frf import ImportedFrfSet  # noqa: PLC0415

    if data.channel_map is None:
        return read_foreign(partial(read_frf_set, data.file), data.name)
    return _imported_as(ImportedFrfSet, data).responses


def motion_of(data: Data) -> MotionRecord:
    """Return the motion record of the data."""
    if data.channel_map is None:
        return read_motion_record(data.file)
    return _imported_as(ImportedMotion, data).record


def _imported_as(kind: type[Made], data: Data) -> Made:
    """Read raw files by their map, print what is to be said of them, and return what was made of them."""
    imported = import_of(data)
    say(imported)
    if not isinstance(imported, kind):
        raise TypeError(f"a {data.kind} of raw files is no {kind.__name__}")
    return imported


def import_of(data: Data) -> Imported:
    """Read raw files by their map, with progress."""
    if data.channel_map is None:
        raise click.UsageError(f"raw files need --map; got {data.name} without it")
    work = Reporting(partial(_imported, data.paths, data.channel_map))
    with reading(work, data.name) as process, progress_bar() as bar:  # the bar has a thread, which a fork would break
        task = bar.add_task(data.name, total=len(data.paths))

        def report(progress: Progress) -> None:
            bar.update(task, description=progress.sentence or data.name, completed=progress.done)

        return cast(Imported, process.answer(report))


def _imported(paths: Sequence[Path], channel_map: ChannelMap, report: Report) -> Imported:
    n_begun = count()

    def begun(name: str) -> None:
        report(Progress(next(n_begun), sentence=name))

    match channel_map.kind:
        case MapKind.SESSION:
            return import_session(paths, channel_map, begun)
        case MapKind.MOTION:
            return import_motion(paths, channel_map, begun)
        case MapKind.FRF_SET:
            from monitor_core.recordings.raw.mapping.imported_frf import import_frf_set  # noqa: PLC0415

            return import_frf_set(paths, channel_map, begun)


def say(imported: Imported) -> None:
    """Print on standard error what was left out of raw files, and what is to be said of them; of many, the first."""
    left_out = [f"left out: {left.what}: {left.why}" for left in imported.left_out]
    for sentences in (left_out, imported.remarks):
        for sentence in sentences[:_MOST_SAID]:
            print_line(sentence, err=True)
        if len(sentences) > _MOST_SAID:
            print_line(f"… and {len(sentences) - _MOST_SAID} more; preload import --json lists all", err=True)


def _wanted(kinds: Sequence[DataKind]) -> str:
    columns = {kind: KINDS[name].columns for name, kind in _OF_FORMAT.items()}
    return listed([f"a {kind}{f' ({columns[kind]})' if columns[kind] else ''}" for kind in kinds])
