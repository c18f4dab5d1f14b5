"""Read MDF 4 (``*.mf4``, ``*.mdf``) through asammdf (extra ``mdf``): channels and their clocks.

Each channel group has sampling times of its own, in seconds from the start of the measurement: they are a channel like
the others, and the clock of those of its group. A channel that has no name to itself carries the number of its group
in front: ``2/time``.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.bounds import MAX_CHANNELS, require_plausible_channels
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.raw.channel_time import ChannelTime
from monitor_core.recordings.raw.channels import (
    HEAD,
    Channel,
    Channels,
    Stored,
    native_samples,
    require_samples,
    stored_samples,
)

if TYPE_CHECKING:
    from asammdf import MDF
    from asammdf.blocks.v4_blocks import Channel as MdfChannel, ChannelConversion

_OF_NUMBERS = range(6)  # data types
_MASTERS = (2, 3)  # channel types of sampling times: stored, or counted by the records
_TIME = 1  # what a master counts; others count angles, distances or records
_WITH_SAMPLES = (0, 2, 3, 6)  # fixed length, masters, virtual
_LOCAL_TIME = 1  # flag of the header: its time has no zone
_FORMULA = 3  # conversion by a text with a formula
_VALUE_TO_TEXT, _RANGE_TO_TEXT = 7, 8
_TO_TEXTS = (_VALUE_TO_TEXT, _RANGE_TO_TEXT)
_OTHER_TYPES = {6: "texts", 7: "texts", 8: "texts", 9: "texts", 10: "bytes", 11: "bytes", 12: "bytes", 13: "dates",
                14: "dates and times", 15: "complex", 16: "complex", 17: "texts"}  # fmt: skip
_NUMERIC = (0, 1, 2, 4, 5, 6)  # conversions of numbers into numbers: linear, rational, by tables
_IN_RECORDS = (0, 2)  # channel types whose samples stand in the records
_MAY_BE_INVALID = 3  # flags of a channel of which samples are marked, or all
_FRAGMENT = 2**22  # bytes that are read at a time


@dataclass(frozen=True, slots=True)
class _Place:
    group: int
    index: int
    name: str
    is_clock: bool


def read_channels(path: Path) -> Channels:
    """Read the numeric channels of an MDF file of version 4, converted as it says, with their units and clocks.

    Sampling times of all groups count from the start of the measurement. Channels of texts, bytes and dates, those
    without samples, and samples that the file marks as invalid throughout are named as not read; single invalid
    samples, and those that stand for a text such as "not available", become NaN.
    ``RecordingFormatError`` if the file is damaged, cut off, unfinished or of version 3; ``MissingReaderError`` if
    asammdf is not installed.
    """
    try:
        import asammdf  # noqa: F401, PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(f"{path.name}: reading MDF needs asammdf; pip install asammdf") from error

    with refusing(path.name, "an MDF file of version 4"):
        _require_version_4(path)
    with _opened(path) as file:
        channels, left_out = _channels(file, path)
        return Channels(path.name, channels, left_out=left_out)


@contextmanager
def _opened(path: Path) -> Iterator["MDF"]:
    from asammdf import MDF  # noqa: PLC0415

    # opened here, because asammdf would map the file into memory, where what was read of it stays
    with (
        refusing(path.name, "an MDF file of version 4"),
        path.open("rb") as stream,
        MDF(stream, process_bus_logging=False) as file,
    ):
        file.configure(read_fragment_size=_FRAGMENT)
        yield file


def _require_version_4(path: Path) -> None:
    with require_file(path).open("rb") as stream:
        head = stream.read(64)
    if head.startswith(b"UnFinMF"):
        raise RecordingFormatError(
            f"{path.name}: expected a finished MDF file; its writer never closed it: open and save it with its program"
        )
    if not head.startswith(b"MDF     ") or len(head) < 64:
        raise RecordingFormatError(f"{path.name}: expected an MDF file; it begins with {head[:8]!r}")
    if not head.startswith(b"4.", 8):
        version = head[8:16].decode("latin-1").strip(" \0")
        raise RecordingFormatError(f"{path.name}: expected MDF of version 4; got {version!r}: convert it to version 4")


def _channels(file: "MDF", path: Path) -> tuple[tuple[Channel, ...], tuple[str, ...]]:
    """Return the channels of numbers, and what else the file holds."""
    where = path.name
    left_out = [
        f"{channel.name} ({_OTHER_TYPES.get(channel.data_type, 'no numbers')})"
        for group in file.groups
        for channel in group.channels
        if channel.data_type not in _OF_NUMBERS
    ]
    places = [
        _Place(number, index, channel.name, channel.channel_type in _MASTERS and channel.sync_type == _TIME)
        for number, group in enumerate(file.groups)
        for index, channel in enumerate(group.channels)
        if channel.data_type in _OF_NUMBERS and channel.channel_type in _WITH_SAMPLES
    ]
    counts = Counter(place.name for place in places)
    names = {
        (place.group, place.index): place.name if counts[place.name] == 1 else f"{place.group + 1}/{place.name}"
        for place in places
    }
    for place in places:
        _require_no_formula(file.groups[place.group].channels[place.index].conversion, f"{where}, {place.name}")
    lengths = {number: int(group.channel_group.cycles_nr) for number, group in enumerate(file.groups)}
    require_plausible_channels([(place.name, lengths[place.group]) for place in places], where)
    clocks = {place.group: names[place.group, place.index] for place in places if place.is_clock}
    zero = _zero(file)
    channels = []
    for place in places:
        channel = file.groups[place.group].channels[place.index]
        samples, why = _samples(file, path, place, lengths[place.group])
        if samples is None:
            left_out.append(f"{names[place.group, place.index]} ({why})")
            continue
        channels.append(
            Channel(
                name=names[place.group, place.index],
                stored=samples,
                unit=(channel.conversion and channel.conversion.unit)
                or channel.unit
                or ("s" if place.is_clock else None),
                time=ChannelTime(
                    zero if place.group in clocks else None, clock=None if place.is_clock else clocks.get(place.group)
                ),
                gaps=why,
            )
        )
    return tuple(channels), tuple(left_out)


def _why_no_channel(samples: np.ndarray) -> str:
    if samples.size == 0:
        return "no samples"
    return f"{samples.ndim} dimensions" if samples.dtype.kind in "fiu" else "texts"


def _numbers_beside_texts(conversion: "ChannelConversion", raw: np.ndarray) -> tuple[np.ndarray, str]:
    """Return the numbers of a channel in which some stand for texts, NaN for these, and how many they are.

    What is in no entry of the table is converted by its default, where there is one, and else stands as it is. Where
    none is a number, the texts are returned.
    """
    blocks, is_text, found = conversion.referenced_blocks or {}, np.zeros(raw.shape, np.bool_), list[str]()
    default = blocks.get("default_addr")
    numbers = np.array(_converted(default, raw), np.float64)
    for i in reversed(range(int(conversion.ref_param_nr) - 1)):  # the first entry that fits counts
        if conversion.conversion_type == _VALUE_TO_TEXT:
            fits = raw == conversion[f"val_{i}"]
        else:
            lower, upper = conversion[f"lower_{i}"], conversion[f"upper_{i}"]
            fits = (raw >= lower) & ((raw <= upper) if raw.dtype.kind in "iu" else (raw < upper))
        if not fits.any():
            continue
        block = blocks.get(f"text_{i}")
        is_text[fits] = isinstance(block, bytes)
        if isinstance(block, bytes):
            found.append(block.decode("utf-8", "replace").strip(" \0"))
        else:
            numbers[fits] = _converted(block, raw[fits])
    if is_text.all() or (isinstance(default, bytes) and default.strip(b" \0")):
        return np.array([""]), ""
    numbers[is_text] = np.nan
    texts = ", ".join(repr(text[:40]) for text in found[:4])
    return numbers, f"{np.count_nonzero(is_text)} stand for {texts}" if found else ""


def _converted(block: object, raw: np.ndarray) -> np.ndarray:
    """Return what a conversion in the table of another one makes of numbers; texts and none leave them."""
    if block is None or isinstance(block, bytes):
        return raw
    return np.asarray(block.convert(raw))  # type: ignore[attr-defined]  # a conversion of asammdf


def _samples(file: "MDF", path: Path, place: _Place, length: int) -> tuple[SampleArray | Stored | None, str]:
    """Return the samples of a channel, and why some are NaN; those of a plain one stay in the file.

    None where there are no numbers, and why.
    """
    channel = file.groups[place.group].channels[place.index]
    if length > HEAD and _is_plain(channel) and not file.groups[place.group].channel_dependencies[place.index]:
        number = place.group * MAX_CHANNELS + place.index
        own = _samples_of(file, place.group, place.index)
        return stored_samples((length,), own, number, partial(_pieces, path)), ""
    conversion = channel.conversion
    stands_for_texts = conversion is not None and conversion.conversion_type in _TO_TEXTS
    # not ignored here: asammdf would leave single ones out, and a channel would be shorter than its clock
    signal = _quietly(
        lambda: file.get(group=place.group, index=place.index, ignore_invalidation_bits=True, raw=stands_for_texts)
    )
    samples, why = np.asarray(signal.samples), ""
    if stands_for_texts:
        samples, why = _numbers_beside_texts(conversion, samples)
    if length == 0 or samples.dtype.kind not in "fiu" or samples.ndim not in (1, 2):
        return None, _why_no_channel(samples)
    require_samples(len(samples) == length, length, len(samples), f"{path.name}, {place.name}")
    invalid = signal.invalidation_bits
    if invalid is not None and np.any(invalid):
        if np.all(invalid):
            return None, "marked as invalid throughout"
        why = " and ".join(filter(None, [why, f"{np.count_nonzero(invalid)} are marked as invalid"]))
        samples = np.where(np.asarray(invalid, bool).reshape(-1, *[1] * (samples.ndim - 1)), np.nan, samples)
    return native_samples(samples), why


def _is_plain(channel: "MdfChannel") -> bool:
    """Tell whether samples are numbers in the records, whatever they are, and none of them is marked as invalid."""
    conversion = channel.conversion
    is_numeric = conversion is None or conversion.conversion_type in _NUMERIC
    return is_numeric and channel.channel_type in _IN_RECORDS and not channel.flags & _MAY_BE_INVALID


def _samples_of(file: "MDF", group: int, index: int) -> Iterator[SampleArray]:
    fragments = file.iter_get(group=group, index=index, samples_only=True)
    while (fragment := _quietly(lambda: next(fragments, None))) is not None:
        samples = fragment[0]
        yield native_samples(samples.view(samples.dtype.str))  # without what asammdf hangs on the type


def _quietly(read: Callable[[], Any]) -> Any:  # noqa: ANN401  # as the library answers
    """Read without what asammdf prints where reading takes long."""
    with redirect_stdout(None):
        return read()


def _pieces(path: Path, wanted: Collection[int]) -> Iterator[tuple[int, SampleArray]]:
    with _opened(path) as file:
        for number in wanted:
            for piece in _samples_of(file, *divmod(number, MAX_CHANNELS)):
                yield number, piece


def _require_no_formula(conversion: "ChannelConversion | None", where: str) -> None:
    """Refuse a formula, also in the conversions that a table refers to: the library would run it."""
    if conversion is None:
        return
    if conversion.conversion_type == _FORMULA:
        raise RecordingFormatError(
            f"{where}: expected numbers, linear or tabulated; got a channel with a formula as text, which is not "
            "evaluated: export it with its values"
        )
    for referenced in (conversion.referenced_blocks or {}).values():
        if not isinstance(referenced, bytes):
            _require_no_formula(referenced, where)


def _zero(file: "MDF") -> datetime | None:
    if file.header.time_flags & _LOCAL_TIME or not file.header.abs_time:
        return None
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=file.header.abs_time // 1000)
