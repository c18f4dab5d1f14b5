"""Read MATLAB files, ``*.mat``: every array of real numbers is a channel of its name.

Version 5 to 7.2 is read here, by the layout of *MAT-File Format* (The MathWorks): a header of 128 bytes, then elements,
each a tag (type, number of bytes) and its bytes. ``scipy.io.loadmat`` reads the same, but trusts the type codes: with
single damaged bytes it ended the process in 26 of 2000 trials. Version 4 is a sequence of arrays, each behind a header
of five whole numbers and its name. Version 7.3 is HDF5, see :mod:`monitor_core.recordings.raw.binary.mat_hdf5`.

Numbers inside a structure are channels too, named as MATLAB calls them: ``record.force``, ``record.Y(2).Data``.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import (
    MAX_CHANNELS,
    most_unpacked,
    require_plausible_channels,
    require_plausible_expansion,
    unpacked_size,
)
from monitor_core.recordings.elements.files import MAX_SAMPLES, refusing, require_file, require_plausible_length
from monitor_core.recordings.raw.binary import mat_hdf5
from monitor_core.recordings.raw.channels import MOST_LEFT_OUT, Channel, Channels, native_samples, single_numbers

_HEADER_SIZE = 128
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_STORED_AS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCTURE, _SINGLE, _OPAQUE = 2, 7, 17  # classes of arrays
_NUMERIC_CLASSES = range(6, 16)  # double, single, and the integers from int8 to uint64
_NOT_READ = {1: "cell", 3: "object", 5: "sparse", 16: "function"}
_COMPLEX = 0x08
_MOST_BYTES = 8 * MAX_SAMPLES + 4096
_DEEPEST = 8  # structures inside structures
_LONGEST_NAME = 64  # of a field; MATLAB allows 63 characters

_TYPES_OF_VERSION_4 = ("f8", "f4", "i4", "i2", "u2", "u1")


def read_channels(path: Path) -> Channels:
    """Read the numeric arrays of a MATLAB file; it states neither units nor a time base.

    There is one channel per array, also for those in the fields of a structure; MATLAB's rows and columns of one become
    one-dimensional. Single numbers are kept by name, texts are left out; cells, complex numbers, sparse arrays, arrays
    of more than two dimensions and objects (``timetable``) are named as not read. ``RecordingFormatError`` if the file
    is damaged.
    """
    with require_file(path).open("rb") as stream:
        head = stream.read(1024)
    if mat_hdf5.is_version_7_3(head):
        return mat_hdf5.read_channels(path)
    with refusing(path.name, "a MATLAB file"):
        content = path.read_bytes()
        reader = _Reader(path)
        found = list(reader.arrays_of_version_4(content) if 0 in head[:4] else reader.arrays(content))
        arrays = [(name, array) for name, array in found if array.size > 1]
        numbers = single_numbers((name, array.item()) for name, array in found if array.size == 1)
        require_plausible_channels([(name, array.size) for name, array in arrays], path.name)
        if not arrays and reader.n_objects:
            raise RecordingFormatError(
                f"{path.name}: expected arrays of numbers; got objects (timetable, timeseries or the like), which only "
                "MATLAB reads: save their columns as arrays"
            )
        channels = tuple(_channel(name, array) for name, array in arrays)
        return Channels(path.name, channels, numbers=numbers, left_out=tuple(reader.left_out))


def _channel(name: str, array: np.ndarray) -> Channel:
    return Channel(name, native_samples(array.reshape(-1) if 1 in array.shape else array))


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    content: memoryview


class _Reader:
    """Follows the elements of a file, and counts what they unpack to and which of them only MATLAB reads."""

    def __init__(self, path: Path) -> None:
        self.where, self.n_bytes = path.name, path.stat().st_size
        self.order = "<"
        self.n_objects = 0
        self.n_unpacked = 0
        self.left_out: list[str] = []

    def arrays_of_version_4(self, content: bytes) -> Iterator[tuple[str, np.ndarray]]:
        order = "<" if int.from_bytes(content[:4], "little") <= 5000 else ">"
        at = 0
        while at < len(content):
            kind, n_rows, n_columns, imaginary, n_letters = struct.unpack_from(f"{order}5i", content, at)
            machine, _, precision, meaning = kind // 1000, kind // 100 % 10, kind // 10 % 10, kind % 10
            if not 0 <= kind <= 5000 or machine != (order == ">") or precision > 5 or min(n_rows, n_columns) < 0:
                raise RecordingFormatError(f"{self.where}: expected a MATLAB file; got no header of version 4 to 7.3")
            values_type = np.dtype(f"{order}{_TYPES_OF_VERSION_4[precision]}")
            start = at + 20 + n_letters
            end = start + n_rows * n_columns * values_type.itemsize * (2 if imaginary else 1)
            if not 0 < n_letters <= _LONGEST_NAME + 1 or end > len(content):
                raise RecordingFormatError(f"{self.where}: expected {end} bytes; got {len(content)}: it is cut off")
            name = content[at + 20 : start].split(b"\0")[0].decode("latin-1")
            if meaning != 1 and (meaning or imaginary):
                self._leave_out(name, "complex" if imaginary and not meaning else "sparse")
            if meaning == 0 and not imaginary:
                values = np.frombuffer(content, values_type, n_rows * n_columns, start)
                yield name, values.reshape((n_rows, n_columns), order="F")
            at = end

    def arrays(self, content: bytes) -> Iterator[tuple[str, np.ndarray]]:
        mark = content[126:_HEADER_SIZE]
        if mark not in (b"IM", b"MI"):
            raise RecordingFormatError(f"{self.where}: expected a MATLAB file with byte order IM or MI; got {mark!r}")
        self.order = "<" if mark == b"IM" else ">"
        for element in self._elements(memoryview(content)[_HEADER_SIZE:]):
            matrix = self._unpacked(element) if element.kind == _COMPRESSED else element
            if matrix.kind != _MATRIX:
                raise RecordingFormatError(
                    f"{self.where}: expected arrays (element type {_MATRIX}); got type {matrix.kind}"
                )
            yield from self._arrays_in(matrix.content)

    def _unpacked(self, element: _Element) -> _Element:
        # two passes, so that a bomb is known by its size before memory is given for it
        self.n_unpacked += unpacked_size(element.content, most_unpacked(self.n_bytes) - self.n_unpacked)
        require_plausible_expansion(self.n_unpacked, self.n_bytes, self.where)
        inflate = zlib.decompressobj()
        inflated = inflate.decompress(element.content, _MOST_BYTES)
        if not inflate.eof:
            raise RecordingFormatError(
                f"{self.where}: expected a complete compressed array; it is cut off or too large"
            )
        (matrix,) = self._elements(memoryview(inflated))
        return matrix

    def _elements(self, content: memoryview) -> Iterator[_Element]:
        at = 0
        while at < len(content):
            if at + 8 > len(content):
                raise RecordingFormatError(f"{self.where}: expected the tag of an element; the file is cut off")
            kind, size = struct.unpack_from(f"{self.order}II", content, at)
            start = at + 8
            if kind >> 16:  # small element: up to four bytes inside the tag
                kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if start + size > len(content) or (start == at + 4 and size > 4):
                raise RecordingFormatError(
                    f"{self.where}: expected {size} bytes in an element; the file ends before: it is cut off"
                )
            yield _Element(kind, content[start : start + size])
            # compressed elements are not padded; all others end on a multiple of eight bytes
            at = start + size if kind == _COMPRESSED else at + -(-(start + size - at) // 8) * 8

    def _arrays_in(self, content: memoryview, name: str = "", depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the arrays of a matrix element: itself, or those in its fields. ``name``: of a field."""
        if not len(content):  # a field that was never filled
            return
        flags, *parts = self._elements(content)
        word = int(np.frombuffer(flags.content, f"{self.order}u4")[0])
        kind = word & 0xFF
        if kind == _OPAQUE:  # has a name, but no dimensions
            self.n_objects += 1
            self._leave_out(name or bytes(parts[0].content).decode("utf-8"), "object")
            return
        dimensions, own_name, *parts = parts
        shape = tuple(int(n) for n in np.frombuffer(dimensions.content, f"{self.order}i4"))
        label = name or bytes(own_name.content).decode("utf-8")
        if not label:
            return
        if kind in _NOT_READ:
            self._leave_out(label, _NOT_READ[kind])
        elif kind in _NUMERIC_CLASSES and word >> 8 & _COMPLEX:
            self._leave_out(label, "complex")
        elif kind in _NUMERIC_CLASSES and len(shape) != 2:
            self._leave_out(label, f"{len(shape)} dimensions")
        if len(shape) != 2:
            return
        if kind == _STRUCTURE and depth < _DEEPEST:
            yield from self._arrays_of_structure(parts, shape, label, depth)
        elif kind in _NUMERIC_CLASSES and not word >> 8 & _COMPLEX:
            yield label, self._array(parts, shape, label, single=kind == _SINGLE)

    def _leave_out(self, name: str, why: str) -> None:
        if len(self.left_out) <= MOST_LEFT_OUT:
            self.left_out.append(f"{name[:_LONGEST_NAME]} ({why})")

    def _arrays_of_structure(
        self, parts: list[_Element], shape: tuple[int, ...], name: str, depth: int
    ) -> Iterator[tuple[str, np.ndarray]]:
        length, names, *values = parts
        width = int(np.frombuffer(length.content, f"{self.order}i4")[0])
        if not 0 < width <= _LONGEST_NAME:
            raise RecordingFormatError(f"{self.where}, {name}: expected names of 1 to 64 bytes; got {width}")
        letters = bytes(names.content)
        fields = [letters[at : at + width].split(b"\0")[0].decode("utf-8") for at in range(0, len(letters), width)]
        n_structures = math.prod(shape)
        if len(values) != n_structures * len(fields):
            raise RecordingFormatError(
                f"{self.where}, {name}: expected {n_structures * len(fields)} fields as its header says; "
                f"got {len(values)}"
            )
        if len(values) > MAX_CHANNELS:  # a table kept as structures of single numbers
            return
        for number, value in enumerate(values):
            of = name if n_structures == 1 else f"{name}({number // len(fields) + 1})"
            if value.kind == _MATRIX:
                yield from self._arrays_in(value.content, f"{of}.{fields[number % len(fields)]}", depth + 1)

    def _array(self, parts: list[_Element], shape: tuple[int, ...], name: str, *, single: bool) -> np.ndarray:
        place = f"{self.where}, {name}"
        require_plausible_length(math.prod(shape), place)
        if len(parts) != 1 or parts[0].kind not in _STORED_AS:
            raise RecordingFormatError(
                f"{place}: expected one element of numbers; got types {[part.kind for part in parts]}"
            )
        values = np.frombuffer(parts[0].content, f"{self.order}{_STORED_AS[parts[0].kind]}")
        if values.size != math.prod(shape):
            raise RecordingFormatError(f"{place}: expected {shape} values as its header says; got {values.size}")
        array = values.reshape(shape, order="F")
        return array.astype(np.float32) if single else array
