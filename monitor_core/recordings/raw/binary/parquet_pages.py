"""Look at the footer and the pages of a Parquet file before a library does (Apache Parquet format 2, in Thrift).

Column chunks are pages, each behind a header in Thrift's compact protocol that says how long it is, packed and
unpacked. The library gives memory for what a header says; here the headers are added up first. Where the chunks lie
says the footer. It is read here, too: asked for a damaged chunk, the library ends the process (1 of 100 damaged files).
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from monitor_core.errors import RecordingFormatError

_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)
_DEEPEST = 16
_LONGEST_HEADER = 2**16
_UNPACKED, _PACKED = 2, 3  # fields of a page header: sizes in bytes
_TAIL = 8  # length of the footer, PAR1
# fields of the footer, by structure
_ROW_GROUPS, _COLUMNS, _META_DATA, _PATH, _CHUNK_PACKED, _DATA_PAGE, _DICTIONARY_PAGE = 4, 1, 3, 3, 7, 9, 11


@dataclass(frozen=True, slots=True)
class ColumnChunk:
    """Where the pages of one column of one row group lie [bytes]."""

    path: str  # of the column in the schema
    start: int
    size: int


def column_chunks(stream: BinaryIO, n_bytes: int, where: str) -> list[ColumnChunk]:
    """Return the column chunks of a Parquet file of so many bytes.

    ``RecordingFormatError`` if its footer is damaged.
    """
    try:
        stream.seek(max(n_bytes - _TAIL, 0))
        (length,) = struct.unpack("<I4x", stream.read(_TAIL))
        stream.seek(max(n_bytes - _TAIL - length, 0))
        reader, chunks = _Compact(stream.read(length)), list[ColumnChunk]()
        for number, kind in reader.parts():
            if (number, kind) == (_ROW_GROUPS, _LIST):
                for _ in reader.elements(_STRUCT):
                    chunks += _chunks_of_group(reader)
    except (IndexError, KeyError, struct.error, UnicodeDecodeError) as error:
        raise RecordingFormatError(
            f"{where}: expected the footer of a Parquet file; it is damaged ({error})"
        ) from error
    return chunks


def _chunks_of_group(reader: "_Compact") -> Iterator[ColumnChunk]:
    for number, kind in reader.parts():
        if (number, kind) == (_COLUMNS, _LIST):
            for _ in reader.elements(_STRUCT):
                yield from _chunks_of_column(reader)


def _chunks_of_column(reader: "_Compact") -> Iterator[ColumnChunk]:
    for number, kind in reader.parts():
        if (number, kind) == (_META_DATA, _STRUCT):
            stated, path = dict[int, int](), list[str]()
            for name, of in reader.parts():
                if of in (_I16, _I32, _I64):
                    stated[name] = reader.signed()
                elif (name, of) == (_PATH, _LIST):
                    path = [reader.binary().decode() for _ in reader.elements(_BINARY)]
            # a dictionary page at 0 is none: the file begins with PAR1
            starts = [at for at in (stated[_DATA_PAGE], stated.get(_DICTIONARY_PAGE, 0)) if at]
            yield ColumnChunk(".".join(path), min(starts, default=0), stated[_CHUNK_PACKED])


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

    def parts(self) -> Iterator[tuple[int, int]]:
        """Yield number and kind of each field of a structure; whoever asks reads its value, or it is passed over."""
        number = 0
        while (head := self.byte()) != _STOP:
            number = number + (head >> 4) if head >> 4 else self.signed()
            before = self.at
            yield number, head & 0x0F
            if self.at == before:
                self.skip(head & 0x0F, 0)

    def elements(self, kind: int) -> Iterator[None]:
        """Yield for each element of a list; whoever asks reads it."""
        head = self.byte()
        if head & 0x0F != kind:
            raise IndexError(f"a list of type {head & 0x0F}, not {kind}")
        for _ in range(head >> 4 if head >> 4 != 15 else self._count()):
            yield

    def binary(self) -> bytes:
        length = self.varint()
        self.at += length
        if self.at > len(self.content):
            raise IndexError("a text that ends behind the footer")
        return self.content[self.at - length : self.at]

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
