"""Guard in front of the HDF5 library: texts of variable length in a damaged file make it crash or loop for ever.

Such texts lie in *global heap collections* (HDF5 File Format Specification 3.0, section III.E): a header of 16 bytes
(``GCOL``, version 1, three zeros, size of the collection) and objects that follow each other, each with a header of 16
bytes (index, reference count, four reserved bytes, size) and its bytes, padded to a multiple of 8. Index 0 is the free
space at the end. The library follows these sizes without looking at them; here they are looked at before it does.
"""

import mmap
import struct
from pathlib import Path

from monitor_core.errors import RecordingFormatError

_COLLECTION = b"GCOL\x01"
_HEADER = struct.Struct("<HH4xQ")
_LEAST_SIZE = 4096


def require_sound_heap(path: Path) -> None:
    """Refuse an HDF5 file whose heap of texts would lead the library astray.

    Raises
    ------
    RecordingFormatError
        If the sizes in a global heap collection contradict each other or the length of the file.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        start = data.find(_COLLECTION)
        while start >= 0:
            if not _is_sound(data, start):
                raise RecordingFormatError(
                    f"{path.name}: expected an HDF5 file; got one whose texts are damaged (heap at byte {start})"
                )
            start = data.find(_COLLECTION, start + 1)


def _is_sound(data: mmap.mmap, start: int) -> bool:
    reserved = data[start + 5 : start + 8]
    size = int.from_bytes(data[start + 8 : start + 16], "little")
    end = start + size
    if size < _LEAST_SIZE or end > len(data):
        return reserved != bytes(3)  # five bytes of samples that happen to read like a header
    if reserved != bytes(3):
        return False
    at, seen = start + 16, set[int]()
    while end - at >= _HEADER.size:
        index, _, length = _HEADER.unpack_from(data, at)
        if index == 0:
            return bool(_HEADER.size <= length == end - at)
        at += _HEADER.size + -(-length // 8) * 8
        if index in seen or at > end:
            return False
        seen.add(index)
    return True
