"""Check a file: recognise its format by its content and read it to the end."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings import motion_csv
from monitor_core.recordings.elements.files import read_text, refusing, require_file
from monitor_core.recordings.elements.hdf5 import attributes, open_hdf5
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.raw import csv_samples, mat, npz, tdms, uff58
from monitor_core.recordings.raw.channel_map import read_channel_map
from monitor_core.recordings.session_hdf5 import open_session

_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_FORMATS = ("preload-session", "preload-frf-set")
_MOST_PROBLEMS = 20
#: What only a drive model has. Looked for in the text, so that a model that is no TOML is still judged as a model.
_DRIVE_MODEL = re.compile(r"""^\s*(["']?family["']?\s*=|\[(parameters|uncertain|effects)\b)""", re.MULTILINE)
#: How a file begins, where its format has a signature.
_STARTS: dict[str, bytes | tuple[bytes, ...]] = {
    "tdms": b"TDSm",
    "npz": b"PK",
    "mat": b"MATLAB",
    "uff58": b"    -1",
}


@dataclass(frozen=True, slots=True)
class FileReport:
    """What a file is, whether it holds to its format, and each thing that does not fit in one sentence."""

    format: str
    valid: bool
    problems: tuple[str, ...]


def check_file(path: Path) -> FileReport:
    """Recognise a file by its content and read all of it.

    ``path``: a session, an FRF set, a modal table, a motion record, a calibration, a drive model, a channel map, or
    a raw file (TDMS, UFF58, MAT, NPZ, text columns). A raw file is checked for being readable; what it means is for
    a channel map to say. Returned: of a session every window and of an FRF set every condition is looked at, and at
    most 20 problems are listed. ``MissingReaderError`` if the format needs an optional library that is not
    installed: that is no fault of the file.
    """
    try:
        name = format_of(path)
    except RecordingFormatError as error:
        return FileReport("unknown", False, (str(error),))
    found = list(islice(_problems(name, path), _MOST_PROBLEMS + 1))
    if len(found) > _MOST_PROBLEMS:
        found[_MOST_PROBLEMS:] = [f"{path.name}: further problems are not listed"]
    return FileReport(name, not found, tuple(found))


def format_of(path: Path) -> str:
    """Recognise a file by its content without reading all of it.

    Returned: as in a report: ``preload-session``, ``preload-frf-set``, ``modal-table``, ``motion-record``,
    ``preload-model``, ``csv`` for other columns of text, …. ``RecordingFormatError`` if there is no such file, or
    it is text of no known encoding.
    """
    with require_file(path).open("rb") as stream:
        head = stream.read(1024)
    if head.startswith(_HDF5):
        return _format_of_hdf5(path)
    for name, starts in _STARTS.items():
        if head.startswith(starts):
            return name
    if path.suffix.lower() == ".mat":  # version 4 has no signature
        return "mat"
    text = read_text(path).lstrip()
    if text.startswith("{"):
        return "preload-calibration"
    if path.suffix.lower() == ".toml":
        return "preload-model" if _DRIVE_MODEL.search(text) else "channel-map"
    return _format_of_columns(text)


def _format_of_columns(text: str) -> str:
    columns = [cell.strip().lower() for cell in text.partition("\n")[0].replace(";", ",").split(",")]
    if motion_csv.is_motion_header(columns):
        return "motion-record"
    return "modal-table" if any(cell.startswith("frequency") for cell in columns) else "csv"


def _format_of_hdf5(path: Path) -> str:
    """Name the format of an HDF5 file; one that is damaged or states none is judged by its name, or as a session."""
    try:
        with open_hdf5(path) as file, refusing(path.name, "a readable format"):
            name = attributes(file, frozenset(("format",)), path.name).text("format")
    except RecordingFormatError:
        name = ""
    if name not in _HDF5_FORMATS:
        name = "preload-frf-set" if path.name.lower().endswith(".frf.h5") else "preload-session"
    return name


def _problems(name: str, path: Path) -> Iterator[str]:
    try:
        if name == "preload-session":
            yield from _problems_of_session(path)
        elif name == "preload-frf-set":
            yield from _problems_of_frf_set(path)
        else:
            _READERS[name](path)
    except RecordingFormatError as error:
        yield str(error)


def _problems_of_session(path: Path) -> Iterator[str]:
    with open_session(path) as reader:
        yield from _refusals(reader.window, reader.measurement_of)


def _problems_of_frf_set(path: Path) -> Iterator[str]:
    # imported here: an FRF set brings the drive models along
    from monitor_core.recordings.frf_set import open_frf_set  # noqa: PLC0415

    with open_frf_set(path) as reader:
        yield from _refusals(reader.measured, reader.conditions)


def _refusals(read: Callable[[str], object], names: Iterable[str]) -> Iterator[str]:
    for name in names:
        try:
            read(name)
        except RecordingFormatError as error:
            yield str(error)


def _read_calibration(path: Path) -> object:
    # imported here: a calibration brings the preload mathematics along, which no other format needs
    from monitor_core.recordings.calibration_file import read_calibration  # noqa: PLC0415

    return read_calibration(path)


def _read_model(path: Path) -> object:
    # imported here: a drive model brings the four families along
    from monitor_core.recordings.model_file import read_model_file  # noqa: PLC0415

    return read_model_file(path)


_READERS: dict[str, Callable[[Path], object]] = {
    "preload-calibration": _read_calibration,
    "preload-model": _read_model,
    "modal-table": read_modal_table,
    "motion-record": motion_csv.read_motion_record,
    "channel-map": read_channel_map,
    "tdms": tdms.read_channels,
    "uff58": uff58.read_channels,
    "mat": mat.read_channels,
    "npz": npz.read_channels,
    "csv": csv_samples.read_channels,
}
