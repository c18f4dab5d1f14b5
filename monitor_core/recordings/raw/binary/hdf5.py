"""Read HDF5 of other programs: every dataset of real numbers is a channel, named by its path, ``scope/torque``.

Nobody has agreed how HDF5 states what a recording is. What is read are the attributes that programs mostly use, of a
dataset itself or of a group above it: the unit (``units``, ``unit_string``, …), a rate or a step (``fs``,
``sampling_rate``, ``dt_ms``, …), a start with its zone; dimension scales of times are clocks; ``scale_factor``,
``add_offset`` and ``_FillValue`` of netCDF are applied. Every other number is listed, and means nothing by itself.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import (
    MAX_CHANNELS,
    require_plausible_channels,
    require_plausible_expansion,
)
from monitor_core.recordings.elements.fields import parse_instant
from monitor_core.recordings.elements.files import refusing
from monitor_core.recordings.elements.hdf5 import open_hdf5, require_readable
from monitor_core.recordings.elements.units import Quantity, factor_to
from monitor_core.recordings.raw.channel_kind import (
    kind_of_name,
    kind_of_unit,
    rate_of_number,
    unit_in_name,
)
from monitor_core.recordings.raw.channel_time import ChannelTime, even_time
from monitor_core.recordings.raw.channels import (
    HEAD,
    PIECE,
    Channel,
    Channels,
    Stored,
    native_samples,
    part_of_head,
    single_numbers,
    stored_samples,
)

if TYPE_CHECKING:
    import h5py

_DEEPEST = 8  # groups inside groups
_MOST_ATTRIBUTES = 200  # of a group or dataset
_LONGEST_TEXT = 200
#: How attributes are named, in small letters without blanks, hyphens and underscores.
_UNITS = ("unit", "units", "unitstring", "yunit", "yunits", "engineeringunit", "engineeringunits")
_STARTS = ("starttime", "startedat", "startdatetime", "t0", "wfstarttime", "measurementstart", "recordingstart")
#: Larger numbers are no seconds behind the start of a recording, but since some day that is not stated [s].
_LATEST = 1e7
_SAME_RATE = 1e-6
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
Stated = Mapping[str, object]


@dataclass(frozen=True, slots=True)
class _Signal:
    """A dataset of numbers, or a field of one of records."""

    name: str
    path: str
    member: str | None  # of the records
    shape: tuple[int, ...]
    stated: Stated  # attributes of it and of the groups above
    clock: str | None = None  # path of the scale of its first dimension
    own: Stated = field(default_factory=dict)  # attributes of it alone


@dataclass(slots=True)
class _Found:
    """What a file holds."""

    signals: list[_Signal] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    seen: set[int] = field(default_factory=set)  # places of groups, which may hold each other

    def leave_out(self, name: str, why: str) -> None:
        """Note what is no channel, and why."""
        self.left_out.append(f"{name} ({why})")


def read_channels(path: Path) -> Channels:
    """Read the datasets of real numbers of an HDF5 file, and what their attributes state.

    Datasets of more than two dimensions, of texts or complex numbers, and those whose numbers are elsewhere are named
    as not read. ``RecordingFormatError`` if the file is damaged, or attributes contradict each other.
    """
    found = _Found()
    with open_hdf5(path) as file, refusing(path.name, "a readable HDF5 file"):
        _look_into(file, "", {}, 0, found)
        signals = found.signals
        require_plausible_channels([(s.name, math.prod(s.shape)) for s in signals], path.name)
        require_plausible_expansion(sum(8 * math.prod(s.shape) for s in signals), path.stat().st_size, path.name)
        channels = tuple(_channel(file, signals, number, path) for number in range(len(signals)))
    return Channels(path.name, channels, numbers=single_numbers(found.numbers.items()), left_out=tuple(found.left_out))


def _look_into(group: "h5py.Group", prefix: str, above: Stated, depth: int, found: _Found) -> None:
    import h5py  # noqa: PLC0415

    place = h5py.h5o.get_info(group.id).addr
    if place in found.seen:
        return
    found.seen.add(place)
    stated = {**above, **_attributes(group, prefix.rstrip("/"), found)}
    if len(group) > MAX_CHANNELS:
        raise RecordingFormatError(f"{prefix or '/'}: expected at most {MAX_CHANNELS} datasets; got {len(group)}")
    for name in group:
        # a link could name any file of the machine
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            found.leave_out(f"{prefix}{name}", "a link")
            continue
        inside = group[name]
        if isinstance(inside, h5py.Group) and depth < _DEEPEST:
            _look_into(inside, f"{prefix}{name}/", stated, depth + 1, found)
        elif isinstance(inside, h5py.Dataset):
            _take(inside, f"{prefix}{name}", stated, found)


def _attributes(place: "h5py.Group | h5py.Dataset", name: str, found: _Found) -> dict[str, object]:
    """Return the single numbers and texts among the attributes, by their plain names; rates keep theirs."""
    stated = dict[str, object]()
    for key in list(place.attrs)[:_MOST_ATTRIBUTES]:
        with suppress(OSError, TypeError, ValueError, KeyError, UnicodeError):  # types that h5py does not know
            if math.prod(place.attrs.get_id(key).shape or ()) != 1:
                continue
            value: Any = np.asarray(place.attrs[key]).reshape(-1)[0]
            value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
            if isinstance(value, str):
                stated[_plain(key)] = value.strip()[:_LONGEST_TEXT]
            elif np.asarray(value).dtype.kind in "fiu":
                stated[key if rate_of_number(key, float(value)) is not None else _plain(key)] = float(value)
                found.numbers[f"{name}.{key}".lstrip(".")] = float(value)
    return stated


def _plain(name: str) -> str:
    return re.sub(r"[-_\s]", "", name.lower())


def _take(dataset: "h5py.Dataset", name: str, above: Stated, found: _Found) -> None:
    """Take a dataset as channels, as a number, or name why it is neither."""
    own = _attributes(dataset, name, found)
    try:
        dtype, shape = dataset.dtype, dataset.shape or ()
        is_there = dataset.size and not str(own.get("name", "")).startswith(_NO_VARIABLE)
        fields = _fields_of_numbers(dtype)
        if is_there and fields:
            require_readable(dataset, name)
    except RecordingFormatError as error:
        return found.leave_out(name, str(error).partition("; ")[2])
    except (TypeError, ValueError):  # types that NumPy does not have
        return found.leave_out(name, "a type of its own")
    if not is_there or (not fields and dtype.kind in "OSU" and dataset.size == 1):
        return None  # nothing, or a text
    if not fields or len(shape) > 2:
        kind = {"c": "complex", "V": "records"}.get(dtype.kind, "texts")
        return found.leave_out(name, f"{len(shape)} dimensions" if fields else kind)
    if dataset.size == 1 and dtype.names is None:
        found.numbers[name] = float(np.asarray(dataset[()]).reshape(-1)[0])
        return None
    flat = (dataset.size,) if 1 in shape else tuple(shape)
    for key in fields:
        label = name if key is None else f"{name}.{key}"
        found.signals.append(_Signal(label, dataset.name, key, flat, {**above, **own}, _clock_of(dataset), own))
    return None


def _fields_of_numbers(dtype: "np.dtype[Any]") -> list[str | None]:
    """Return the fields of records that are single real numbers, or one without a name where there are no records."""
    if dtype.names is None:
        return [None] if dtype.kind in "fiub" else []
    return [name for name in dtype.names if dtype[name].kind in "fiub" and dtype[name].shape == ()]


def _clock_of(dataset: "h5py.Dataset") -> str | None:
    """Return the path of the scale of the first dimension, if there is one."""
    with suppress(RuntimeError, ValueError, KeyError, OSError, AttributeError):
        if dataset.ndim == 1 and not dataset.is_scale and len(dataset.dims[0]):
            return str(dataset.dims[0][0].name)
    return None


def _channel(file: "h5py.File", signals: list[_Signal], number: int, path: Path) -> Channel:
    signal = signals[number]
    where = f"{path.name}, {signal.name}"
    unit, zero = _unit_of(signal)
    clock = next((s for s in signals if s.path == signal.clock and s.member is None and _is_of_times(s)), None)
    if clock is not None and clock.shape == signal.shape:
        time = ChannelTime(_zero_of_times(file, clock, where), clock=clock.name)
    elif zero is not None or _is_of_times(signal):
        time = ChannelTime(_zero_of_times(file, signal, where))
    else:
        time = _time_of(signal, where)
    return Channel(signal.name, _samples(file, signals, number, path), unit, time)


def _unit_of(signal: _Signal) -> tuple[str | None, datetime | None]:
    """Return the unit, and of times of netCDF ("seconds since 2025-03-01") the zero."""
    stated = next((text for name in _UNITS if isinstance(text := signal.own.get(name), str) and text), None)
    unit, _, since = (stated or "").partition(" since ")
    if not since:
        return stated, None
    with suppress(ValueError):
        zero = datetime.fromisoformat(since.strip())
        return unit, zero if zero.tzinfo is not None else zero.replace(tzinfo=UTC)  # by the CF conventions
    return stated, None


def _is_of_times(signal: _Signal) -> bool:
    unit, _ = _unit_of(signal)
    return Quantity.TIME in (kind_of_unit(unit), kind_of_name(signal.name))


def _zero_of_times(file: "h5py.File", signal: _Signal, where: str) -> datetime | None:
    """Return what sampling times count from: the stated start, unless they count from some day by themselves."""
    unit, zero = _unit_of(signal)
    if zero is not None:
        return zero
    first = float(_scaled(_part(file[signal.path], signal, slice(1), slice(1)), signal).flat[0])
    in_seconds = factor_to("s", unit or unit_in_name(signal.name) or "d")  # days, the longest, where none is stated
    return _start_of(signal, where)[2] if abs(first * (in_seconds or math.inf)) < _LATEST else None


def _time_of(signal: _Signal, where: str) -> ChannelTime:
    """Return what attributes say of rate and start."""
    rates = {
        name: rate
        for name, value in signal.stated.items()
        if isinstance(value, float) and (rate := rate_of_number(name, value)) is not None
    }
    if rates and max(rates.values()) - min(rates.values()) > _SAME_RATE * min(rates.values()):
        got = " and ".join(f"{name} of {rate:.10g} Hz" for name, rate in rates.items())
        raise RecordingFormatError(f"{where}: expected attributes that state one sample rate; got {got}")
    if not rates:
        return ChannelTime()
    start, offset, zero = _start_of(signal, where)
    offset, start = (offset, start) if zero is None else (0.0, start or 0.0)
    start = 0.0 if offset and start is None else start
    return replace(even_time(math.prod(signal.shape), next(iter(rates.values())), start, zero), offset=offset)


def _start_of(signal: _Signal, where: str) -> tuple[float | None, float, datetime | None]:
    """Return what attributes say of the start: seconds behind that of the recording, those since some day, the zero."""
    start, offset, zero = None, 0.0, None
    for value in (signal.stated[name] for name in _STARTS if name in signal.stated):
        if isinstance(value, float):
            start, offset = (value, offset) if abs(value) < _LATEST else (start, value)
        elif isinstance(value, str):
            # without a zone the file says how far channels are apart, and not when they were
            with suppress(RecordingFormatError, ValueError):
                offset = datetime.fromisoformat(value).replace(tzinfo=UTC).timestamp()
                zero = parse_instant(value, where)
    return start, offset, zero


def _samples(file: "h5py.File", signals: list[_Signal], number: int, path: Path) -> SampleArray | Stored:
    """Return the samples; those of a long dataset stay in the file."""
    signal = signals[number]
    dataset = file[signal.path]
    pieces = partial(_pieces, path, signals)
    if len(signal.shape) == 1 or math.prod(signal.shape) <= HEAD:
        return stored_samples(signal.shape, _samples_of(dataset, signal), number, pieces)
    head = _scaled(_part(dataset, signal, *part_of_head(signal.shape)), signal)
    return Stored(signal.shape, head, number, pieces)


def _samples_of(dataset: "h5py.Dataset", signal: _Signal) -> Iterator[SampleArray]:
    """Yield the samples row by row, in whole chunks of the file, each of which would be unpacked for a part of it."""
    n_rows, n_columns = dataset.shape[0], math.prod(dataset.shape[1:])
    if n_columns > PIECE:
        for row in range(n_rows):
            for start in range(0, n_columns, PIECE):
                part = _part(dataset, signal, slice(row, row + 1), slice(start, start + PIECE))
                yield _scaled(part, signal).reshape(-1)
        return
    in_chunk = dataset.chunks[0] if dataset.chunks else 1
    step = in_chunk * max(1, PIECE // n_columns // in_chunk)
    for start in range(0, n_rows, step):
        yield _scaled(_part(dataset, signal, slice(start, start + step)), signal).reshape(-1)


def _part(dataset: "h5py.Dataset", signal: _Signal, *parts: slice) -> np.ndarray:
    read = dataset[parts[: dataset.ndim]]
    return np.asarray(read if signal.member is None else read[signal.member])


def _scaled(numbers: np.ndarray, signal: _Signal) -> SampleArray:
    """Return the numbers as netCDF means them: what stands for a missing one is NaN, the others are scaled."""
    of = {name: value for name in ("fillvalue", "missingvalue", "scalefactor", "addoffset")
          if isinstance(value := signal.own.get(name), float)}  # fmt: skip
    if not of:
        return native_samples(numbers)
    missing = np.isin(numbers, [of[name] for name in ("fillvalue", "missingvalue") if name in of])
    scaled = numbers * of.get("scalefactor", 1.0) + of.get("addoffset", 0.0)
    return native_samples(np.where(missing, np.nan, scaled))


def _pieces(path: Path, signals: list[_Signal], wanted: Collection[int]) -> Iterator[tuple[int, SampleArray]]:
    with open_hdf5(path) as file, refusing(path.name, "a readable HDF5 file"):
        for number in wanted:
            for piece in _samples_of(file[signals[number].path], signals[number]):
                yield number, piece
