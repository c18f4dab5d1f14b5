"""Read and write recorded sessions, ``*.session.h5``: window by window, the same bytes every time.

Root attributes ``format`` = "preload-session", ``version`` = 1, ``axis_id``; optional ``description``, ``created``.
Each group ``/windows/NNNNNN`` holds one window, in time order; the attributes and their units are those of
``docs/reference/recordings.md``. Units are fixed, so a wrong one is refused, never converted. Attributes that are not
known here are left alone. A window without ``measurement`` is a measurement of its own, named by its group.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recording import (
    Conditions,
    Direction,
    ExcitationQuantity,
    ExcitationSource,
    Placed,
    ResponseQuantity,
    Session,
    Visit,
    Window,
    span_of,
    told_apart,
)
from monitor_core.recordings.elements.bounds import FREE_BYTES, require_plausible_channels, require_plausible_expansion
from monitor_core.recordings.elements.fields import Fields, format_instant
from monitor_core.recordings.elements.files import naming, refusing, samples_at
from monitor_core.recordings.elements.hdf5 import (
    Column,
    attributes,
    attributes_at,
    column,
    numbered_groups,
    open_hdf5,
    write_attributes,
)
from monitor_core.recordings.elements.units import metres, to_millimetres
from monitor_core.recordings.session_index import FEWEST_WINDOWS, SessionIndex, read_index, row_of, seal, write_index

if TYPE_CHECKING:
    import h5py

FORMAT = "preload-session"
VERSION = 1
_IN_ASCII = str.maketrans("·²", ".2")
EXCITATION_UNIT = {quantity: quantity.unit.translate(_IN_ASCII) for quantity in ExcitationQuantity}
RESPONSE_UNIT = {quantity: quantity.unit.translate(_IN_ASCII) for quantity in ResponseQuantity}
_IN_NAMES = str.maketrans({"·": "", "/": "_", "²": "2"})
#: How the name of a column or of a key ends, ``m_s2``.
UNIT_IN_NAMES: dict[ExcitationQuantity | ResponseQuantity, str] = {
    quantity: quantity.unit.lower().translate(_IN_NAMES) for quantity in (*ExcitationQuantity, *ResponseQuantity)
}
_ROOT_ATTRIBUTES = frozenset(("format", "version", "axis_id", "description", "created"))
_WINDOW_ATTRIBUTES = frozenset((
    "sample_rate_hz", "excitation_quantity", "excitation_unit", "excitation_source", "response_quantity",
    "response_unit", "response_resolution", "position_mm", "position_span_mm", "direction", "payload_kg",
    "temperature_c", "preload_n",
))  # fmt: skip
#: What the frame of a session says of each window: which measurement it is of; the others are read with its samples.
_FRAME_ATTRIBUTES = frozenset(("started_at", "measurement", "position_mm", "preload_n"))
_CHANNELS = ("excitation", "response", "position", "reference")
_SAMPLES = ("float32", "float64")


@dataclass(frozen=True, slots=True, eq=False)
class SessionReader:
    """An open session file. Windows are read when asked for, so that memory stays flat; see :func:`open_session`."""

    axis_id: str
    description: str
    created: datetime | None
    measurement_of: Mapping[str, str]  # window's group name → its measurement, told apart, in time order
    _called: Mapping[str, str]  # window's group name → what its measurement is called
    _names_of: Mapping[str, tuple[str, ...]]  # measurement, told apart → group names of its windows, in time order
    _starts: Mapping[str, datetime]  # by the names of the groups
    _windows: "h5py.Group"
    _raw: BinaryIO  # the same file
    _where: str
    _index: SessionIndex | None
    _compared: bool

    @property
    def measurements(self) -> tuple[str, ...]:
        """Names, in order of first appearance; one that is repeated with the start of each measurement."""
        return tuple(self._names_of)

    def length(self, name: str) -> int:
        """Return how many samples the longest channel of a window has; none is read."""
        where = f"{self._where} /windows/{name}"
        with refusing(where, "a readable window"):
            if self._index is not None and not self._compared:
                return max((size for _, size, _ in self._index.places(name, where).values()), default=0)
            group = self._group(name)
            channels = [channel for channel in _CHANNELS if group.links.exists(channel.encode())]
            return max((column(group, channel, where, _SAMPLES).size for channel in channels), default=0)

    def window(self, name: str) -> Window:
        """Read one window by the name of its group."""
        where = f"{self._where} /windows/{name}"
        with refusing(where, "a readable window"):
            frame = self._starts[name], self._called[name]
            if self._index is not None and not self._compared:
                return _window(self._index.fields(name, where), _indexed_samples(self._index, name, where), *frame)
            group = self._group(name)
            fields, columns = attributes_at(group, _WINDOW_ATTRIBUTES, where), _columns(group, where)
            if self._index is not None:
                _require_agreement(self._index, name, fields, columns)
            return _window(fields, {name: self._samples(c, f"{where}/{name}") for name, c in columns.items()}, *frame)

    def _samples(self, column: Column, where: str) -> SampleArray:
        """Read a channel: from the file where it lies there as it is, which takes a fifth of the way through HDF5."""
        if column.start is None:
            return cast(SampleArray, column.values())
        return samples_at(self._raw, column.start, column.size, column.dtype, where)

    def _group(self, name: str) -> "h5py.h5g.GroupID":
        import h5py  # noqa: PLC0415

        return h5py.h5g.open(self._windows.id, name.encode())

    def windows(self) -> Iterator[Window]:
        """Read one window after the other, in time order."""
        return (self.window(name) for name in self.measurement_of)

    def windows_of(self, measurement: str) -> tuple[Window, ...]:
        """Read the windows of one measurement, in time order."""
        return tuple(self.window(name) for name in self._names_of.get(measurement, ()))


@contextmanager
def open_session(path: Path, *, compared: bool = False) -> Iterator[SessionReader]:
    """Open a session file and check its frame; the samples stay on disk until a window is asked for.

    ``path``: a ``*.session.h5`` file; ``compared``: whether what its index says, where it has one, is compared with
    each group. Returned: valid inside the ``with`` block. ``RecordingFormatError`` if the file is no such session: one
    sentence says what was expected, what was got, and where.
    """
    with open_hdf5(path) as file, path.open("rb") as raw:
        with refusing(path.name, f"a {FORMAT} file"):
            reader = _session_reader(file, raw, path.name, compared=compared)
        yield reader


def read_session(path: Path) -> Session:
    """Read a whole session into memory; raises as :func:`open_session`.

    Returned: windows in time order; samples in the precision of the file, positions in metres.
    """
    with open_session(path) as reader:
        return Session(reader.axis_id, tuple(reader.windows()), reader.description, reader.created)


def write_session(path: Path, session: Session, *, tolerances: Mapping[str, float | None] | None = None) -> None:
    """Write a session; the same session gives the same bytes, whenever it is written.

    ``path``: usually ``*.session.h5``; an existing file is replaced; ``session``: windows in time order;
    ``tolerances``: how well settings are known, by the names of root attributes; ``None`` is not stated.
    ``RecordingFormatError`` if the session holds no window, names no axis, or is not in time order.
    """
    import h5py  # noqa: PLC0415  # file libraries are imported where they are needed

    _require_content(session.axis_id, [w.started_at for w in session.windows], path.name)
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "axis_id": session.axis_id})
        if session.description:
            file.attrs["description"] = session.description
        if session.created is not None:
            file.attrs["created"] = format_instant(session.created)
        write_attributes(file, tolerances or {})
        windows = file.create_group("windows")
        rows = dict[str, dict[str, object]]()
        for number, window in enumerate(session.windows):
            group = windows.create_group(name := f"{number:06d}")
            rows[name] = row_of(group, _write_window(group, window))
        index = write_index(file, rows) if len(rows) >= FEWEST_WINDOWS else None
    if index is not None:
        seal(path, index)


def _session_reader(file: "h5py.File", raw: BinaryIO, where: str, *, compared: bool) -> SessionReader:
    root = attributes(file, _ROOT_ATTRIBUTES, f"{where} /")
    root.require_format(FORMAT, VERSION)
    windows = numbered_groups(file, "windows", 6, where)
    index = read_index(file, raw, windows.names, where)
    stated = {} if index is None else {name: index.fields(name, f"{where} /windows/{name}") for name in windows.names}
    if index is None or compared:
        by_group = windows.stated(_FRAME_ATTRIBUTES)
        for name, fields in stated.items():
            _require_same(fields, by_group[name], _FRAME_ATTRIBUTES)
        stated = by_group
    called = {name: fields.text("measurement") if "measurement" in fields else name for name, fields in stated.items()}
    starts = {name: fields.instant("started_at") for name, fields in stated.items()}
    axis_id = root.text("axis_id")
    _require_content(axis_id, list(starts.values()), where)
    reader = SessionReader(
        axis_id=axis_id,
        description=root.text("description") if root.values.get("description") else "",
        created=root.instant("created") if "created" in root else None,
        measurement_of={},
        _called=called,
        _names_of={},
        _starts=starts,
        _windows=windows.folder,
        _raw=raw,
        _where=where,
        _index=index,
        _compared=compared,
    )
    names_of = told_apart(_placed(reader, stated))
    measurement_of = {name: measurement for measurement, names in names_of.items() for name in names}
    return replace(reader, measurement_of={name: measurement_of[name] for name in called}, _names_of=names_of)


def _placed(reader: SessionReader, stated: Mapping[str, Fields]) -> dict[str, Placed]:
    """Say of each window what tells its measurement; how long it is only where a pause may end that."""
    placed = dict[str, Placed]()
    last = dict[str, str]()  # window of each name, so far
    for window, fields in stated.items():
        name, start = reader._called[window], reader._starts[window]
        before = last.get(name)
        if before is not None and start - placed[before].ended_at > Visit().pause:
            with suppress(RecordingFormatError):  # who reads it is told
                placed[before] = replace(placed[before], ended_at=reader.window(before).ended_at)
        position, preload = (_number_or_none(fields, entry) for entry in ("position_mm", "preload_n"))
        placed[window] = Placed(name, start, start, metres(position or 0.0), preload)
        last[name] = window
    return placed


def _number_or_none(fields: Fields, entry: str) -> float | None:
    with suppress(RecordingFormatError):
        return fields.optional_number(entry, "")
    return None


def _require_content(axis_id: str, starts: list[datetime], where: str) -> None:
    if not axis_id:
        raise RecordingFormatError(f"{where}: expected the name of the axis in axis_id; got an empty text")
    if not starts:
        raise RecordingFormatError(f"{where}: expected at least one window; got none")
    for number, (earlier, later) in enumerate(pairwise(starts), start=1):
        if later < earlier:
            raise RecordingFormatError(
                f"{where}: expected windows in time order; window number {number + 1} started at "
                f"{later.isoformat()}, before the one in front of it ({earlier.isoformat()})"
            )


def _require_same(indexed: Fields, stated: Fields, names: frozenset[str]) -> None:
    """Refuse an index that says otherwise than the attributes of a window."""
    for name in sorted(names):
        said, got = indexed.values.get(name), stated.values.get(name)
        if said != got:
            raise RecordingFormatError(
                f"{stated.where}, {name}: expected {said!r:.60}, as the index of the session says; got {got!r:.60}"
            )


def _require_agreement(index: SessionIndex, name: str, fields: Fields, columns: Mapping[str, Column]) -> None:
    """Refuse an index that says otherwise than a window."""
    _require_same(index.fields(name, fields.where), fields, _WINDOW_ATTRIBUTES)
    stored = {channel: (c.start, c.size, c.dtype.str) for channel, c in columns.items()}
    if stored != index.places(name, fields.where):
        raise RecordingFormatError(f"{fields.where}: expected its samples where the index of the session says")


def _indexed_samples(index: SessionIndex, name: str, where: str) -> dict[str, SampleArray]:
    """Read excitation, response and, where the window has them, position and reference."""
    places = index.places(name, where)
    if not {"excitation", "response"} <= places.keys() <= set(_CHANNELS):
        raise RecordingFormatError(f"{where}: expected excitation and response in the index; got {', '.join(places)}")
    require_plausible_channels([(channel, size) for channel, (_, size, _) in places.items()], where)
    return {name: index.samples(places[name], f"{where}/{name}") for name in _CHANNELS if name in places}


def _window(fields: Fields, samples: Mapping[str, SampleArray], started_at: datetime, measurement: str) -> Window:
    """Return a window of what its attributes say and its frame does not, and of its samples."""
    where = fields.where
    quantity = fields.choice("excitation_quantity", ExcitationQuantity)
    fields.exactly("excitation_unit", EXCITATION_UNIT[quantity])
    response_quantity = fields.choice("response_quantity", ResponseQuantity)
    fields.exactly("response_unit", RESPONSE_UNIT[response_quantity])
    trace = samples.get("position")
    with naming(where):
        return Window(
            excitation=samples["excitation"],
            response=samples["response"],
            sample_rate=fields.positive("sample_rate_hz", "Hz"),
            started_at=started_at,
            conditions=Conditions(
                position=metres(fields.number("position_mm", "mm")),
                payload_mass=fields.optional_number("payload_kg", "kg"),
                temperature=fields.optional_number("temperature_c", "°C"),
                preload=fields.optional_number("preload_n", "N"),
            ),
            measurement=measurement,
            excitation_quantity=quantity,
            excitation_source=fields.choice("excitation_source", ExcitationSource),
            direction=fields.optional_choice("direction", Direction) or Direction.BOTH,
            position_span=_position_span(fields, trace),
            position_trace=None if trace is None else trace.astype(np.float64, copy=False),
            reference=samples.get("reference"),
            response_quantity=response_quantity,
            response_resolution=fields.optional_positive("response_resolution", RESPONSE_UNIT[response_quantity]),
        )


def _position_span(fields: Fields, trace: SampleArray | None) -> float:
    if "position_span_mm" in fields or trace is None or trace.size == 0:
        return metres(fields.number("position_span_mm", "mm"))
    return span_of(trace.astype(np.float64, copy=False))


def _columns(group: "h5py.h5g.GroupID", where: str) -> dict[str, Column]:
    """Return the channels that the window has, after a look at what all of them take."""
    import h5py  # noqa: PLC0415

    names = [*_CHANNELS[:2], *(name for name in _CHANNELS[2:] if group.links.exists(name.encode()))]
    columns = {name: column(group, name, where, _SAMPLES) for name in names}
    require_plausible_channels([(name, c.size) for name, c in columns.items()], where)
    n_bytes = sum(c.size * c.dtype.itemsize for c in columns.values())
    if n_bytes > FREE_BYTES:
        require_plausible_expansion(n_bytes, h5py.h5i.get_file_id(group).get_filesize(), where)
    return columns


def _write_window(group: "h5py.Group", window: Window) -> dict[str, object]:
    """Write a window and return its attributes."""
    for name, (samples, _) in channels_of(window).items():
        group[name] = samples
    stated = stated_of(window)
    write_attributes(group, stated)
    return stated


def channels_of(window: Window) -> dict[str, tuple[SampleArray, str | None]]:
    """Return the channels that a window has, by the names of a session, with their units; a reference states none."""
    channels = {
        "excitation": (window.excitation, EXCITATION_UNIT[window.excitation_quantity]),
        "response": (window.response, RESPONSE_UNIT[window.response_quantity]),
        "position": (window.position_trace, "m"),
        "reference": (window.reference, None),
    }
    return {name: (samples, unit) for name, (samples, unit) in channels.items() if samples is not None}


def stated_of(window: Window) -> dict[str, object]:
    """Return what a window states beside its samples, by the names of a session and of the API."""
    conditions = window.conditions
    return {
        "started_at": format_instant(window.started_at),
        "sample_rate_hz": float(window.sample_rate),
        "excitation_quantity": str(window.excitation_quantity),
        "excitation_unit": EXCITATION_UNIT[window.excitation_quantity],
        "excitation_source": str(window.excitation_source),
        "response_quantity": str(window.response_quantity),
        "response_unit": RESPONSE_UNIT[window.response_quantity],
        "response_resolution": window.response_resolution,
        "position_mm": to_millimetres(conditions.position),
        "position_span_mm": to_millimetres(window.position_span),
        "direction": str(window.direction),
        "measurement": window.measurement,
        "payload_kg": conditions.payload_mass,
        "temperature_c": conditions.temperature,
        "preload_n": conditions.preload,
    }
