"""Guard the HDF5 library against damaged texts of variable length, which make it crash or loop for ever.

Such texts lie in *global heap collections* (HDF5 File Format Specification 3.0, section III.E): a header of 16 bytes
(``GCOL``, version 1, three zeros, size of the collection) and objects that follow each other, each with a header of 16
bytes (index, reference count, four reserved bytes, size) and its bytes, padded to a multiple of 8. Index 0 is the free
space at the end. The library follows these sizes without looking at them; here they are looked at before it does.
"""

import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from monitor_core.errors import RecordingFormatError

_COLLECTION = b"GCOL\x01"
_HEADER = struct.Struct("<HH4xQ")
_LEAST_SIZE = 4096
_HUGE_TEXT = 2**24  # [bytes]; names and instants are of a hundred
_UNDEFINED = 2**32 - 1
_CARRIED = 16  # [bytes]; a multiple of four, so that words stay where they are
_BLOCK = 2**20  # read in pieces, so that memory stays flat however large the session is


def require_sound_heap(path: Path) -> None:
    """Refuse an HDF5 file whose heap of texts would lead the library astray.

    ``RecordingFormatError`` if the sizes in a global heap collection contradict each other or the length of the file,
    or if a reference to a collection says that its text is of 16 MiB or more: the library gives memory for it at once.
    """
    n_bytes = path.stat().st_size
    with path.open("rb") as stream:
        collections, claimed = _scanned(stream, n_bytes)
        for start in sorted(collections):
            objects = _objects(stream, start, n_bytes)
            if objects is None or objects & claimed.get(start, set()):
                raise RecordingFormatError(
                    f"{path.name}: expected an HDF5 file; got one whose texts are damaged (heap at byte {start})"
                )


def _scanned(stream: BinaryIO, n_bytes: int) -> tuple[set[int], dict[int, set[int]]]:
    """Return where collections seem to begin, and by their address the objects that seem to be referred to as huge.

    A reference is the length of the text (4 bytes), the address of the collection (8) and the number of the object (4),
    on a multiple of four bytes. Half of an address that is not defined is no length: it stands in front of others.
    """
    collections, claimed = set[int](), dict[int, set[int]]()
    offset, carried = 0, b""
    while block := stream.read(_BLOCK):
        data = carried + block
        start = data.find(_COLLECTION)
        while start >= 0:
            collections.add(offset + start)
            start = data.find(_COLLECTION, start + 1)
        words = np.frombuffer(data, "<u4", len(data) // 4)
        # the upper half of an address is nearly always zero, and of samples nearly never: few are left to look at
        at = np.flatnonzero(words[2:-1] <= n_bytes >> 32)
        at = at[(words[at] >= _HUGE_TEXT) & (words[at] != _UNDEFINED)]
        addresses = words[at + 1].astype(np.uint64) | words[at + 2].astype(np.uint64) << np.uint64(32)
        inside = addresses < n_bytes
        for address, number in zip(addresses[inside].tolist(), words[at + 3][inside].tolist(), strict=True):
            claimed.setdefault(address, set()).add(number)
        carried = data[-_CARRIED:]  # a header or a reference may lie across two blocks
        offset += len(data) - len(carried)
    return collections, claimed


def _objects(stream: BinaryIO, start: int, n_bytes: int) -> set[int] | None:
    """Return the numbers of the objects of a collection; None if its sizes contradict each other."""
    stream.seek(start)
    header = stream.read(_HEADER.size)
    reserved, size = header[5:8], int.from_bytes(header[8:], "little")
    end = start + size
    if size < _LEAST_SIZE or end > n_bytes:
        return set() if reserved != bytes(3) else None  # five bytes of samples that happen to read like a header
    if reserved != bytes(3):
        return None
    at, seen = start + _HEADER.size, set[int]()
    piece, begin = b"", at
    while end - at >= _HEADER.size:
        if at - begin > len(piece) - _HEADER.size:
            piece, begin = _read_at(stream, at), at
        index, _, length = _HEADER.unpack_from(piece, at - begin)
        if index == 0:
            return seen if _HEADER.size <= length == end - at else None
        at += _HEADER.size + -(-length // 8) * 8
        if index in seen or at > end:
            return None
        seen.add(index)
    return seen


def _read_at(stream: BinaryIO, at: int) -> bytes:
    stream.seek(at)
    return stream.read(_LEAST_SIZE)
