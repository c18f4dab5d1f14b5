"""Look at the pages of a Parquet file before a library unpacks them (Apache Parquet format 2: page headers in Thrift).

Column chunks are pages, each behind a header in Thrift's compact protocol that says how long it is, packed and
unpacked. The library gives memory for what a header says; here the headers are added up first.
"""

from collections.abc import Iterator
from typing import BinaryIO

from monitor_core.errors import RecordingFormatError

_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)
_DEEPEST = 16
_LONGEST_HEADER = 2**16
_UNPACKED, _PACKED = 2, 3  # fields of a page header: sizes in bytes


class _Compact:
    """Reads the one-level numbers of a Thrift structure, and passes over all else."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0

    def byte(self) -> int:
        value = self.content[self.at]
        self.at += 1
        return value

    def varint(self) -> int:
        value, shift = 0, 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7
            if shift > 63:
                raise IndexError("a number of more than 64 bits")

    def signed(self) -> int:
        value = self.varint()
        return (value >> 1) ^ -(value & 1)

    def fields(self, depth: int = 0) -> Iterator[tuple[int, int]]:
        """Yield number and value of each whole number of a structure, and pass over its other fields."""
        if depth > _DEEPEST:
            raise IndexError("structures nested too deeply")
        number = 0
        while (head := self.byte()) != _STOP:
            number = number + (head >> 4) if head >> 4 else self.signed()
            kind = head & 0x0F
            if kind in (_I16, _I32, _I64):
                yield number, self.signed()
            else:
                self.skip(kind, depth)

    def skip(self, kind: int, depth: int) -> None:
        if kind in (_TRUE, _FALSE):
            return
        if kind == _BYTE:
            self.at += 1
        elif kind in (_I16, _I32, _I64):
            self.varint()
        elif kind == _DOUBLE:
            self.at += 8
        elif kind == _BINARY:
            length = self.varint()  # moves on by itself
            self.at += length
        elif kind in (_LIST, _SET):
            head = self.byte()
            for _ in range(head >> 4 if head >> 4 != 15 else self._count()):
                self.skip_element(head & 0x0F, depth)
        elif kind == _STRUCT:
            for _ in self.fields(depth + 1):
                pass
        else:  # page headers hold no maps
            raise IndexError(f"type {kind}")

    def skip_element(self, kind: int, depth: int) -> None:
        if kind in (_TRUE, _FALSE):  # in a list each takes a byte
            self.at += 1
        else:
            self.skip(kind, depth)

    def _count(self) -> int:
        count = self.varint()
        if count > len(self.content):
            raise IndexError("a list longer than the file")
        return count


def unpacked_size_of_pages(stream: BinaryIO, start: int, end: int, where: str) -> int:
    """Return what the pages of a column chunk unpack to, as their headers say, one by one.

    ``start``, ``end``: where the chunk lies in the file. ``RecordingFormatError`` if a header is none, or a page ends
    outside of the chunk.
    """
    total, at = 0, start
    while at < end:
        stream.seek(at)
        reader = _Compact(stream.read(min(end - at, _LONGEST_HEADER)))
        try:
            stated = dict(reader.fields())
        except IndexError as error:
            raise RecordingFormatError(f"{where}: expected the header of a page at byte {at}; {error}") from error
        unpacked, packed = stated.get(_UNPACKED, -1), stated.get(_PACKED, -1)
        following = at + reader.at + packed
        if unpacked < 0 or packed < 0 or following > end:
            raise RecordingFormatError(
                f"{where}: expected a page within its column at byte {at}; got {packed} bytes that unpack to {unpacked}"
            )
        total += unpacked
        at = following
    return total
