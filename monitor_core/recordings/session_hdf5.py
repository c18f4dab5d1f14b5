"""Recorded sessions, ``*.session.h5``: read window by window, write reproducibly.

Root attributes ``format`` = "preload-session", ``version`` = 1, ``axis_id``; optional ``description``, ``created``.
Each group ``/windows/NNNNNN`` holds one window, in time order; the attributes and their units are those of
``docs/recordings.md``. Units are fixed, so a wrong one is refused, never converted. Attributes that are not known here
are left alone. A window without ``measurement`` is a measurement of its own, named by its group.

Links that lead out of the file, virtual datasets and external storage are refused: a session is one file.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import InvalidWindowError, RecordingFormatError
from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Session, Window
from monitor_core.recordings.fields import Fields
from monitor_core.recordings.files import refusing, require_file, require_plausible_length
from monitor_core.recordings.hdf5_heap import require_sound_heap
from monitor_core.recordings.timestamps import format_instant
from monitor_core.recordings.units import metres, to_millimetres

if TYPE_CHECKING:
    import h5py

FORMAT = "preload-session"
VERSION = 1
EXCITATION_UNIT = {ExcitationQuantity.TORQUE: "N.m", ExcitationQuantity.FORCE: "N"}
RESPONSE_QUANTITY = "acceleration"
RESPONSE_UNIT = "m/s2"
_KNOWN_ATTRIBUTES = frozenset((
    "format", "version", "axis_id", "description", "created",
    "started_at", "sample_rate_hz", "excitation_quantity", "excitation_unit", "excitation_source", "response_quantity",
    "response_unit", "position_mm", "position_span_mm", "direction", "measurement", "payload_kg", "temperature_c",
    "preload_n",
))  # fmt: skip
_WINDOW_NAME = re.compile(r"\d{6,}", re.ASCII)


@dataclass(frozen=True, slots=True, eq=False)
class SessionReader:
    """An open session file. Windows are read when asked for, so that memory stays flat; see :func:`open_session`."""

    axis_id: str
    description: str
    created: datetime | None
    measurement_of: Mapping[str, str]  # window's group name → its measurement, in time order
    _windows: "h5py.Group"
    _where: str

    @property
    def measurements(self) -> tuple[str, ...]:
        """Names of the measurements, in order of first appearance."""
        return tuple(dict.fromkeys(self.measurement_of.values()))

    def window(self, name: str) -> Window:
        """Read one window by the name of its group."""
        where = f"{self._where} /windows/{name}"
        with refusing(where, "a readable window"):
            return _read_window(self._windows[name], name, where)

    def windows(self) -> Iterator[Window]:
        """Read one window after the other, in time order."""
        return (self.window(name) for name in self.measurement_of)

    def windows_of(self, measurement: str) -> tuple[Window, ...]:
        """Read the windows of one measurement, in time order."""
        return tuple(self.window(name) for name, of in self.measurement_of.items() if of == measurement)


@contextmanager
def open_session(path: Path) -> Iterator[SessionReader]:
    """Open a session file and check its frame; the samples stay on disk until a window is asked for.

    Parameters
    ----------
    path : Path
        A ``*.session.h5`` file.

    Yields
    ------
    SessionReader
        Valid inside the ``with`` block.

    Raises
    ------
    RecordingFormatError
        If the file is no such session: one sentence says what was expected, what was got, and where.
    """
    import h5py  # noqa: PLC0415  # file libraries are imported where they are needed

    with refusing(path.name, "an HDF5 file"):
        require_sound_heap(require_file(path))
        file = h5py.File(path, "r")
    with file:
        with refusing(path.name, f"a {FORMAT} file"):
            reader = _session_reader(file, path.name)
        yield reader


def read_session(path: Path) -> Session:
    """Read a whole session into memory.

    Parameters
    ----------
    path : Path
        A ``*.session.h5`` file.

    Returns
    -------
    Session
        Windows in time order; samples in the precision of the file, positions in metres.

    Raises
    ------
    RecordingFormatError
        If the file is no such session: one sentence says what was expected, what was got, and where.
    """
    with open_session(path) as reader:
        return Session(reader.axis_id, tuple(reader.windows()), reader.description, reader.created)


def write_session(path: Path, session: Session) -> None:
    """Write a session; the same session gives the same bytes, whenever it is written.

    Parameters
    ----------
    path : Path
        Usually ``*.session.h5``; an existing file is replaced.
    session : Session
        Windows in time order.

    Raises
    ------
    RecordingFormatError
        If the session holds no window, names no axis, or is not in time order.
    """
    import h5py  # noqa: PLC0415

    _require_content(session.axis_id, [w.started_at for w in session.windows], path.name)
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "axis_id": session.axis_id})
        if session.description:
            file.attrs["description"] = session.description
        if session.created is not None:
            file.attrs["created"] = format_instant(session.created)
        windows = file.create_group("windows")
        for number, window in enumerate(session.windows):
            _write_window(windows.create_group(f"{number:06d}"), window)


def _session_reader(file: "h5py.File", where: str) -> SessionReader:
    root = Fields(_attributes(file, f"{where} /"), f"{where} /")
    root.exactly("format", FORMAT)
    if (version := root.number("version", "-")) != VERSION:
        raise RecordingFormatError(f"{where} /, version: expected {VERSION}; got {version:g}")
    windows = _member(file, "windows", "Group", f"{where} /windows")
    measurement_of, starts = {}, []
    for name in sorted(windows, key=lambda n: (len(n), n)):
        place = f"{where} /windows/{name}"
        if not _WINDOW_NAME.fullmatch(name):
            raise RecordingFormatError(f"{place}: expected a group named by six digits; got {name!r}")
        fields = Fields(_attributes(_member(windows, name, "Group", place), place), place)
        measurement_of[name] = fields.text("measurement") if "measurement" in fields else name
        starts.append(fields.instant("started_at"))
    axis_id = root.text("axis_id")
    _require_content(axis_id, starts, where)
    return SessionReader(
        axis_id=axis_id,
        description=root.text("description") if root.values.get("description") else "",
        created=root.instant("created") if "created" in root else None,
        measurement_of=measurement_of,
        _windows=windows,
        _where=where,
    )


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


def _read_window(group: "h5py.Group", name: str, where: str) -> Window:
    fields = Fields(_attributes(group, where), where)
    quantity = fields.choice("excitation_quantity", ExcitationQuantity)
    fields.exactly("excitation_unit", EXCITATION_UNIT[quantity])
    fields.exactly("response_quantity", RESPONSE_QUANTITY)
    fields.exactly("response_unit", RESPONSE_UNIT)
    trace = _samples(group, "position", where) if "position" in group else None
    try:
        return Window(
            excitation=_samples(group, "excitation", where),
            response=_samples(group, "response", where),
            sample_rate=fields.positive("sample_rate_hz", "Hz"),
            started_at=fields.instant("started_at"),
            conditions=Conditions(
                position=metres(fields.number("position_mm", "mm")),
                payload_mass=fields.optional_number("payload_kg", "kg"),
                temperature=fields.optional_number("temperature_c", "°C"),
                preload=fields.optional_number("preload_n", "N"),
            ),
            measurement=fields.text("measurement") if "measurement" in fields else name,
            excitation_quantity=quantity,
            excitation_source=fields.choice("excitation_source", ExcitationSource),
            direction=fields.choice("direction", Direction) if "direction" in fields else Direction.BOTH,
            position_span=_position_span(fields, trace),
            position_trace=None if trace is None else trace.astype(np.float64),
        )
    except InvalidWindowError as error:
        raise RecordingFormatError(f"{where}: {error}") from error


def _position_span(fields: Fields, trace: SampleArray | None) -> float:
    if "position_span_mm" in fields or trace is None or trace.size == 0:
        return metres(fields.number("position_span_mm", "mm"))
    return float(np.ptp(trace.astype(np.float64)))


def _samples(group: "h5py.Group", name: str, where: str) -> SampleArray:
    place = f"{where}/{name}"
    dataset = _member(group, name, "Dataset", place)
    if dataset.dtype.kind != "f" or dataset.dtype.itemsize not in (4, 8):
        raise RecordingFormatError(f"{place}: expected float32 or float64 samples; got {dataset.dtype}")
    if dataset.ndim != 1:
        raise RecordingFormatError(f"{place}: expected shape (n_samples,); got {dataset.shape}")
    if dataset.is_virtual or dataset.external:
        raise RecordingFormatError(f"{place}: expected samples inside the file; they are stored in another one")
    require_plausible_length(dataset.size, place)
    if _unwritten(dataset):
        raise RecordingFormatError(f"{place}: expected {dataset.size} samples; they were announced but never written")
    samples: FloatArray = dataset.astype(dataset.dtype.newbyteorder("="))[()]
    samples.setflags(write=False)  # ours alone: the record need not copy it
    return samples


def _unwritten(dataset: "h5py.Dataset") -> bool:
    """HDF5 answers fill values for samples that an interrupted acquisition announced and never wrote."""
    if dataset.chunks is not None:
        return bool(dataset.id.get_num_chunks() < -(-dataset.size // dataset.chunks[0]))
    return bool(dataset.id.get_storage_size() < dataset.size * dataset.dtype.itemsize)


def _attributes(group: "h5py.Group", where: str) -> dict[str, object]:
    """Return the attributes known here. Only numbers and texts are touched: other types crash HDF5 when damaged."""
    import h5py  # noqa: PLC0415

    attributes: dict[str, object] = {}
    for name in _KNOWN_ATTRIBUTES.intersection(group.attrs):
        stored = group.attrs.get_id(name)
        readable = stored.get_type().get_class() in (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING)
        # MATLAB and LabVIEW write a single value as an array of one
        if not readable or stored.shape not in ((), (1,), (1, 1)):
            raise RecordingFormatError(
                f"{where}, {name}: expected a single number or text; got {stored.dtype} of shape {stored.shape}"
            )
        attributes[name] = np.asarray(group.attrs[name]).reshape(-1)[0]
    return attributes


def _member(group: "h5py.Group", name: str, kind: str, place: str) -> "h5py.Group":
    """Return a group or dataset that really lies in this file: a link could name any file of the machine."""
    import h5py  # noqa: PLC0415

    if name not in group:
        raise RecordingFormatError(f"{place}: expected a {kind.lower()}; it is missing")
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise RecordingFormatError(f"{place}: expected a {kind.lower()} inside the file; got a link")
    member = group[name]
    if not isinstance(member, getattr(h5py, kind)):
        raise RecordingFormatError(f"{place}: expected a {kind.lower()}; got a {type(member).__name__.lower()}")
    return member


def _write_window(group: "h5py.Group", window: Window) -> None:
    group["excitation"] = window.excitation
    group["response"] = window.response
    if window.position_trace is not None:
        group["position"] = window.position_trace
    conditions = window.conditions
    stated = {
        "started_at": format_instant(window.started_at),
        "sample_rate_hz": float(window.sample_rate),
        "excitation_quantity": str(window.excitation_quantity),
        "excitation_unit": EXCITATION_UNIT[window.excitation_quantity],
        "excitation_source": str(window.excitation_source),
        "response_quantity": RESPONSE_QUANTITY,
        "response_unit": RESPONSE_UNIT,
        "position_mm": to_millimetres(conditions.position),
        "position_span_mm": to_millimetres(window.position_span),
        "direction": str(window.direction),
        "measurement": window.measurement,
        "payload_kg": conditions.payload_mass,
        "temperature_c": conditions.temperature,
        "preload_n": conditions.preload,
    }
    group.attrs.update({name: value for name, value in stated.items() if value is not None})
