"""Read Parquet files through pyarrow (extra ``parquet``): every column of numbers is a channel of its name.

A duration and a time of day become seconds, a decimal becomes a number. Columns of instants are channels of seconds
from the earliest of their first values, which is the zero of these times where the columns say that they are in UTC.
The unit is what the metadata of a column call ``unit`` or ``units``. A missing number becomes NaN.
"""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.bounds import require_plausible_channels, require_plausible_expansion
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.raw.channel_time import ChannelTime
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples, require_distinct

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_MAGIC = b"PAR1"
#: Fraction of a second that a column of instants counts in.
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def read_channels(path: Path) -> Channels:
    """Read the columns of numbers and instants of a Parquet file; it states no sample rate.

    Columns of texts, dates, truth values and nested ones are named as not read. ``RecordingFormatError`` if the file is
    damaged or would unpack to far more than it holds; ``MissingReaderError`` if pyarrow is not installed.
    """
    try:
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(
            f"{path.name}: reading Parquet needs pyarrow; pip install 'preload-monitor[parquet]'"
        ) from error

    with refusing(path.name, "a Parquet file"), require_file(path).open("rb") as stream:
        if stream.read(4) != _MAGIC:
            raise RecordingFormatError(f"{path.name}: expected a Parquet file, which begins with PAR1")
        limit = path.stat().st_size  # no text or list of the metadata is longer than the file
        with pq.ParquetFile(path, thrift_string_size_limit=limit, thrift_container_size_limit=limit) as file:
            fields = [field for field in file.schema_arrow if _is_channel(field.type)]
            _require_plausible(file.metadata, [field.name for field in fields], path)
            left_out = [f"{field.name} ({field.type})" for field in file.schema_arrow if not _is_channel(field.type)]
            columns = [(field, _column(file, field, path.name)) for field in fields]
        return Channels(path.name, _channels(columns, path.name), left_out=tuple(left_out))


def _is_channel(kind: "pa.DataType") -> bool:
    import pyarrow as pa  # noqa: PLC0415

    is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    return bool(is_number or pa.types.is_timestamp(kind) or _is_duration(kind))


def _is_duration(kind: "pa.DataType") -> bool:
    import pyarrow as pa  # noqa: PLC0415

    return bool(pa.types.is_duration(kind) or pa.types.is_time(kind))


def _require_plausible(metadata: "pq.FileMetaData", names: list[str], path: Path) -> None:
    require_distinct(names, path.name)
    require_plausible_channels([(name, metadata.num_rows) for name in names], path.name)
    require_plausible_expansion(8 * metadata.num_rows * len(names), path.stat().st_size, path.name)


def _column(file: "pq.ParquetFile", field: "pa.Field", where: str) -> "pa.ChunkedArray":
    column = file.read([field.name], use_threads=False).column(0)
    if len(column) != file.metadata.num_rows:
        raise RecordingFormatError(
            f"{where}, {field.name}: expected {file.metadata.num_rows} rows as the file says; got {len(column)}"
        )
    return column


def _channels(columns: list[tuple["pa.Field", "pa.ChunkedArray"]], where: str) -> tuple[Channel, ...]:
    """Return the columns; instants count from the earliest of all columns with a zone, or of all without one."""
    import pyarrow as pa  # noqa: PLC0415

    zeros: dict[bool, int] = {}  # by whether the column has a zone [ns since 1970]
    for field, column in columns:
        if pa.types.is_timestamp(field.type):
            if column.null_count or not len(column):
                raise RecordingFormatError(f"{where}, {field.name}: expected an instant in each row; some are missing")
            first, has_zone = column[0].value * (10**9 // _PER_SECOND[field.type.unit]), field.type.tz is not None
            zeros[has_zone] = min(first, zeros.get(has_zone, first))
    return tuple(
        _clock(field, column, zeros[field.type.tz is not None])
        if pa.types.is_timestamp(field.type)
        else _of_numbers(field, column)
        for field, column in columns
    )


def _of_numbers(field: "pa.Field", column: "pa.ChunkedArray") -> Channel:
    import pyarrow as pa  # noqa: PLC0415

    if _is_duration(field.type):
        whole = column.cast(pa.int32() if field.type.bit_width == 32 else pa.int64())
        return Channel(field.name, native_samples(whole.to_numpy() / np.float64(_PER_SECOND[field.type.unit])), "s")
    if pa.types.is_decimal(field.type):
        column = column.cast(pa.float64())
    return Channel(field.name, native_samples(column.to_numpy()), _unit(field))


def _unit(field: "pa.Field") -> str | None:
    stated = {key.decode().lower(): value.decode() for key, value in (field.metadata or {}).items()}
    return stated.get("unit") or stated.get("units") or None


def _clock(field: "pa.Field", column: "pa.ChunkedArray", zero: int) -> Channel:
    """Return a column of instants as seconds from a zero, which is counted in nanoseconds since 1970."""
    import pyarrow as pa  # noqa: PLC0415

    instants, per_second = column.cast(pa.int64()).to_numpy(), _PER_SECOND[field.type.unit]
    late = (int(instants[0]) * (10**9 // per_second) - zero) / 1e9
    samples = native_samples((instants - instants[0]) / np.float64(per_second) + late)
    # without a zone, the file does not say when it was; what is finer than a datetime tells is left to the seconds
    at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=zero // 1000) if field.type.tz is not None else None
    return Channel(field.name, samples, "s", ChannelTime(at))
