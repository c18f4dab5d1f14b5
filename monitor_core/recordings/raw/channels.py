"""Record of a raw file before a channel map gives it a meaning: named channels, named frequency responses."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from itertools import chain, islice
from types import MappingProxyType
from typing import cast

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray, read_only_samples
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import factor_to
from monitor_core.recordings.raw.channel_time import ChannelTime

#: So many names of what is not read are shown.
MOST_LEFT_OUT = 12
#: So many single numbers of a file are kept.
MOST_NUMBERS = 100
#: So many samples at the beginning show what a channel is, and so many are read from a file at a time.
HEAD, PIECE = 2**15, 2**18
#: Arrays with so few rows or columns hold a channel in each of them, not a window.
MOST_CHANNELS_IN_ARRAY = 16
#: Goes once through the file and yields pieces of channels: number, and the samples that come next, shape (n,).
Pieces = Callable[[Collection[int]], Iterator[tuple[int, SampleArray]]]


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """Samples that stay in their file until they are asked for."""

    shape: tuple[int, ...]
    head: SampleArray  # the first of them, see :func:`head_of`
    number: int  # of the channel in its file
    pieces: Pieces

    def read(self, where: str) -> SampleArray:
        """Read all of them. ``RecordingFormatError`` if the file holds fewer or more than it announces."""
        flat, n = np.empty(math.prod(self.shape), self.head.dtype), 0
        for _, piece in self.pieces((self.number,)):
            require_samples(n + piece.size <= flat.size, flat.size, n + piece.size, where)
            flat[n : n + piece.size] = piece
            n += piece.size
        require_samples(n == flat.size, flat.size, n, where)
        flat.setflags(write=False)
        return flat.reshape(self.shape)


def stored_samples(
    shape: tuple[int, ...], own: Iterable[SampleArray], number: int, pieces: Pieces
) -> Stored | SampleArray:
    """Return samples that stay in their file; few are read at once.

    ``own``: those of the file that is open now, of which the beginning is read; the others as of :class:`Stored`.
    """
    begun, n_begun = list[SampleArray](), 0
    for piece in own:
        begun.append(piece[: HEAD - n_begun].copy())
        n_begun += begun[-1].size
        if n_begun == HEAD:
            break
    head = cast(SampleArray, np.concatenate(begun)) if begun else np.empty(0)
    head.setflags(write=False)
    return head.reshape(shape) if n_begun == math.prod(shape) else Stored(shape, head, number, pieces)


def require_samples(is_right: bool, announced: int, got: int, where: str) -> None:
    """Refuse a channel that is shorter or longer than its file says."""
    if not is_right:
        raise RecordingFormatError(
            f"{where}: expected {announced} samples as its header says; got {got}: it is cut off"
        )


def head_of(samples: SampleArray) -> SampleArray:
    """Return the beginning of samples; where an array has few rows or columns, which may be channels, that of each."""
    return samples[part_of_head(samples.shape)]


def part_of_head(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the part of samples of a shape that :func:`head_of` returns."""
    if len(shape) < 2:
        return (slice(HEAD),)
    most = (MOST_CHANNELS_IN_ARRAY, HEAD) if shape[0] < shape[1] else (HEAD, MOST_CHANNELS_IN_ARRAY)
    return slice(most[0]), slice(most[1])


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One channel as the file states it. ``None`` means that the file does not say."""

    name: str
    stored: SampleArray | Stored  # shape (n_samples,), or two-dimensional where the file holds an array of windows
    unit: str | None = None  # as spelled in the file
    time: ChannelTime = field(default_factory=ChannelTime)
    gaps: str = ""  # why some of the samples are NaN, where the file says it
    measures: str | None = None  # unit of SI of what the file says that it is, where it states no unit

    def __post_init__(self) -> None:
        if not isinstance(self.stored, Stored):
            object.__setattr__(self, "stored", read_only_samples(self.stored))
        stated, size = sum(run.n_samples for run in self.time.runs), math.prod(self.shape)
        if self.time.runs and stated != size:
            raise ValueError(f"{self.name}: expected runs of {size} samples; got {stated}")

    @property
    def samples(self) -> SampleArray:
        """All samples, which are read now where they are still in the file."""
        if isinstance(self.stored, Stored):
            object.__setattr__(self, "stored", self.stored.read(self.name))
        return cast(SampleArray, self.stored)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the samples."""
        return tuple(self.stored.shape)

    @property
    def head(self) -> SampleArray:
        """The first samples, see :func:`head_of`."""
        return self.stored.head if isinstance(self.stored, Stored) else head_of(self.stored)

    @property
    def varies(self) -> bool:
        """Whether it is not one value throughout; all of it is read where its beginning is one."""
        first = self.head.flat[0]
        return any(bool(np.any(piece != first)) for piece in chain((self.head,), self.pieces()))

    def pieces(self) -> Iterator[SampleArray]:
        """Yield the samples from the first to the last, shape (n,) each; those in the file are not kept."""
        if isinstance(self.stored, Stored):
            yield from (piece for _, piece in self.stored.pieces((self.stored.number,)))
        else:
            flat = self.stored.reshape(-1)
            yield from (flat[start : start + PIECE] for start in range(0, flat.size, PIECE))


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """A frequency response as the file states it, as analysers export it."""

    name: str
    frequency: FloatArray  # [Hz], shape (n_lines,)
    response: ComplexArray  # shape (n_lines,), in the units of the file
    response_unit: str | None = None  # of the response alone, as spelled in the file
    reference_unit: str | None = None  # of what it is divided by
    measures: str | None = None  # unit of SI of what the file says that it is, where it states no unit


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """The channels of one file, in its order."""

    file_name: str
    channels: tuple[Channel, ...]
    responses: tuple[FrequencyResponse, ...] = ()
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # columns of texts, such as dates and times
    numbers: Mapping[str, float] = field(default_factory=dict)  # single numbers, such as the rate or a gain
    left_out: tuple[str, ...] = ()  # what is in the file and no channel, and why: "H (complex)"

    def __post_init__(self) -> None:
        object.__setattr__(self, "texts", MappingProxyType(dict(self.texts)))
        object.__setattr__(self, "numbers", MappingProxyType(dict(self.numbers)))
        kept = (*self.left_out[:MOST_LEFT_OUT], *(["…"] if len(self.left_out) > MOST_LEFT_OUT else []))
        plain = ("".join(letter if letter.isprintable() else "?" for letter in text) for text in kept)
        object.__setattr__(self, "left_out", tuple(plain))
        if not self.channels and not self.responses:
            got = f"only what is not read: {', '.join(self.left_out)}" if self.left_out else "none"
            raise RecordingFormatError(f"{self.file_name}: expected at least one channel of numbers; got {got}")

    def text(self, name: str) -> tuple[str, ...]:
        """Return the column of texts of a name; ``RecordingFormatError`` if there is no such column of texts."""
        if name in self.texts:
            return self.texts[name]
        if name in self.names:
            raise RecordingFormatError(f"{self.file_name}: expected {name!r} to hold texts; it holds numbers")
        there = ", ".join(repr(text[:60]) for text in list(self.texts)[:20]) or "no columns of texts"
        raise RecordingFormatError(f"{self.file_name}: expected a column of texts {name!r}; the file has {there}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels, in the order of the file."""
        return tuple(channel.name for channel in self.channels)

    def pieces(self) -> Iterator[tuple[int, SampleArray]]:
        """Go once through the file, and yield the number of a channel, counted from 0, and a piece of its samples."""
        in_file = {c.stored.number: i for i, c in enumerate(self.channels) if isinstance(c.stored, Stored)}
        for i, channel in enumerate(self.channels):
            if not isinstance(channel.stored, Stored):
                yield from ((i, piece) for piece in channel.pieces())
            elif channel.stored.number == next(iter(in_file)):
                yield from ((in_file[number], piece) for number, piece in channel.stored.pieces(in_file))

    def started_at(self, channel: Channel) -> datetime | None:
        """Return when the first sample of a channel was taken, where the file says it."""
        time = channel.time
        if time.runs or time.zero is None:
            return time.started_at
        clock = channel if time.clock is None else self.channel(time.clock)
        factor = factor_to("s", clock.unit or "")
        seconds = None if factor is None or not clock.head.size else factor * float(clock.head.reshape(-1)[0])
        if seconds is None or not math.isfinite(seconds):
            return None
        return time.zero + timedelta(seconds=time.offset + seconds)

    def read(self) -> tuple[Channel, ...]:
        """Return the channels with all samples, for whom the file is out of reach; it is gone through once."""
        gathered: list[list[SampleArray]] = [[] for _ in self.channels]
        for number, piece in self.pieces():
            gathered[number].append(piece.copy())
        return tuple(
            replace(channel, stored=cast(SampleArray, np.concatenate(pieces)).reshape(channel.shape))
            if pieces
            else channel
            for channel, pieces in zip(self.channels, gathered, strict=True)
        )

    def channel(self, name: str) -> Channel:
        """Return the channel of a name; ``RecordingFormatError`` if there is none, listing those that are there."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        if name in self.texts:
            first = next(iter(self.texts[name]), "")
            raise RecordingFormatError(
                f"{self.file_name}: expected numbers in {name!r}; it holds texts such as {first[:40]!r}"
            )
        there = ", ".join(repr(n[:60]) for n in self.names[:20]) + (", …" if len(self.names) > 20 else "")
        raise RecordingFormatError(f"{self.file_name}: expected a channel {name!r}; the file has {there}")


def require_distinct(names: Sequence[str], where: str, columns: str = "columns") -> None:
    """Refuse two channels of one name, which a channel map could not tell apart."""
    if twice := next((name for name, n_times in Counter(names).items() if n_times > 1), None):
        raise RecordingFormatError(f"{where}: expected {columns} of different names; got {twice[:60]!r} twice")


def single_numbers(found: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the finite ones of the single numbers of a file, by name; of very many, the first."""
    finite = ((name, float(value)) for name, value in found if math.isfinite(value))
    return dict(islice(finite, MOST_NUMBERS))


def native_samples(values: npt.NDArray[np.generic]) -> SampleArray:
    """Return real numbers in the byte order of this machine: float32 stays, all else becomes float64.

    Numbers that are so already are not copied: they must be the reader's own.
    """
    samples: SampleArray
    if values.dtype.kind == "f" and values.dtype.itemsize == 4:
        samples = np.ascontiguousarray(values, np.float32)
    else:
        samples = np.ascontiguousarray(values, np.float64)
    samples.setflags(write=False)
    return samples
