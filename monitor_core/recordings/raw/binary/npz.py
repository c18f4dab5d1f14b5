"""Read NumPy files: arrays of ``*.npz`` are channels of their names, the array of ``*.npy`` is the channel "array".

Fields of a record array are channels ``array.field``. Nothing is unpickled.
"""

import io
import math
import zipfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import require_plausible_channels, require_plausible_expansion
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.raw.channels import (
    MOST_NUMBERS,
    Channel,
    Channels,
    native_samples,
    single_numbers,
)

#: A header is a line of text; NumPy itself reads none that is longer than 10 000 characters.
_LONGEST_HEADER = 12_000
_ARRAY = "array"
_NOT_READ = {"c": "complex", "O": "objects", "M": "dates", "m": "durations", "b": "truth values"}


@dataclass(frozen=True, slots=True)
class _Stored:
    """An array that is not read yet: what its header says, and how to come to its bytes."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    n_bytes: int  # of the values, as the archive or the file system says
    open: Callable[[], AbstractContextManager[IO[bytes]]]

    @property
    def is_single(self) -> bool:
        """Whether it holds one real number."""
        return len(self.shape) <= 1 and math.prod(self.shape) == 1 and self.dtype.kind in "fiu"

    def fields(self) -> list[tuple[str, str | None]]:
        """Return the channels it holds: their names, and the field of a record array."""
        if len(self.shape) not in (1, 2) or self.is_single:
            return []
        if self.dtype.fields is None:
            return [(self.name, None)] if self.dtype.kind in "fiu" else []
        kinds = {field: kind for field, (kind, *_) in (self.dtype.fields or {}).items()}
        return [(f"{self.name}.{field}", field) for field, kind in kinds.items() if kind.kind in "fiu"]

    def not_read(self) -> list[str]:
        """Return what it holds that is no channel, and why; texts are not worth a word."""
        if len(self.shape) > 2:
            return [f"{self.name} ({len(self.shape)} dimensions)"]
        if not self.shape and self.dtype.kind != "O":
            return []
        if self.dtype.fields is None:
            return [f"{self.name} ({_NOT_READ[self.dtype.kind]})"] if self.dtype.kind in _NOT_READ else []
        fields = {field: kind.kind for field, (kind, *_) in self.dtype.fields.items()}
        return [f"{self.name}.{field} ({_NOT_READ[kind]})" for field, kind in fields.items() if kind in _NOT_READ]

    def values(self) -> np.ndarray:
        """Read them; nothing is unpickled."""
        with self.open() as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)


def read_channels(path: Path) -> Channels:
    """Read the arrays of a file of ``numpy.savez`` or ``numpy.save``; it states neither units nor a time base.

    There is one channel per array. Arrays of other than one or two dimensions, and of other than real numbers, are no
    channels; those that may have been meant as such are named as not read.
    ``RecordingFormatError`` if the archive or an array in it is damaged, or if a header announces what the
    file does not hold.
    """
    with require_file(path).open("rb") as stream:
        is_archive = stream.read(2) == b"PK"
    if not is_archive:
        with refusing(path.name, "a NumPy file (.npy or .npz)"):
            return _read(path, [_stored(path, _ARRAY, path.stat().st_size, lambda: path.open("rb"))])
    with refusing(path.name, "a NumPy archive (.npz)"), zipfile.ZipFile(path) as archive:
        return _read(path, [_member(path, archive, member) for member in archive.infolist()])


def _member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> _Stored:
    return _stored(path, member.filename.removesuffix(".npy"), member.file_size, lambda: archive.open(member))


def _stored(path: Path, name: str, n_bytes: int, opening: Callable[[], AbstractContextManager[IO[bytes]]]) -> _Stored:
    with opening() as stream, io.BytesIO(stream.read(_LONGEST_HEADER)) as head:
        version = np.lib.format.read_magic(head)
        if version not in ((1, 0), (2, 0), (3, 0)):
            raise RecordingFormatError(f"{path.name}, {name}: expected a NumPy header of version 1 to 3; got {version}")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(head)
        return _Stored(name, shape, dtype, n_bytes - head.tell(), opening)


def _read(path: Path, arrays: list[_Stored]) -> Channels:
    kept = [array for array in arrays if array.fields()]
    left_out = [text for array in arrays for text in array.not_read()]
    single = [array for array in arrays if array.is_single][:MOST_NUMBERS]
    require_plausible_channels([(n, math.prod(a.shape)) for a in kept for n, _ in a.fields()], path.name)
    for array in [*kept, *single]:
        n_values = math.prod(array.shape)
        if array.n_bytes < n_values * array.dtype.itemsize:
            raise RecordingFormatError(
                f"{path.name}, {array.name}: expected {n_values} values as its header says; got {array.n_bytes} bytes"
            )
    n_bytes = sum(math.prod(array.shape) * array.dtype.itemsize for array in kept)
    require_plausible_expansion(n_bytes, path.stat().st_size, path.name)
    channels: list[Channel] = []
    for array in kept:
        values = array.values()
        channels += [
            Channel(name, native_samples(values if field is None else values[field])) for name, field in array.fields()
        ]
    numbers = single_numbers((array.name, array.values().item()) for array in single)
    return Channels(path.name, tuple(channels), numbers=numbers, left_out=tuple(left_out))
