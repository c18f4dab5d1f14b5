"""The index of a long session: what its windows say, and where their samples lie, in one place of the file.

Asking the group of each window takes longer than judging it. The dataset ``index`` of the root holds a checksum
(CRC-32, eight hexadecimal digits) and JSON: what all windows have in ``common``, and the rest by their names. The
checksum is of the whole file, with zeros in its own place. So an index counts only while the file is byte for byte as
it was written; a file that was changed since, or damaged, is read by its groups as one without an index.
"""

import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.fields import Fields, json_object, json_table
from monitor_core.recordings.elements.files import samples_at

if TYPE_CHECKING:
    import h5py

NAME = "index"
#: Shorter sessions are opened in a moment as they are.
FEWEST_WINDOWS = 1000
_DIGITS = 8
_UNSEALED = b"0" * _DIGITS
_MOST_BYTES = 2**10  # for each window: more is no index
_BLOCK = 2**18
_TYPES = ("<f4", "<f8")
_CHANNELS = "channels"


@dataclass(frozen=True, slots=True, eq=False)
class SessionIndex:
    """What the windows of a session say, by the names of their groups, in order; see :func:`read_index`."""

    common: Mapping[str, object]
    windows: Mapping[str, Mapping[str, object]]
    _file: BinaryIO
    _n_bytes: int

    def fields(self, name: str, where: str) -> Fields:
        """Return what a window says, by the names of its attributes."""
        return Fields({**self.common, **self.windows[name]}, where)

    def places(self, name: str, where: str) -> dict[str, tuple[int, int, str]]:
        """Return first byte, number of samples and type of each channel of a window; all lie in the file."""
        stated = json_object(self.windows[name].get(_CHANNELS), where).values
        return {channel: self._place(place, f"{where}, {channel}") for channel, place in stated.items()}

    def _place(self, stated: object, where: str) -> tuple[int, int, str]:
        match stated:
            case [int(start), int(size), str(code)] if code in _TYPES and min(start, size) >= 0:
                if start + size * np.dtype(code).itemsize <= self._n_bytes:
                    return start, size, code
        raise RecordingFormatError(f"{where}: expected a place in the file, in its index; got {stated!r:.60}")

    def samples(self, place: tuple[int, int, str], where: str) -> SampleArray:
        """Read the samples of a channel; the array cannot be written to."""
        start, size, code = place
        return samples_at(self._file, start, size, np.dtype(code), where)


def row_of(group: "h5py.Group", stated: Mapping[str, object]) -> dict[str, object]:
    """Return what an index says of a window whose samples and attributes were written into its group."""
    row = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in stated.items()
        if value is not None
    }
    row[_CHANNELS] = {name: [data.id.get_offset(), data.size, data.dtype.str] for name, data in group.items()}
    return row


def write_index(file: "h5py.File", rows: Mapping[str, Mapping[str, object]]) -> int:
    """Write the index of a session, last of all, and return where it begins; :func:`seal` makes it count.

    ``rows``: of each window, by the name of its group; see :func:`row_of`.
    """
    first = next(iter(rows.values()))
    common = {
        name: value
        for name, value in first.items()
        if name != _CHANNELS and all(row.get(name) == value for row in rows.values())
    }
    windows = {key: {name: value for name, value in row.items() if name not in common} for key, row in rows.items()}
    text = json.dumps({"common": common, "windows": windows}, separators=(",", ":")).encode()
    stored = file.create_dataset(NAME, data=np.frombuffer(_UNSEALED + text, np.uint8))
    return int(stored.id.get_offset())


def seal(path: Path, start: int) -> None:
    """Write the checksum of a file that is closed into its index, which begins at this byte."""
    with path.open("r+b") as file:
        checksum = _checksum(file, start)
        file.seek(start)
        file.write(checksum)


def read_index(session: "h5py.File", file: BinaryIO, names: Sequence[str], where: str) -> SessionIndex | None:
    """Return the index of a session whose windows have these names, or None if there is none that counts.

    ``file``: the same file, open in binary; samples are read from it; ``where``: its name, for messages.
    """
    import h5py  # noqa: PLC0415

    links, encoded = session.id.links, NAME.encode()
    if not links.exists(encoded) or links.get_info(encoded).type != h5py.h5l.TYPE_HARD:
        return None
    stored = h5py.h5o.open(session.id, encoded)
    if not isinstance(stored, h5py.h5d.DatasetID) or (start := stored.get_offset()) is None:
        return None
    size = stored.get_storage_size()
    if not _DIGITS < size <= _MOST_BYTES * max(1, len(names)):
        return None
    file.seek(start)
    content = file.read(size)
    if len(content) != size or content[:_DIGITS] != _checksum(file, start):
        return None
    place = f"{where} /{NAME}"
    document = json_object(json.loads(content[_DIGITS:]), place)
    common, windows = (json_table(document, part).values for part in ("common", "windows"))
    if list(windows) != list(names):
        raise RecordingFormatError(f"{place}: expected the names of all windows, in order; it names others")
    rows = {name: json_object(row, f"{place}, {name}").values for name, row in windows.items()}
    return SessionIndex(common, rows, file, os.fstat(file.fileno()).st_size)


def _checksum(file: BinaryIO, start: int) -> bytes:
    """Return the checksum of a file, with zeros in place of the one that begins at this byte."""
    file.seek(0)
    checksum, left = 0, start
    while left and (block := file.read(min(left, _BLOCK))):
        checksum, left = zlib.crc32(block, checksum), left - len(block)
    checksum = zlib.crc32(_UNSEALED, checksum)
    file.seek(start + _DIGITS)
    while block := file.read(_BLOCK):
        checksum = zlib.crc32(block, checksum)
    return f"{checksum:0{_DIGITS}x}".encode()
