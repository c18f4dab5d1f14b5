"""Record of a raw file before a channel map gives it a meaning: named channels, named frequency responses."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import islice
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray, read_only_samples
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import FACTOR_TO_SI, Quantity, canonical_unit
from monitor_core.recordings.raw.channel_time import ChannelTime

#: So many names of what is not read are shown.
MOST_LEFT_OUT = 12
#: So many single numbers of a file are kept.
MOST_NUMBERS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One channel as the file states it. ``None`` means that the file does not say."""

    name: str
    samples: SampleArray  # shape (n_samples,), or two-dimensional where the file holds an array of windows
    unit: str | None = None  # as spelled in the file
    time: ChannelTime = field(default_factory=ChannelTime)
    gaps: str = ""  # why some of the samples are NaN, where the file says it

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", read_only_samples(self.samples))
        stated = sum(run.n_samples for run in self.time.runs)
        if self.time.runs and stated != self.samples.size:
            raise ValueError(f"{self.name}: expected runs of {self.samples.size} samples; got {stated}")


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """A frequency response as the file states it, as analysers export it."""

    name: str
    frequency: FloatArray  # [Hz], shape (n_lines,)
    response: ComplexArray  # shape (n_lines,), in the units of the file
    response_unit: str | None = None  # of the response alone, as spelled in the file
    reference_unit: str | None = None  # of what it is divided by


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

    def __reduce__(self) -> tuple[type["Channels"], tuple[object, ...]]:
        """Say how it is made anew in another process: a read-only view of a dict cannot be sent as it is."""
        return Channels, (
            self.file_name, self.channels, self.responses, dict(self.texts), dict(self.numbers), self.left_out
        )  # fmt: skip

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

    def started_at(self, channel: Channel) -> datetime | None:
        """Return when the first sample of a channel was taken, where the file says it."""
        time = channel.time
        if time.runs or time.zero is None:
            return time.started_at
        clock = channel if time.clock is None else self.channel(time.clock)
        factor = FACTOR_TO_SI[Quantity.TIME].get(canonical_unit(clock.unit) or "")
        seconds = None if factor is None or not clock.samples.size else factor * float(clock.samples.reshape(-1)[0])
        if seconds is None or not math.isfinite(seconds):
            return None
        return time.zero + timedelta(seconds=time.offset + seconds)

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
