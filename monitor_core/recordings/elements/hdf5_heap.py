"""Guard the HDF5 library against damaged texts of variable length, which make it crash or loop for ever.

Such texts lie in *global heap collections* (HDF5 File Format Specification 3.0, section III.E): a header of 16 bytes
(``GCOL``, version 1, three zeros, size of the collection) and objects that follow each other, each with a header of 16
bytes (index, reference count, four reserved bytes, size) and its bytes, padded to a multiple of 8. Index 0 is the free
space at the end. The library follows these sizes without looking at them; here they are looked at before it does.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from monitor_core.errors import RecordingFormatError

_COLLECTION = b"GCOL\x01"
_HEADER = struct.Struct("<HH4xQ")
_LEAST_SIZE = 4096
_BLOCK = 2**20  # read in pieces, so that memory stays flat however large the session is


def require_sound_heap(path: Path) -> None:
    """Refuse an HDF5 file whose heap of texts would lead the library astray.

    ``RecordingFormatError`` if the sizes in a global heap collection contradict each other or the length of the file.
    """
    n_bytes = path.stat().st_size
    with path.open("rb") as scanned, path.open("rb") as stream:
        for start in _collections(scanned):
            if not _is_sound(stream, start, n_bytes):
                raise RecordingFormatError(
                    f"{path.name}: expected an HDF5 file; got one whose texts are damaged (heap at byte {start})"
                )


def _collections(stream: BinaryIO) -> Iterator[int]:
    """Yield where a header of a collection seems to begin."""
    offset, carried = 0, b""
    while block := stream.read(_BLOCK):
        data = carried + block
        start = data.find(_COLLECTION)
        while start >= 0:
            yield offset + start
            start = data.find(_COLLECTION, start + 1)
        carried = data[-(len(_COLLECTION) - 1) :]  # a header may lie across two blocks
        offset += len(data) - len(carried)


def _is_sound(stream: BinaryIO, start: int, n_bytes: int) -> bool:
    stream.seek(start)
    header = stream.read(_HEADER.size)
    reserved, size = header[5:8], int.from_bytes(header[8:], "little")
    end = start + size
    if size < _LEAST_SIZE or end > n_bytes:
        return reserved != bytes(3)  # five bytes of samples that happen to read like a header
    if reserved != bytes(3):
        return False
    at, seen = start + _HEADER.size, set[int]()
    while end - at >= _HEADER.size:
        stream.seek(at)
        index, _, length = _HEADER.unpack(stream.read(_HEADER.size))
        if index == 0:
            return bool(_HEADER.size <= length == end - at)
        at += _HEADER.size + -(-length // 8) * 8
        if index in seen or at > end:
            return False
        seen.add(index)
    return True
