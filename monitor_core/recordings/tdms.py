"""TDMS files of LabVIEW and DAQmx, through npTDMS (extra ``tdms``): channels are named ``group/channel``."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.channels import Channel, Channels, native_samples
from monitor_core.recordings.files import refusing, require_file, require_plausible_length

if TYPE_CHECKING:
    from nptdms import TdmsChannel

#: Zero of TDMS time stamps. LabVIEW writes it where it knows no time, for instance with relative time.
_NO_TIME = np.datetime64("1904-01-01T00:00:00")
#: No value takes less than one bit (digital lines), and scaling adds none.
_VALUES_PER_BYTE = 8


def read_channels(path: Path) -> Channels:
    """Read the numeric channels of a TDMS file, with DAQmx scaling applied.

    Parameters
    ----------
    path : Path
        Either byte order. Channels without samples and channels of text, times or complex numbers are left out.

    Returns
    -------
    Channels
        Unit from ``unit_string``, sample rate from ``wf_increment``, start from ``wf_start_time`` and
        ``wf_start_offset``. TDMS times are UTC by definition of the format.

    Raises
    ------
    RecordingFormatError
        If the file is damaged, cut off, or promises more samples than it can hold.
    MissingReaderError
        If npTDMS is not installed.
    """
    try:
        from nptdms import TdmsFile  # noqa: PLC0415
    except ImportError as error:
        raise MissingReaderError(
            f"{path.name}: reading TDMS needs npTDMS; pip install 'preload-monitor[tdms]'"
        ) from error

    n_bytes = require_file(path).stat().st_size
    channels = []
    # opened here, because npTDMS would prefer a neighbouring *.tdms_index, which may be of another recording
    with refusing(path.name, "a TDMS file"), path.open("rb") as stream, TdmsFile.open(stream) as file:
        if file.file_status.incomplete_final_segment:
            raise RecordingFormatError(f"{path.name}: expected a complete TDMS file; its last segment is cut off")
        for channel in (c for group in file.groups() for c in group.channels()):
            if len(channel) == 0 or channel.dtype.kind not in "fiub":
                continue
            name = f"{channel.group_name}/{channel.name}"
            require_plausible_length(len(channel), f"{path.name}, {name}")
            if len(channel) > n_bytes * _VALUES_PER_BYTE:
                raise RecordingFormatError(
                    f"{path.name}, {name}: expected {len(channel)} samples as its header says; "
                    f"got {n_bytes} bytes in all"
                )
            channels.append(_channel(channel, name, path.name))
    return Channels(path.name, tuple(channels))


def _channel(channel: "TdmsChannel", name: str, file_name: str) -> Channel:
    properties = channel.properties
    increment = properties.get("wf_increment")
    if increment is not None and not (np.isfinite(increment) and increment > 0.0):
        raise RecordingFormatError(f"{file_name}, {name}: expected a positive wf_increment; got {increment} s")
    return Channel(
        name=name,
        samples=native_samples(channel[:]),
        unit=properties.get("unit_string") or None,
        sample_rate=None if increment is None else 1.0 / float(increment),
        started_at=_started_at(properties.get("wf_start_time"), float(properties.get("wf_start_offset") or 0.0)),
    )


def _started_at(start: object, offset: float) -> datetime | None:
    if not isinstance(start, np.datetime64) or np.isnat(start) or start == _NO_TIME:
        return None
    microseconds = start.astype("datetime64[us]").astype(np.int64)
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(microseconds), seconds=offset)
