"""Check a file: recognise its format by its content, read it to the end, and say what is in it and who can use it."""

import ast
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import islice
from pathlib import Path

import numpy as np

from monitor_core.errors import MonitorCoreError, RecordingFormatError
from monitor_core.recording import Window
from monitor_core.recordings import motion_csv, usability
from monitor_core.recordings.elements.files import read_text
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.modal_csv import ModalRow, read_modal_table
from monitor_core.recordings.raw import inspection
from monitor_core.recordings.raw.channel_time import even_time
from monitor_core.recordings.raw.channels import Channel
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.inspection import AsProposed, ChannelSummary
from monitor_core.recordings.raw.mapping.channel_map import read_channel_map
from monitor_core.recordings.raw.proposal.parts import Made, holds_spectra_alone, made_of, parts_of
from monitor_core.recordings.raw.proposal.sampling import said_of_texts
from monitor_core.recordings.raw.proposal.signals import signals_in, what_they_show
from monitor_core.recordings.recognition import (
    CALIBRATION,
    CHANNEL_MAP,
    EFFECTS,
    FRF_SET,
    KINDS,
    MODAL_TABLE,
    MODEL,
    MOTION_RECORD,
    SESSION,
    UNKNOWN,
    format_of,
    is_raw,
)
from monitor_core.recordings.session_hdf5 import channels_of, open_session
from monitor_core.recordings.usability import Settings, Use

__all__ = ["FileReport", "check_file", "format_of"]

_MOST_PROBLEMS = 20
#: Positions closer than this are one place that was driven to again.
_SAME_PLACE = 0.5  # [mm]
_LARGEST_PLACE = 3.0  # positions below, throughout a table in millimetres, are doubted [mm]


@dataclass(frozen=True, slots=True)
class FileReport:
    """What a file is, whether it holds to its format, each thing that does not fit in one sentence, and who takes it.

    ``contents`` are facts by name, as numbers, texts and tuples of them; ``doubts`` are about a file that is valid.
    ``read`` is what was read of a raw file or a motion record: whoever draws it, or writes a map for it, need not read
    it again.
    """

    format: str
    valid: bool
    problems: tuple[str, ...]
    channels: tuple[ChannelSummary, ...] = ()
    contents: tuple[tuple[str, object], ...] = ()
    doubts: tuple[str, ...] = ()
    uses: tuple[Use, ...] = ()
    next_step: str = ""
    lacks: str = ""  # what keeps a calibration from a session
    read: AsProposed | None = field(default=None, repr=False, compare=False)

    @property
    def usable_by(self) -> tuple[str, ...]:
        """Names of the commands that take the file as it is."""
        return tuple(use.command for use in self.uses)

    @property
    def usable_with_map(self) -> tuple[str, ...]:
        """Names of the commands that take a raw file together with a channel map; none for other files."""
        return usability.WITH_MAP if self.valid and is_raw(self.format) and self.uses else ()


def check_file(path: Path) -> FileReport:
    """Recognise a file by its content and read all of it.

    It may be a session, an FRF set, a modal table, a motion record, a calibration, a drive model, a channel map, or a
    raw file. Of a raw file the channels are listed with what their values show; what they mean is for a channel map to
    say. Of a session every window and of an FRF set every condition is looked at, and at most 20 problems are listed.
    ``MissingReaderError`` if the format needs an optional library that is not installed: that is no fault of the file.
    """
    try:
        name = format_of(path)
    except RecordingFormatError as error:
        return FileReport(UNKNOWN, False, (str(error),))
    try:
        report = _LOOKS.get(name, _look_at_raw if is_raw(name) else _refuse)(name, path)
    except RecordingFormatError as error:
        return FileReport(name, False, (str(error),))
    if len(report.problems) > _MOST_PROBLEMS:
        listed = (*report.problems[:_MOST_PROBLEMS], f"{path.name}: further problems are not listed")
        report = replace(report, problems=listed)
    return report if report.valid else replace(report, uses=(), next_step="")


def _refuse(name: str, path: Path) -> FileReport:
    """Return the report of a file that no command takes."""
    kind = KINDS[name]
    advice = f": {kind.advice}" if kind.advice else ""
    return FileReport(name, False, (f"{path.name}: expected a recording; got {kind.what}{advice}",))


def _look_at_session(name: str, path: Path) -> FileReport:
    """Read every window of a session, one at a time."""
    gathered, problems = _Gathered(), list[str]()
    with open_session(path, compared=True) as reader:
        for window in reader.measurement_of:
            try:
                gathered.add(reader.window(window), reader.measurement_of[window])
            except RecordingFormatError as error:
                problems.append(str(error))
                if len(problems) > _MOST_PROBLEMS:
                    break
    settings = gathered.as_settings()
    channels = tuple(_joined(channel, windows) for channel, windows in gathered.channels.items())
    uses = usability.uses_of_session(path, settings)
    contents = [
        ("axis_id", reader.axis_id),
        ("windows", len(reader.measurement_of)),
        ("measurements", len(reader.measurements)),
        ("positions_mm", settings.positions_mm),
        ("preloads_n", settings.preloads_n),
        ("first_window_at", min(gathered.starts, default=None)),
        ("last_window_at", max(gathered.starts, default=None)),
    ]
    lacks = settings.lacks_for_calibration
    next_step = usability.next_step(name, path, uses, lacks)
    return FileReport(
        name, not problems, tuple(problems), channels, tuple(contents), _doubts(channels), uses, next_step, lacks
    )


@dataclass(slots=True)
class _Gathered:
    """What the windows of a session say, as far as they were read."""

    channels: dict[str, list[ChannelSummary]] = field(default_factory=dict)
    settings: dict[str, tuple[float, float | None]] = field(default_factory=dict)  # of each measurement
    starts: list[datetime] = field(default_factory=list)

    def add(self, window: Window, measurement: str) -> None:
        for channel in _channels_of(window):
            self.channels.setdefault(channel.name, []).append(inspection.summary_of(channel))
        conditions = window.conditions
        self.settings.setdefault(measurement, (to_millimetres(conditions.position), conditions.preload))
        self.starts.append(window.started_at)

    def as_settings(self) -> Settings:
        known = [(position, preload) for position, preload in self.settings.values() if preload is not None]
        return Settings(
            n_readings=len(self.settings),
            positions_mm=_places([position for position, _ in self.settings.values()]),
            preloads_n=tuple(sorted({preload for _, preload in known})),
            n_with_preload=len(known),
        )


def _places(positions_mm: list[float]) -> tuple[float, ...]:
    """Return distinct positions, rising; those of one place are counted once."""
    distinct: list[float] = []
    for position in sorted(positions_mm):
        if not distinct or position - distinct[-1] > _SAME_PLACE:
            distinct.append(position)
    return tuple(distinct)


def _channels_of(window: Window) -> Iterator[Channel]:
    time = even_time(window.n_samples, window.sample_rate, 0.0, window.started_at)
    return (Channel(name, samples, unit, time) for name, (samples, unit) in channels_of(window).items())


def _joined(name: str, windows: list[ChannelSummary]) -> ChannelSummary:
    """Put the summaries of one channel in all windows together."""
    first, n = windows[0], len(windows)
    rates = {window.sample_rate for window in windows}
    units = {window.unit for window in windows}
    lengths = {window.shape for window in windows}
    counts = {
        "not finite": sum(window.n_not_finite > 0 for window in windows),
        "constant": sum(window.is_constant for window in windows),
        "stuck": sum(window.is_stuck for window in windows),
        "clipped": sum(window.is_clipped for window in windows),
    }
    remarks = [f"{what} in {count} of {n} windows" for what, count in counts.items() if count]
    if len(lengths) > 1:
        remarks.append(f"windows of {min(lengths)[0]} to {max(lengths)[0]} samples")
    if len(rates) > 1:
        remarks.append(f"sampled at {', '.join(f'{rate:g} Hz' for rate in sorted(rate or 0.0 for rate in rates))}")
    if len(units) > 1:
        remarks.append(f"windows in {' and in '.join(sorted(unit or '?' for unit in units))}")
    known = [window for window in windows if window.minimum is not None]
    return replace(
        first,
        name=name,
        shape=(n, max(lengths)[0]),
        minimum=min((window.minimum for window in known if window.minimum is not None), default=None),
        maximum=max((window.maximum for window in known if window.maximum is not None), default=None),
        n_not_finite=int(np.sum([window.n_not_finite for window in windows])),
        is_constant=counts["constant"] == n,
        is_stuck=counts["stuck"] > 0,
        is_clipped=counts["clipped"] > 0,
        remarks=tuple(remarks),
        doubts=tuple(dict.fromkeys(doubt for window in windows for doubt in window.doubts))[:1],
    )


def _look_at_frf_set(name: str, path: Path) -> FileReport:
    # imported here: an FRF set brings the drive models along
    from monitor_core.recordings.frf_set import open_frf_set  # noqa: PLC0415

    with open_frf_set(path) as reader:
        conditions = reader.conditions
        problems = tuple(islice(_refusals(reader.measured, conditions), _MOST_PROBLEMS + 1))
    uses = usability.uses_of(name, path)
    next_step = usability.next_step(name, path, uses)
    return FileReport(name, not problems, problems, (), (("conditions", len(conditions)),), (), uses, next_step)


def _refusals(read: Callable[[str], object], names: Iterable[str]) -> Iterator[str]:
    for name in names:
        try:
            read(name)
        except RecordingFormatError as error:
            yield str(error)


def _look_at_modal_table(name: str, path: Path) -> FileReport:
    rows = read_modal_table(path)
    settings = _settings_of(rows)
    uses = usability.uses_of_table(path, settings)
    contents = [
        ("rows", settings.n_readings),
        ("positions_mm", settings.positions_mm),
        ("preloads_n", settings.preloads_n),
        ("frequencies_hz", (min(row.frequency for row in rows), max(row.frequency for row in rows))),
    ]
    doubts = []
    positions = {to_millimetres(row.position) for row in rows}
    if len(positions) > 1 and max(positions) < _LARGEST_PLACE:
        doubts.append(f"position_mm: positions of at most {max(positions):g} mm: are these numbers in metres?")
    next_step = usability.next_step(name, path, uses, settings.lacks_for_calibration)
    return FileReport(name, True, (), (), tuple(contents), tuple(doubts), uses, next_step)


def _settings_of(rows: Sequence[ModalRow]) -> Settings:
    preloads = [row.preload for row in rows if row.preload is not None]
    positions = _places([to_millimetres(row.position) for row in rows])
    return Settings(len(rows), positions, tuple(sorted(set(preloads))), len(preloads))


def _look_at_motion(name: str, path: Path) -> FileReport:
    record = motion_csv.read_motion_record(path)
    read = AsProposed(read_channels(path), None)
    channels = inspection.summaries_of(read.channels)
    contents = [
        ("samples", int(record.position.size)),
        ("sample_rate_hz", record.sample_rate),
        ("drive", str(record.quantity)),
    ]
    uses = usability.uses_of(name, path)
    next_step = usability.next_step(name, path, uses)
    return FileReport(name, True, (), channels, tuple(contents), _doubts(channels), uses, next_step, read=read)


def _look_at_raw(name: str, path: Path) -> FileReport:
    read = inspection.read_as_proposed(path, name)
    channels = inspection.summaries_of(read.channels, read.figures)
    alone = holds_spectra_alone(read.channels)
    uses = () if alone else usability.uses_of(name, path, made_of(read.channels))
    next_step = usability.next_step(name, path, uses)
    doubts = (*_doubts(channels), *said_of_texts(read.channels))
    return FileReport(name, True, (), channels, _contents_of_raw(read), doubts, uses, next_step, read=read)


def _contents_of_raw(as_proposed: AsProposed) -> tuple[tuple[str, object], ...]:
    read, layout = as_proposed.channels, as_proposed.layout
    responses = tuple(f"{each.name}: {inspection.response_remark(each)}" for each in read.responses)
    contents: list[tuple[str, object]] = [("frequency_responses", responses)] if responses else []
    if made_of(read) is Made.SESSION and (shows := what_they_show(signals_in(parts_of(read)))):
        contents.append(("what_it_shows", shows))
    if texts := read.texts:
        contents.append(("columns_of_texts", tuple(f"{name}: {values[0]}" for name, values in texts.items() if values)))
    if read.numbers:
        contents.append(("single_numbers", tuple(f"{name}: {value:g}" for name, value in read.numbers.items())))
    if read.left_out:
        contents.append(("not_read", read.left_out))
    if layout is not None:
        contents.append(("text", inspection.layout_remark(layout)))
    return tuple(contents)


def _look_at_calibration(name: str, path: Path) -> FileReport:
    # imported here: a calibration brings the preload mathematics along, which no other format needs
    from monitor_core.recordings.calibration_file import read_calibration  # noqa: PLC0415

    calibration = read_calibration(path)
    position, preload = calibration.position, calibration.preload
    contents = [
        ("readings", calibration.n_readings),
        ("positions_mm", (to_millimetres(position.lower), to_millimetres(position.upper))),
        ("preloads_n", (preload.lower, preload.upper)),
    ]
    return _plain(name, path, contents)


def _look_at_model(name: str, path: Path) -> FileReport:
    # imported here: a drive model brings the four families along
    from monitor_core.models.motion import FAMILY as MOTION  # noqa: PLC0415
    from monitor_core.recordings.model_file import read_model_file  # noqa: PLC0415

    axis = read_model_file(path)
    is_motion = axis.family == MOTION
    try:  # a model whose parts do not fit each other is read, and refused where it is used
        axis.build_motion() if is_motion else axis.build()
    except MonitorCoreError as error:
        return FileReport(name, False, (f"{path.name}: {error}",))
    uses = usability.uses_of_model(
        path,
        is_motion=is_motion,
        needs_preload="dynamic_load_rating_n" in axis.parameters,
        has_effects=bool(axis.effects),
    )
    contents = (("family", axis.family), ("uncertain", tuple(axis.uncertain)), ("effects", tuple(axis.effects)))
    return FileReport(name, True, (), (), contents, (), uses, usability.next_step(name, path, uses))


def _look_at_map(name: str, path: Path) -> FileReport:
    read_channel_map(path)
    return _plain(name, path, [])


def _look_at_effects(name: str, path: Path) -> FileReport:
    """Look at a file of effects without running it."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of its spelling, which Python would print
            tree = ast.parse(read_text(path))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise RecordingFormatError(f"{path.name}: expected a Python file of effects; {error}") from error
    names = {target.id for node in ast.walk(tree) for target in _targets(node) if isinstance(target, ast.Name)}
    if "EFFECTS" not in names:
        raise RecordingFormatError(f"{path.name}: expected a definition of EFFECTS, a tuple of effects; it is missing")
    return _plain(name, path, [("effects", "not looked at: the file is a program, and check runs none")])


def _targets(node: ast.AST) -> Sequence[ast.expr]:
    if isinstance(node, ast.Assign):
        return node.targets
    return (node.target,) if isinstance(node, ast.AnnAssign) else ()


def _plain(name: str, path: Path, contents: Sequence[tuple[str, object]]) -> FileReport:
    uses = usability.uses_of(name, path)
    return FileReport(name, True, (), (), tuple(contents), (), uses, usability.next_step(name, path, uses))


def _doubts(channels: Sequence[ChannelSummary]) -> tuple[str, ...]:
    return tuple(f"{channel.name}: {doubt}" for channel in channels for doubt in channel.doubts)


_LOOKS: dict[str, Callable[[str, Path], FileReport]] = {
    SESSION: _look_at_session,
    FRF_SET: _look_at_frf_set,
    MODAL_TABLE: _look_at_modal_table,
    MOTION_RECORD: _look_at_motion,
    CALIBRATION: _look_at_calibration,
    MODEL: _look_at_model,
    CHANNEL_MAP: _look_at_map,
    EFFECTS: _look_at_effects,
}
