"""Read TDMS files of LabVIEW and DAQmx through npTDMS (extra ``tdms``): channels are named ``group/channel``."""

import struct
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.files import refusing, require_file, require_plausible_length
from monitor_core.recordings.raw.channel_time import even_time
from monitor_core.recordings.raw.channels import PIECE, Channel, Channels, Stored, native_samples, stored_samples

if TYPE_CHECKING:
    from nptdms import TdmsChannel, TdmsFile

#: Zero of TDMS time stamps. LabVIEW writes it where it knows no time, for instance with relative time.
_NO_TIME = np.datetime64("1904-01-01T00:00:00")
_LEAD_IN = 28
_BIG_ENDIAN = 1 << 6
_VERSIONS = (4712, 4713)
#: What npTDMS can apply; anything else it would leave unscaled.
_SCALES = frozenset(("Linear", "Polynomial", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract",
                     "AdvancedAPI"))  # fmt: skip
_MOST_SCALES = 100
_NOT_READ = {"c": "complex", "M": "times"}
#: No value takes less than one bit (digital lines), and scaling adds none.
_VALUES_PER_BYTE = 8


def read_channels(path: Path) -> Channels:
    """Read the numeric channels of a TDMS file of either byte order, with DAQmx scaling applied.

    The unit comes from ``unit_string``, the sample rate from ``wf_increment``, the start from ``wf_start_time`` and
    ``wf_start_offset``; TDMS times are UTC by definition of the format. Channels without samples and channels of text,
    times or complex numbers are named as not read. ``RecordingFormatError`` if the file is damaged, cut off, or
    promises more samples than it can hold; ``MissingReaderError`` if npTDMS is not installed.
    """
    try:
        import nptdms  # noqa: F401, PLC0415
        from nptdms.log import log_manager  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(
            f"{path.name}: reading TDMS needs npTDMS; pip install 'preload-monitor[tdms]'"
        ) from error

    log_manager.set_level("CRITICAL")  # what npTDMS only warns of is refused here
    n_bytes = require_file(path).stat().st_size
    _require_whole_segments(path, n_bytes)
    channels, left_out = list[Channel](), list[str]()
    with _opened(path) as file:
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
            samples = stored_samples((len(channel),), _samples_of(channel), number, partial(_pieces, path))
            channels.append(_channel(channel, name, samples, path.name))
    return Channels(path.name, tuple(channels), left_out=tuple(left_out))


@contextmanager
def _opened(path: Path) -> Iterator["TdmsFile"]:
    from nptdms import TdmsFile  # noqa: PLC0415

    # opened here, because npTDMS would prefer a neighbouring *.tdms_index, which may be of another recording
    with refusing(path.name, "a TDMS file"), path.open("rb") as stream, TdmsFile.open(stream) as file:
        yield file


def _all_channels(file: "TdmsFile") -> list["TdmsChannel"]:
    return [channel for group in file.groups() for channel in group.channels()]


def _samples_of(channel: "TdmsChannel") -> Iterator[SampleArray]:
    for start in range(0, len(channel), PIECE):
        yield native_samples(channel[start : start + PIECE])


def _pieces(path: Path, wanted: Collection[int]) -> Iterator[tuple[int, SampleArray]]:
    with _opened(path) as file:
        channels = _all_channels(file)
        for number in wanted:
            for piece in _samples_of(channels[number]):
                yield number, piece


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


def _channel(channel: "TdmsChannel", name: str, samples: SampleArray | Stored, file_name: str) -> Channel:
    properties = channel.properties
    increment = properties.get("wf_increment")
    if increment is not None and not (np.isfinite(increment) and increment > 0.0):
        raise RecordingFormatError(f"{file_name}, {name}: expected a positive wf_increment; got {increment} s")
    offset = float(properties.get("wf_start_offset") or 0.0)
    rate = None if increment is None else 1.0 / float(increment)
    return Channel(
        name=name,
        stored=samples,
        unit=properties.get("unit_string") or None,
        time=even_time(len(channel), rate, offset, _zero(properties.get("wf_start_time"))),
    )


def _zero(start: object) -> datetime | None:
    if not isinstance(start, np.datetime64) or np.isnat(start) or start == _NO_TIME:
        return None
    microseconds = start.astype("datetime64[us]").astype(np.int64)
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(microseconds))
