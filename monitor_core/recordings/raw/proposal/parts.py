"""What is in a raw file that may be given a meaning, and what it seems to be."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.recordings.elements.units import Quantity, canonical_unit
from monitor_core.recordings.raw.channel_kind import (
    is_of_other_quantity,
    is_planned,
    kind_of,
    unit_in_name,
)
from monitor_core.recordings.raw.channels import MOST_CHANNELS_IN_ARRAY, Channel, Channels


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A channel, or a row or column of an array, that may be given a meaning."""

    channel: Channel
    shape: tuple[int, ...]
    head: SampleArray  # its first samples
    kind: Quantity | None
    entry: str | None = None  # "row" or "column", where it is one of an array
    number: int = 0  # counted from 1

    @property
    def size(self) -> int:
        """How many samples it has."""
        return math.prod(self.shape)

    @property
    def varies(self) -> bool:
        """Whether it is not one value throughout."""
        return self.channel.varies if self.entry is None else bool(np.any(self.head != self.head.flat[0]))

    @property
    def unit(self) -> str | None:
        """The unit in our spelling, from the file or from the name; None if neither says a known one."""
        return canonical_unit(self.channel.unit) or unit_in_name(self.channel.name)


#: How the names of columns of lines begin, in small letters.
REAL, IMAGINARY, PHASE, SPECTRUM = ("re",), ("im",), ("phase", "ang", "arg"), ("psd", "asd", "spectr", "power")
MAGNITUDE = ("mag", "amp", "abs", "gain", "level", "betrag")


class Made(StrEnum):
    """What a raw file seems to hold, by the ending of the file that an import makes of it."""

    SESSION = ".session.h5"
    FRF_SET = ".frf.h5"
    MOTION = ".motion.csv"


def made_of(channels: Channels) -> Made:
    """Return what channels seem to be: lines of a frequency response, a motion without acceleration, or a session."""
    return made_of_parts(channels, parts_of(channels))


def holds_spectra_alone(channels: Channels) -> bool:
    """Tell whether lines of a frequency are those of power spectra, as Klipper makes them, and of no response."""
    parts = parts_of(channels)
    names = [part.channel.name.lower() for part in parts if part.kind is not Quantity.FREQUENCY]
    is_of_lines = len(names) < len(parts) and not channels.responses
    return (
        is_of_lines
        and any(name.startswith(SPECTRUM) for name in names)
        and not any(name.startswith((*REAL, *IMAGINARY, *MAGNITUDE, *PHASE)) for name in names)
    )


def made_of_parts(channels: Channels, parts: Sequence[Part]) -> Made:
    """Return what parts seem to be, as :func:`made_of`, where they were found before."""
    kinds = {part.kind for part in parts}
    if channels.responses or Quantity.FREQUENCY in kinds:
        return Made.FRF_SET
    return Made.MOTION if _is_motion(parts) else Made.SESSION


def _is_motion(parts: Sequence[Part]) -> bool:
    """Tell whether a force moves something: a motor's own signals are those of a drive with a screw."""
    kinds = {part.kind for part in parts if not is_of_other_quantity(part.channel.name, part.channel.unit)}
    of_drive = {Quantity.ACCELERATION, Quantity.TORQUE, Quantity.CURRENT, Quantity.ANGLE, None}
    return {Quantity.FORCE, Quantity.POSITION} <= kinds and kinds.isdisjoint(of_drive)


def parts_of(channels: Channels) -> list[Part]:
    """Return what may be given a meaning: channels, and the rows or columns of a single array of few of them."""
    parts = []
    arrays = [channel for channel in channels.channels if len(channel.shape) == 2]
    for channel in channels.channels:
        shape, head = channel.shape, channel.head
        if len(shape) == 2 and len(arrays) == 1 and 1 < min(shape) <= MOST_CHANNELS_IN_ARRAY:
            in_rows = shape[0] < shape[1]
            for number, values in enumerate(head if in_rows else head.T, start=1):
                kind = kind_of(str(number), None, values) or kind_of(channel.name, channel.unit, values)
                parts.append(Part(channel, (max(shape),), values, kind, "row" if in_rows else "column", number))
        else:
            parts.append(Part(channel, shape, head, kind_of(channel.name, channel.unit, head)))
    return parts


def first_like(parts: Sequence[Part], kinds: Sequence[Quantity], taken: Sequence[Part | None] = ()) -> Part | None:
    """Return the first channel that looks so, one that was measured before one that was planned."""
    fitting = [part for kind in kinds for part in parts if part.kind is kind and part not in taken]
    return min(fitting, key=lambda part: is_planned(part.channel.name), default=None)
