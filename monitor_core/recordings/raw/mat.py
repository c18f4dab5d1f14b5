"""Read MATLAB files, ``*.mat`` of version 4 to 7.2: every array of real numbers is a channel of its name.

Version 5 to 7.2 is read here, by the layout of *MAT-File Format* (The MathWorks): a header of 128 bytes, then elements,
each a tag (type, number of bytes) and its bytes. ``scipy.io.loadmat`` reads the same, but trusts the type codes: with
single damaged bytes it ended the process in 26 of 2000 trials. It serves for version 4.
"""

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import MAX_SAMPLES, refusing, require_file, require_plausible_length
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEADER_SIZE = 128
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_STORED_AS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_SINGLE = 7
_NUMERIC_CLASSES = range(6, 16)  # double, single, and the integers from int8 to uint64
_COMPLEX = 0x08
_MOST_BYTES = 8 * MAX_SAMPLES + 4096


def read_channels(path: Path) -> Channels:
    """Read the numeric arrays of a MATLAB file of version 4 to 7.2; it states neither units nor a time base.

    There is one channel per array; MATLAB's rows and columns of one become one-dimensional. Single numbers, structures,
    cells, texts, complex numbers and arrays of more than two dimensions are no channels and are left out.
    ``RecordingFormatError`` if the file is damaged, or of version 7.3, which is another format.
    """
    content = require_file(path).read_bytes()
    if _HDF5_SIGNATURE in (content[:8], content[512:520]) or content.startswith(b"MATLAB 7.3"):
        raise RecordingFormatError(
            f"{path.name}: expected a MATLAB file of version 4 to 7.2; got version 7.3 (HDF5): save it with '-v7'"
        )
    with refusing(path.name, "a MATLAB file of version 4 to 7.2"):
        arrays = _arrays_of_version_4(path) if 0 in content[:4] else _arrays(content, path.name)
        return Channels(path.name, tuple(_channel(name, array) for name, array in arrays if array.size > 1))


def _channel(name: str, array: np.ndarray) -> Channel:
    return Channel(name, native_samples(array.reshape(-1) if 1 in array.shape else array))


def _arrays_of_version_4(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    import scipy.io  # noqa: PLC0415

    for name, array in scipy.io.loadmat(path).items():
        if isinstance(array, np.ndarray) and array.ndim == 2 and array.dtype.kind in "fiu":
            yield name, array


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    content: memoryview


def _arrays(content: bytes, where: str) -> Iterator[tuple[str, np.ndarray]]:
    mark = content[126:_HEADER_SIZE]
    if mark not in (b"IM", b"MI"):
        raise RecordingFormatError(f"{where}: expected a MATLAB file with byte order IM or MI; got {mark!r}")
    order = "<" if mark == b"IM" else ">"
    for element in _elements(memoryview(content)[_HEADER_SIZE:], order, where):
        matrix = element
        if element.kind == _COMPRESSED:
            inflate = zlib.decompressobj()
            inflated = inflate.decompress(element.content, _MOST_BYTES)
            if not inflate.eof:
                raise RecordingFormatError(f"{where}: expected a complete compressed array; it is cut off or too large")
            (matrix,) = _elements(memoryview(inflated), order, where)
        if matrix.kind != _MATRIX:
            raise RecordingFormatError(f"{where}: expected arrays (element type {_MATRIX}); got type {matrix.kind}")
        array = _array(matrix.content, order, where)
        if array is not None:
            yield array


def _elements(content: memoryview, order: str, where: str) -> Iterator[_Element]:
    byte_order = "little" if order == "<" else "big"
    at = 0
    while at < len(content):
        kind = int.from_bytes(content[at : at + 4], byte_order)  # type: ignore[arg-type]  # a str, not the literal
        size = int.from_bytes(content[at + 4 : at + 8], byte_order)  # type: ignore[arg-type]
        start = at + 8
        if kind >> 16:  # small element: up to four bytes inside the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
        if start + size > len(content) or (start == at + 4 and size > 4):
            raise RecordingFormatError(
                f"{where}: expected {size} bytes in an element; the file ends before: it is cut off"
            )
        yield _Element(kind, content[start : start + size])
        # compressed elements are not padded; all others end on a multiple of eight bytes
        at = start + size if kind == _COMPRESSED else at + -(-(start + size - at) // 8) * 8


def _array(content: memoryview, order: str, where: str) -> tuple[str, np.ndarray] | None:
    flags, dimensions, name, *parts = _elements(content, order, where)
    word = int(np.frombuffer(flags.content, f"{order}u4")[0])
    shape = tuple(int(n) for n in np.frombuffer(dimensions.content, f"{order}i4"))
    label = bytes(name.content).decode("utf-8")
    if word & 0xFF not in _NUMERIC_CLASSES or word >> 8 & _COMPLEX or len(shape) != 2 or not label:
        return None
    place = f"{where}, {label}"
    require_plausible_length(math.prod(shape), place)
    if len(parts) != 1 or parts[0].kind not in _STORED_AS:
        raise RecordingFormatError(
            f"{place}: expected one element of numbers; got types {[part.kind for part in parts]}"
        )
    values = np.frombuffer(parts[0].content, f"{order}{_STORED_AS[parts[0].kind]}")
    if values.size != math.prod(shape):
        raise RecordingFormatError(f"{place}: expected {shape} values as its header says; got {values.size}")
    array = values.reshape(shape, order="F")
    return label, array.astype(np.float32) if word & 0xFF == _SINGLE else array
