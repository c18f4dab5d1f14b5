"""Read and write recorded sessions, ``*.session.h5``: window by window, the same bytes every time.

Root attributes ``format`` = "preload-session", ``version`` = 1, ``axis_id``; optional ``description``, ``created``.
Each group ``/windows/NNNNNN`` holds one window, in time order; the attributes and their units are those of
``docs/reference/recordings.md``. Units are fixed, so a wrong one is refused, never converted. Attributes that are not
known here are left alone. A window without ``measurement`` is a measurement of its own, named by its group.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Session, Window
from monitor_core.recordings.elements.bounds import FREE_BYTES, require_plausible_channels, require_plausible_expansion
from monitor_core.recordings.elements.fields import Fields, format_instant
from monitor_core.recordings.elements.files import naming, refusing
from monitor_core.recordings.elements.hdf5 import (
    attributes,
    attributes_at,
    column,
    numbered_groups,
    open_hdf5,
    write_attributes,
)
from monitor_core.recordings.elements.units import metres, to_millimetres

if TYPE_CHECKING:
    import h5py

FORMAT = "preload-session"
VERSION = 1
EXCITATION_UNIT = {ExcitationQuantity.TORQUE: "N.m", ExcitationQuantity.FORCE: "N"}
RESPONSE_QUANTITY = "acceleration"
RESPONSE_UNIT = "m/s2"
_ROOT_ATTRIBUTES = frozenset(("format", "version", "axis_id", "description", "created"))
_WINDOW_ATTRIBUTES = frozenset((
    "sample_rate_hz", "excitation_quantity", "excitation_unit", "excitation_source", "response_quantity",
    "response_unit", "position_mm", "position_span_mm", "direction", "payload_kg", "temperature_c",
    "preload_n",
))  # fmt: skip
#: What the frame of a session says of each window; the others are read with its samples.
_FRAME_ATTRIBUTES = frozenset(("started_at", "measurement"))
_CHANNELS = ("excitation", "response", "position")
_SAMPLES = ("float32", "float64")


@dataclass(frozen=True, slots=True, eq=False)
class SessionReader:
    """An open session file. Windows are read when asked for, so that memory stays flat; see :func:`open_session`."""

    axis_id: str
    description: str
    created: datetime | None
    measurement_of: Mapping[str, str]  # window's group name → its measurement, in time order
    _names_of: Mapping[str, tuple[str, ...]]  # measurement → group names of its windows, in time order
    _starts: Mapping[str, datetime]  # by the names of the groups
    _windows: "h5py.Group"
    _where: str

    @property
    def measurements(self) -> tuple[str, ...]:
        """Names of the measurements, in order of first appearance."""
        return tuple(self._names_of)

    def length(self, name: str) -> int:
        """Return how many samples the longest channel of a window has; none is read."""
        where = f"{self._where} /windows/{name}"
        with refusing(where, "a readable window"):
            group = self._group(name)
            channels = [channel for channel in _CHANNELS if group.links.exists(channel.encode())]
            return max((column(group, channel, where, _SAMPLES).size for channel in channels), default=0)

    def window(self, name: str) -> Window:
        """Read one window by the name of its group."""
        where = f"{self._where} /windows/{name}"
        with refusing(where, "a readable window"):
            return _read_window(self._group(name), self._starts[name], self.measurement_of[name], where)

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
def open_session(path: Path) -> Iterator[SessionReader]:
    """Open a session file and check its frame; the samples stay on disk until a window is asked for.

    ``path``: a ``*.session.h5`` file. Returned: valid inside the ``with`` block. ``RecordingFormatError`` if the
    file is no such session: one sentence says what was expected, what was got, and where.
    """
    with open_hdf5(path) as file:
        with refusing(path.name, f"a {FORMAT} file"):
            reader = _session_reader(file, path.name)
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
        for number, window in enumerate(session.windows):
            _write_window(windows.create_group(f"{number:06d}"), window)


def _session_reader(file: "h5py.File", where: str) -> SessionReader:
    root = attributes(file, _ROOT_ATTRIBUTES, f"{where} /")
    root.require_format(FORMAT, VERSION)
    windows, stated = numbered_groups(file, "windows", 6, _FRAME_ATTRIBUTES, where)
    measurement_of = {
        name: fields.text("measurement") if "measurement" in fields else name for name, fields in stated.items()
    }
    starts = {name: fields.instant("started_at") for name, fields in stated.items()}
    axis_id = root.text("axis_id")
    _require_content(axis_id, list(starts.values()), where)
    return SessionReader(
        axis_id=axis_id,
        description=root.text("description") if root.values.get("description") else "",
        created=root.instant("created") if "created" in root else None,
        measurement_of=measurement_of,
        _names_of=_names_by_measurement(measurement_of),
        _starts=starts,
        _windows=windows,
        _where=where,
    )


def _names_by_measurement(measurement_of: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Turn the table round, once: a search for each measurement grows with the square of the session."""
    names: dict[str, list[str]] = {}
    for name, measurement in measurement_of.items():
        names.setdefault(measurement, []).append(name)
    return {measurement: tuple(of_it) for measurement, of_it in names.items()}


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


def _read_window(group: "h5py.h5g.GroupID", started_at: datetime, measurement: str, where: str) -> Window:
    """Read what the frame does not say of a window, and its samples."""
    fields = attributes_at(group, _WINDOW_ATTRIBUTES, where)
    quantity = fields.choice("excitation_quantity", ExcitationQuantity)
    fields.exactly("excitation_unit", EXCITATION_UNIT[quantity])
    fields.exactly("response_quantity", RESPONSE_QUANTITY)
    fields.exactly("response_unit", RESPONSE_UNIT)
    excitation, response, *traces = _samples(group, where)
    trace = traces[0] if traces else None
    with naming(where):
        return Window(
            excitation=excitation,
            response=response,
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
        )


def _position_span(fields: Fields, trace: SampleArray | None) -> float:
    if "position_span_mm" in fields or trace is None or trace.size == 0:
        return metres(fields.number("position_span_mm", "mm"))
    return float(np.ptp(trace.astype(np.float64, copy=False)))


def _samples(group: "h5py.h5g.GroupID", where: str) -> list[SampleArray]:
    """Read excitation, response and, where the window has it, position, after a look at what all of them take."""
    import h5py  # noqa: PLC0415

    names = ["excitation", "response", *(["position"] if group.links.exists(b"position") else [])]
    columns = [column(group, name, where, _SAMPLES) for name in names]
    require_plausible_channels([(name, c.size) for name, c in zip(names, columns, strict=True)], where)
    n_bytes = sum(c.size * c.dtype.itemsize for c in columns)
    if n_bytes > FREE_BYTES:
        require_plausible_expansion(n_bytes, h5py.h5i.get_file_id(group).get_filesize(), where)
    return [cast(SampleArray, c.values()) for c in columns]


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
    write_attributes(group, stated)
