"""Look at the blocks of an MDF 4 file before a library follows them (ASAM MDF 4.1, chapter 5: block structure).

Every block has a header of 24 bytes (``##`` and two letters, length, number of links), its links, which are addresses
in the file, and its data. The library follows links without a memory of where it was and unpacks what it is given:
lists that run in circles, records that end outside of their data and packed data that become more than they say are
refused here.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import (
    require_plausible_channels,
    require_plausible_expansion,
    unpacked_size,
)

_HEADER = struct.Struct("<4s4xQQ")
_FIRST = 64  # of the header block, behind the identification
_MOST_LINKS = 2**20
_HEAD = 128  # bytes of its data that are looked at; only packed ones are read to the end
_DATA = frozenset((b"##DT", b"##DV", b"##SD", b"##RD", b"##DI"))
_TEXT_FREE = frozenset((0, 1, 2, 3, 4, 5))  # data types of numbers
_VIRTUAL = frozenset((3, 6))  # channels without bytes in the record
_OF_OTHER_LENGTH = 1  # flag of a channel group that keeps texts
_FORMULA = 3  # conversion by a text with a formula
_DEFLATED = (0, 1)


@dataclass(frozen=True, slots=True)
class _Block:
    kind: bytes
    links: tuple[int, ...]
    start: int  # of its data in the file
    size: int  # of its data
    head: bytes  # the first of them

    def link(self, number: int) -> int:
        return self.links[number] if number < len(self.links) else 0


@dataclass(slots=True)
class _Walk:
    """The file, and which blocks were met: those of a list or a tree are met once."""

    stream: BinaryIO
    n_bytes: int
    where: str
    met: set[int] = field(default_factory=set)
    unpacked: int = 0

    def read(self, at: int, size: int) -> bytes:
        self.stream.seek(at)
        return self.stream.read(size)

    def block(self, at: int, *kinds: bytes) -> _Block:
        if not _FIRST <= at <= self.n_bytes - _HEADER.size:
            raise RecordingFormatError(
                f"{self.where}: expected a block at byte {at}; the file has {self.n_bytes} bytes"
            )
        kind, length, n_links = _HEADER.unpack(self.read(at, _HEADER.size))
        start = at + _HEADER.size + 8 * n_links
        if kinds and kind not in kinds:
            expected = " or ".join(k.decode() for k in kinds)
            raise RecordingFormatError(f"{self.where}: expected a block {expected} at byte {at}; got {kind!r}")
        if n_links > _MOST_LINKS or start > at + length or at + length > self.n_bytes:
            raise RecordingFormatError(
                f"{self.where}: expected {length} bytes in the block at byte {at}; the file ends before: it is cut off"
            )
        links = struct.unpack(f"<{n_links}Q", self.read(at + _HEADER.size, 8 * n_links))
        size = at + length - start
        return _Block(kind, links, start, size, self.read(start, min(size, _HEAD)))

    def once(self, at: int, *kinds: bytes) -> _Block:
        if at in self.met:
            raise RecordingFormatError(f"{self.where}: expected lists that end; the block at byte {at} comes twice")
        self.met.add(at)
        return self.block(at, *kinds)

    def listed(self, at: int, kind: bytes) -> Iterator[_Block]:
        """Yield the blocks of a list: the first link of each leads to the next."""
        while at:
            block = self.once(at, kind)
            yield block
            at = block.link(0)


def require_sound_blocks(path: Path) -> None:
    """Refuse an MDF 4 file whose blocks contradict each other, or announce more than it holds."""
    with path.open("rb") as stream:
        _walk(_Walk(stream, path.stat().st_size, path.name))


def _walk(walk: _Walk) -> None:
    header = walk.once(_FIRST, b"##HD")
    for number, kind in ((1, b"##FH"), (3, b"##AT"), (4, b"##EV")):
        for _ in walk.listed(header.link(number), kind):
            pass
    announced: list[tuple[str, int]] = []
    for group in walk.listed(header.link(0), b"##DG"):
        n_bytes = _size_of_data(walk, group.link(2))
        in_records = 0
        for channels in walk.listed(group.link(1), b"##CG"):
            n_records, record_size, numbers = _channel_group(walk, channels)
            in_records += n_records * record_size
            announced += [(name, n_records) for name in numbers]
        if in_records > n_bytes:
            raise RecordingFormatError(
                f"{walk.where}: expected {in_records} bytes of records as its header says; got {n_bytes}: it is cut off"
            )
    require_plausible_channels(announced, walk.where)


def _channel_group(walk: _Walk, group: _Block) -> tuple[int, int, list[str]]:
    """Return how many records it has, the bytes of one, and its channels of numbers."""
    n_records, flags, n_bytes, n_validity = struct.unpack_from("<8xQH6xII", group.head)
    of_other_length = bool(flags & _OF_OTHER_LENGTH)
    numbers: list[str] = []
    for channel in _channels(walk, group.link(1)):
        kind, data_type, bit_offset, byte_offset, n_bits = struct.unpack_from("<BxBBII", channel.head)
        _require_no_formula(walk, channel.link(4))
        if of_other_length or kind in _VIRTUAL:
            continue
        if byte_offset + -(-(bit_offset + n_bits) // 8) > n_bytes + n_validity or bit_offset > 7:
            raise RecordingFormatError(
                f"{walk.where}: expected channels within records of {n_bytes} bytes; got one at byte {byte_offset}"
            )
        if data_type in _TEXT_FREE:
            numbers.append(f"channel {len(numbers) + 1}")
    return (0, 0, []) if of_other_length else (n_records, n_bytes + n_validity, numbers)


def _channels(walk: _Walk, first: int) -> Iterator[_Block]:
    waiting = [first]
    while waiting:
        for channel in walk.listed(waiting.pop(), b"##CN"):
            yield channel
            at = channel.link(1)  # of a structure: its own list of channels; of an array: how it lies
            if at and walk.block(at).kind == b"##CN":
                waiting.append(at)


def _require_no_formula(walk: _Walk, first: int) -> None:
    waiting, seen = [first] if first else [], set[int]()
    while waiting:
        at = waiting.pop()
        if at in seen:
            continue
        seen.add(at)
        conversion = walk.block(at)
        if conversion.kind != b"##CC":  # texts
            continue
        if conversion.head[0] == _FORMULA:
            raise RecordingFormatError(
                f"{walk.where}: expected numbers, linear or tabulated; got a channel with a formula as text, which is "
                "not evaluated: export it with its values"
            )
        waiting += [link for link in conversion.links[4:] if link]


def _size_of_data(walk: _Walk, first: int) -> int:
    """Return the bytes of the records of a data group, once unpacked."""
    total, waiting = 0, [first] if first else []
    while waiting:
        block = walk.once(waiting.pop())
        if block.kind in _DATA:
            total += block.size
        elif block.kind == b"##DZ":
            size = _size_of_packed(walk, block)
            total += size
            walk.unpacked += size
        elif block.kind in (b"##DL", b"##HL", b"##LD"):
            waiting += [link for link in block.links if link]
        else:
            raise RecordingFormatError(f"{walk.where}: expected records; got a block {block.kind!r}")
    return total


def _size_of_packed(walk: _Walk, block: _Block) -> int:
    packing, parameter, size, n_packed = struct.unpack_from("<2xBxIQQ", block.head)
    if packing not in _DEFLATED or (packing == 1 and not parameter):
        raise RecordingFormatError(
            f"{walk.where}: expected records packed by deflate; got packing {packing}: save it without compression"
        )
    if n_packed > block.size - 24:
        raise RecordingFormatError(f"{walk.where}: expected {n_packed} packed bytes; the file is cut off")
    require_plausible_expansion(walk.unpacked + size, walk.n_bytes, walk.where)
    if unpacked_size(walk.read(block.start + 24, n_packed), size) != size:
        raise RecordingFormatError(f"{walk.where}: expected records that unpack to {size} bytes; they do not")
    return int(size)
