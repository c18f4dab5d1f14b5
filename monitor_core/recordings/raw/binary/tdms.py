"""Read TDMS files of LabVIEW and DAQmx through npTDMS (extra ``tdms``): channels are named ``group/channel``.

A file is a chain of segments, each of which may state properties anew. npTDMS keeps the last of them for all samples;
here those of each segment hold for its own samples.
"""

import math
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.files import refusing, require_file, require_plausible_length
from monitor_core.recordings.elements.units import factor_to
from monitor_core.recordings.raw.channel_time import ChannelTime, Run
from monitor_core.recordings.raw.channels import PIECE, Channel, Channels, Stored, native_samples, stored_samples

if TYPE_CHECKING:
    from nptdms import TdmsChannel, TdmsFile
    from nptdms.reader import TdmsReader

#: Zero of TDMS time stamps. LabVIEW writes it where it knows no time, for instance with relative time.
_NO_TIME = np.datetime64("1904-01-01T00:00:00")
_LEAD_IN = 28
_INTERLEAVED, _BIG_ENDIAN = 1 << 5, 1 << 6
#: Of so many bytes all channels are in memory together, and of none fewer samples.
_AT_ONCE, _FEWEST = 2**24, 2**12
_VERSIONS = (4712, 4713)
#: What npTDMS can apply; anything else it would leave unscaled.
_SCALES = frozenset(("Linear", "Polynomial", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract",
                     "AdvancedAPI"))  # fmt: skip
_MOST_SCALES = 100
_NOT_READ = {"c": "complex", "M": "times"}
#: No value takes less than one bit (digital lines), and scaling adds none.
_VALUES_PER_BYTE = 8
#: Properties that say when samples were taken, and how they are converted.
_STARTS = ("wf_start_time", "wf_start_offset")
_SCALE = ("unit_string", "wf_xunit_string", "NI_Scal", "NI_Number_Of_Scales")
_OF_SAMPLES = (*_STARTS, "wf_increment", *_SCALE)


def read_channels(path: Path) -> Channels:
    """Read the numeric channels of a TDMS file of either byte order, with DAQmx scaling applied.

    The unit comes from ``unit_string``, the sample rate from ``wf_increment`` in ``wf_xunit_string``, the start from
    ``wf_start_time`` and ``wf_start_offset``; TDMS times are UTC by definition of the format. Samples of segments that
    state another start or step are runs of their own. Channels without samples, channels of text, times or complex
    numbers, and those over another axis than time are named as not read. ``RecordingFormatError`` if the file is
    damaged, cut off, or promises more samples than it can hold, or if a segment contradicts the one in front of it;
    ``MissingReaderError`` if npTDMS is not installed.
    """
    try:
        import nptdms  # noqa: F401, PLC0415
        from nptdms.log import log_manager  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(f"{path.name}: reading TDMS needs npTDMS; pip install npTDMS") from error

    log_manager.set_level("CRITICAL")  # what npTDMS only warns of is refused here
    n_bytes = require_file(path).stat().st_size
    _require_whole_segments(path, n_bytes)
    channels, left_out = list[Channel](), list[str]()
    with _opened(path) as file:
        parts = _parts(file)
        if file.file_status.channel_statuses is not None:
            raise RecordingFormatError(f"{path.name}: expected whole chunks of samples; the last one is cut off")
        for number, channel in enumerate(_all_channels(file)):
            name = f"{channel.group_name}/{channel.name}"
            for properties in (channel.properties, file[channel.group_name].properties, file.properties):
                _require_known_scales(properties, f"{path.name}, {name}")
            if len(channel) == 0 or channel.dtype.kind not in "fiub":
                kind = _NOT_READ.get(channel.dtype.kind, "texts") if len(channel) else "no samples"
                left_out.append(f"{name} ({kind})")
                continue
            require_plausible_length(len(channel), f"{path.name}, {name}")
            if len(channel) > n_bytes * _VALUES_PER_BYTE:
                raise RecordingFormatError(
                    f"{path.name}, {name}: expected {len(channel)} samples as its header says; "
                    f"got {n_bytes} bytes in all"
                )
            if _seconds_of_x(channel.properties) is None:
                left_out.append(f"{name} (over {channel.properties['wf_xunit_string']}, not over time)")
                continue
            own = (native_samples(chunk) for _, chunk in _chunks(file, (number,)))
            samples = stored_samples((len(channel),), own, number, partial(_pieces, path, file.told))
            stated = parts.get(channel.path) or [_Part(len(channel), dict(channel.properties))]
            channels.append(_channel(channel, name, path.name, stated, samples))
    return Channels(path.name, tuple(channels), left_out=tuple(left_out))


@contextmanager
def _opened(path: Path, told: Mapping[str, object] | None = None) -> Iterator["TdmsFile"]:
    """Open a file, which keeps as ``stated`` the properties of each segment, and not only the last of them.

    ``told``: what the segments of the same file told when it was opened before; they are not read again.
    """
    from nptdms import TdmsFile  # noqa: PLC0415

    class File(TdmsFile):  # type: ignore[misc]  # of no type
        def _read_file(self, reader: "TdmsReader", *how: bool) -> None:
            self.stated: list[dict[str, dict[str, object]]] = []
            update = reader._update_object_properties

            def keep(of_segment: Mapping[str, Iterable[tuple[str, object]]] | None) -> None:
                update(of_segment)
                self.stated.append({of: dict(pairs) for of, pairs in (of_segment or {}).items()})

            reader._update_object_properties = keep
            if told is not None:
                vars(reader).update(told)
                reader.read_metadata = lambda **_: None
            super()._read_file(reader, *how)
            self.told = {name: vars(reader)[name] for name in ("_segments", "object_metadata", "tdms_version")}

    # opened here, because npTDMS would prefer a neighbouring *.tdms_index, which may be of another recording
    with (
        refusing(path.name, "a TDMS file"),
        path.open("rb") as stream,
        File(stream, read_metadata_only=True, keep_open=True) as file,
    ):
        yield file


def _all_channels(file: "TdmsFile") -> list["TdmsChannel"]:
    return [channel for group in file.groups() for channel in group.channels()]


def _chunks(file: "TdmsFile", wanted: Collection[int]) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the samples of channels as the file is written; each channel by itself where few are wanted of much."""
    channels = _all_channels(file)
    at_once = max(
        segment._get_chunk_size() * (segment.num_chunks if segment.toc_mask & _INTERLEAVED else 1)
        for segment in file._reader._segments
    )
    if 2 * len(wanted) < len(channels) or at_once > _AT_ONCE:
        for number in wanted:
            for chunk in channels[number].data_chunks():
                yield number, chunk[:]
                del chunk  # before the next is read: it may hold all samples of its channel
        return
    places = [(number, channels[number].group_name, channels[number].name) for number in wanted]
    for chunk in file.data_chunks():
        yield from ((number, chunk[group][name][:]) for number, group, name in places)


def _pieces(path: Path, told: Mapping[str, object], wanted: Collection[int]) -> Iterator[tuple[int, SampleArray]]:
    most = max(PIECE >> (len(wanted) - 1).bit_length(), _FEWEST)  # those of all channels are in memory together
    waiting, sizes = {number: list[np.ndarray]() for number in wanted}, dict.fromkeys(wanted, 0)
    with _opened(path, told) as file:
        for number, chunk in _chunks(file, wanted):
            for start in range(0, len(chunk), most):
                waiting[number].append(chunk[start : start + most].copy())
                sizes[number] += len(waiting[number][-1])
                if sizes[number] >= most:
                    joined = np.concatenate(waiting[number])
                    waiting[number], sizes[number] = [joined[most:]], joined.size - most
                    yield number, native_samples(joined[:most])
            del chunk
    yield from ((number, native_samples(np.concatenate(parts))) for number, parts in waiting.items() if sizes[number])


def _require_whole_segments(path: Path, n_bytes: int) -> None:
    """Follow the segments to the end of the file: npTDMS drops a last one that is cut off, with all its samples."""
    at = 0
    with path.open("rb") as stream:
        while at < n_bytes:
            stream.seek(at)
            lead_in = stream.read(_LEAD_IN)
            order = ">" if len(lead_in) == _LEAD_IN and lead_in[4] & _BIG_ENDIAN else "<"
            if len(lead_in) < _LEAD_IN or not lead_in.startswith(b"TDSm"):
                raise RecordingFormatError(f"{path.name}: expected a TDMS segment at byte {at}; got {lead_in[:4]!r}")
            version, length = struct.unpack(f"{order}iQ", lead_in[8:20])
            if version not in _VERSIONS:
                raise RecordingFormatError(f"{path.name}: expected TDMS version 4712 or 4713; got {version}")
            at += _LEAD_IN + length
    if at != n_bytes:
        raise RecordingFormatError(f"{path.name}: expected a complete TDMS file; its last segment is cut off")


def _require_known_scales(properties: Mapping[str, object], where: str) -> None:
    count = properties.get("NI_Number_Of_Scales", 0)
    if not isinstance(count, (int, np.integer)) or not 0 <= count <= _MOST_SCALES:
        raise RecordingFormatError(
            f"{where}: expected at most {_MOST_SCALES} scales; got NI_Number_Of_Scales {count!r}"
        )
    for key, scale in properties.items():
        if key.endswith("_Scale_Type") and scale not in _SCALES:
            raise RecordingFormatError(f"{where}: expected a known scale in {key}; got {scale!r}")


@dataclass(frozen=True, slots=True)
class _Part:
    """Samples of a channel in segments that state the same, and what they state."""

    n_samples: int
    properties: Mapping[str, object]


def _parts(file: "TdmsFile") -> dict[str, list[_Part]]:
    """Return the samples of each channel, by its path, as the segments part them that state other properties."""
    from nptdms.reader import _number_of_segment_values  # noqa: PLC0415

    parts, known = dict[str, list[_Part]](), dict[str, dict[str, object]]()
    first = dict[str, dict[str, object]]()  # what is stated once, behind the samples or in a later segment, is of all
    for segment, stated in zip(file._reader._segments, file.stated, strict=True):
        for of, properties in stated.items():
            before = known.get(of, {})
            told = {key: value for key, value in properties.items() if key.startswith(_OF_SAMPLES)}
            first[of], now = told | first.get(of, {}), before | told
            if {key: str(value) for key, value in now.items()} != {key: str(value) for key, value in before.items()}:
                known[of] = now
        for item in segment.ordered_objects:
            n_samples, properties = _number_of_segment_values(item, segment), known.get(item.path, {})
            if not n_samples:
                continue
            of_channel = parts.setdefault(item.path, [])
            if of_channel and of_channel[-1].properties is properties:
                n_samples += of_channel.pop().n_samples
            of_channel.append(_Part(n_samples, properties))
    return {
        of: [replace(part, properties={**first.get(of, {}), **part.properties}) for part in of_channel]
        for of, of_channel in parts.items()
    }


def _channel(
    channel: "TdmsChannel", name: str, file_name: str, parts: Sequence[_Part], samples: SampleArray | Stored
) -> Channel:
    zero = _instant(parts[0].properties.get("wf_start_time"))
    runs, at, end = list[Run](), 0, 0.0
    before: _Part | None = None
    for part in parts:
        where = f"{file_name}, {name}, from sample {at} on" if at else f"{file_name}, {name}"
        rate = _rate(part.properties, where)
        start = end if before is not None and _stated(before, _STARTS) == _stated(part, _STARTS) else _start(part, zero)
        if before is not None:
            _require_same_scale(before, part, where)
            late = math.nan if start is None else start - end
            if rate is not None and late < -0.5 / rate:
                raise RecordingFormatError(
                    f"{where}: expected a segment that begins after the one in front of it ends; its start lies "
                    f"{-late:.6g} s before that"
                )
        if before is not None and rate == runs[-1].sample_rate and (rate is None or abs(late) <= 0.5 / rate):
            runs[-1] = replace(runs[-1], n_samples=runs[-1].n_samples + part.n_samples)
        else:
            runs.append(Run(part.n_samples, start, rate))
        before, at = part, at + part.n_samples
        end = (runs[-1].start or 0.0) + runs[-1].n_samples / rate if rate is not None else math.nan
    return Channel(
        name=name,
        stored=samples,
        unit=channel.properties.get("unit_string") or None,
        time=ChannelTime(zero, runs=tuple(runs)),
    )


def _stated(part: _Part, keys: tuple[str, ...]) -> dict[str, str]:
    return {key: str(value) for key, value in part.properties.items() if key.startswith(keys)}


def _require_same_scale(before: _Part, part: _Part, where: str) -> None:
    """Refuse segments that state another unit or conversion: npTDMS would apply the last to all samples."""
    was, now = _stated(before, _SCALE), _stated(part, _SCALE)
    if changed := next((key for key in now if now[key] != was.get(key)), None):
        raise RecordingFormatError(
            f"{where}: expected one unit and one conversion; its {changed} is {now[changed][:40]!r} there, and was "
            f"{was.get(changed, 'not stated')[:40]!r}"
        )


def _seconds_of_x(properties: Mapping[str, object]) -> float | None:
    """Return what a step of x is in seconds; ``None`` where x is no time."""
    return factor_to("s", str(properties.get("wf_xunit_string") or "s"))


def _rate(properties: Mapping[str, object], where: str) -> float | None:
    increment = properties.get("wf_increment")
    if increment is None:
        return None
    seconds = float(str(increment)) * (_seconds_of_x(properties) or 1.0)
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise RecordingFormatError(f"{where}: expected a positive wf_increment; got {increment}")
    return 1.0 / seconds


def _start(part: _Part, zero: datetime | None) -> float | None:
    """Return when the first sample was taken, behind the zero [s]; ``None`` if a file with no zero states one later."""
    at, stated = _instant(part.properties.get("wf_start_time")), part.properties.get("wf_start_offset")
    if at is None and zero is None and stated is None:
        return None
    offset = float(str(stated or 0.0)) * (_seconds_of_x(part.properties) or 1.0)
    if (at is None) != (zero is None):
        return None
    return offset if at is None or zero is None else offset + (at - zero).total_seconds()


def _instant(start: object) -> datetime | None:
    at = start if isinstance(start, np.datetime64) else getattr(start, "as_datetime64", lambda: None)()
    if at is None or np.isnat(at) or at == _NO_TIME:
        return None
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(at.astype("datetime64[us]").astype(np.int64)))
