"""Read WAV files, as sound cards and data recorders write them: channels "1", "2", … with the sample rate of the file.

Layout: *Multimedia Programming Interface and Data Specifications 1.0* (RIFF, 1991); ``WAVE_FORMAT_EXTENSIBLE``; RF64 of
EBU Tech 3306 beyond 4 GB; RIFX is RIFF in big-endian order. Whole numbers are counts of the converter, as they are
stored: 8 bits without sign (silence is 128), 16, 24 and 32 bits with sign. Floating-point numbers stay as they are.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import require_plausible_channels
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.raw.channel_time import even_time
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_CODINGS = {2: "ADPCM", 6: "A-law", 7: "µ-law", 17: "ADPCM", 85: "MP3"}
#: Container → byte order.
_ORDERS = {b"RIFF": "<", b"RIFX": ">", b"RF64": "<", b"BW64": "<"}
_IN_DS64 = 0xFFFFFFFF
_TYPES = {(_PCM, 8): "u1", (_PCM, 16): "i2", (_PCM, 24): "u1", (_PCM, 32): "i4", (_FLOAT, 32): "f4", (_FLOAT, 64): "f8"}


@dataclass(frozen=True, slots=True)
class _Chunk:
    name: bytes
    start: int
    size: int


@dataclass(frozen=True, slots=True)
class _Coding:
    kind: int
    n_channels: int
    sample_rate: int
    n_bits: int

    @property
    def frame_size(self) -> int:
        return self.n_channels * self.n_bits // 8


def read_channels(path: Path) -> Channels:
    """Read the channels of a WAV file; whole numbers have the unit "count", floating-point numbers none.

    The file states no start with a zone. ``RecordingFormatError`` if it is damaged, cut off, or compressed.
    """
    with refusing(path.name, "a WAV file"), require_file(path).open("rb") as stream:
        order, chunks = _chunks(stream, path)
        coding = _coding(_only(stream, chunks, b"fmt ", path.name), order, path.name)
        data = next((chunk for chunk in chunks if chunk.name == b"data"), _Chunk(b"data", 0, 0))
        n_frames, rest = divmod(data.size, coding.frame_size)
        if rest or not n_frames:
            raise RecordingFormatError(
                f"{path.name}: expected samples of {coding.frame_size} bytes for all channels; got {data.size} bytes"
            )
        names = [str(number) for number in range(1, coding.n_channels + 1)]
        require_plausible_channels([(name, n_frames) for name in names], path.name)
        stream.seek(data.start)
        frames = _frames(stream.read(data.size), coding, order)
    unit, rate = ("count" if coding.kind == _PCM else None), float(coding.sample_rate)
    time = even_time(n_frames, rate)
    return Channels(path.name, tuple(Channel(n, native_samples(frames[:, i]), unit, time) for i, n in enumerate(names)))


def _chunks(stream: BinaryIO, path: Path) -> tuple[str, list[_Chunk]]:
    n_bytes = path.stat().st_size
    head = stream.read(12)
    if head[:4] not in _ORDERS or head[8:] != b"WAVE":
        raise RecordingFormatError(f"{path.name}: expected a WAV file that begins with RIFF … WAVE; got {head!r}")
    chunks = list(_followed(stream, _ORDERS[head[:4]], n_bytes, path.name))
    names = [chunk.name for chunk in chunks]
    if names.count(b"data") > 1:
        raise RecordingFormatError(f"{path.name}: expected one block of samples; got {names.count(b'data')}")
    return _ORDERS[head[:4]], chunks


def _followed(stream: BinaryIO, order: str, n_bytes: int, where: str) -> Iterator[_Chunk]:
    at, long_size = 12, None
    while at + 8 <= n_bytes:
        stream.seek(at)
        name, size = struct.unpack(f"{order}4sI", stream.read(8))
        if name == b"ds64":
            long_size = struct.unpack("<8xQ", stream.read(16))[0]
        if name == b"data" and size == _IN_DS64 and long_size is not None:
            size = long_size
        if at + 8 + size > n_bytes:
            raise RecordingFormatError(
                f"{where}: expected {size} bytes in its chunk {name.decode('latin-1')!r}; got {n_bytes - at - 8}: "
                "the file is cut off, or was never closed by its writer"
            )
        yield _Chunk(name, at + 8, size)
        at += 8 + size + size % 2  # chunks begin at even bytes


def _only(stream: BinaryIO, chunks: list[_Chunk], name: bytes, where: str) -> bytes:
    found = [chunk for chunk in chunks if chunk.name == name]
    if len(found) != 1:
        raise RecordingFormatError(f"{where}: expected one chunk {name.decode()!r}; got {len(found)}")
    stream.seek(found[0].start)
    return stream.read(min(found[0].size, 64))


def _coding(content: bytes, order: str, where: str) -> _Coding:
    if len(content) < 16:
        raise RecordingFormatError(f"{where}: expected at least 16 bytes in its chunk 'fmt '; got {len(content)}")
    kind, n_channels, sample_rate, _, frame_size, n_bits = struct.unpack(f"{order}HHIIHH", content[:16])
    if kind == _EXTENSIBLE and len(content) >= 26:
        kind = struct.unpack(f"{order}H", content[24:26])[0]  # the sub-format begins with the same codes
    if (kind, n_bits) not in _TYPES:
        name = _CODINGS.get(kind, f"coding {kind}")
        got = f"{n_bits} bits" if kind in (_PCM, _FLOAT) else name
        raise RecordingFormatError(
            f"{where}: expected 8, 16, 24 or 32 bits, or floating point of 32 or 64; got {got}: save it as PCM"
        )
    coding = _Coding(kind, n_channels, sample_rate, n_bits)
    if not n_channels or not sample_rate or frame_size != coding.frame_size:
        raise RecordingFormatError(
            f"{where}: expected channels, a sample rate and {coding.frame_size} bytes for the samples of one instant; "
            f"got {n_channels} channels at {sample_rate} Hz in {frame_size} bytes"
        )
    return coding


def _frames(content: bytes, coding: _Coding, order: str) -> npt.NDArray[np.generic]:
    values = np.frombuffer(content, f"{order}{_TYPES[coding.kind, coding.n_bits]}")
    if (coding.kind, coding.n_bits) != (_PCM, 24):
        return values.reshape(-1, coding.n_channels)
    # three bytes become the upper three of four, and a shift with sign brings them down
    wide = np.zeros((values.size // 3, 4), "u1")
    wide[:, 1:] = values.reshape(-1, 3)[:, :: 1 if order == "<" else -1]
    return (wide.view("<i4") >> 8).reshape(-1, coding.n_channels)
