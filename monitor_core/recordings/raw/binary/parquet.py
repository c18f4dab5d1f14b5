"""Read Parquet files through pyarrow (extra ``parquet``): every column of numbers is a channel of its name.

A duration and a time of day become seconds, a decimal becomes a number. Columns of instants are channels of seconds
from the earliest of their first values, which is the zero of these times where the columns say that they are in UTC.
The unit is what the metadata of a column call ``unit`` or ``units``. A missing number becomes NaN.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import SampleArray
from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.bounds import require_plausible_channels, require_plausible_expansion
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.raw.channel_time import ChannelTime
from monitor_core.recordings.raw.channels import (
    PIECE,
    Channel,
    Channels,
    native_samples,
    require_distinct,
    stored_samples,
)

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_MAGIC = b"PAR1"
#: Fraction of a second that a column of instants counts in.
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_BUFFER = 2**18  # bytes of a column that are read at a time


def read_channels(path: Path) -> Channels:
    """Read the columns of numbers and instants of a Parquet file; it states no sample rate.

    Columns of texts, dates, truth values and nested ones are named as not read. ``RecordingFormatError`` if the file is
    damaged or would unpack to far more than it holds; ``MissingReaderError`` if pyarrow is not installed.
    """
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(f"{path.name}: reading Parquet needs pyarrow; pip install pyarrow") from error

    with refusing(path.name, "a Parquet file"), require_file(path).open("rb") as stream:
        if stream.read(4) != _MAGIC:
            raise RecordingFormatError(f"{path.name}: expected a Parquet file, which begins with PAR1")
    with _opened(path) as file:
        columns = _columns(file, path)
        channels = tuple(_channel(file, columns, number, path) for number in range(len(columns)))
        left_out = tuple(f"{field.name} ({field.type})" for field in file.schema_arrow if not _is_channel(field.type))
    return Channels(path.name, channels, left_out=left_out)


@contextmanager
def _opened(path: Path) -> Iterator["pq.ParquetFile"]:
    import pyarrow.parquet as pq  # noqa: PLC0415

    limit = path.stat().st_size  # no text or list of the metadata is longer than the file
    bounds = {"thrift_string_size_limit": limit, "thrift_container_size_limit": limit}
    with (
        refusing(path.name, "a Parquet file"),
        pq.ParquetFile(path, **bounds, pre_buffer=False, buffer_size=_BUFFER) as file,
    ):
        yield file


def _is_channel(kind: "pa.DataType") -> bool:
    import pyarrow as pa  # noqa: PLC0415

    is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    return bool(is_number or pa.types.is_timestamp(kind) or _is_duration(kind))


def _is_duration(kind: "pa.DataType") -> bool:
    import pyarrow as pa  # noqa: PLC0415

    return bool(pa.types.is_duration(kind) or pa.types.is_time(kind))


@dataclass(frozen=True, slots=True)
class _Column:
    field: "pa.Field"
    where: str  # for messages
    first: int | None = None  # of instants: the first of them, in the unit of the column
    zero: int = 0  # that they are counted from [ns since 1970]


def _columns(file: "pq.ParquetFile", path: Path) -> list[_Column]:
    """Return the columns; instants count from the earliest of all columns with a zone, or of all without one."""
    fields = [field for field in file.schema_arrow if _is_channel(field.type)]
    names, n_rows = [field.name for field in fields], file.metadata.num_rows
    require_distinct(names, path.name)
    require_plausible_channels([(name, n_rows) for name in names], path.name)
    require_plausible_expansion(8 * n_rows * len(names), path.stat().st_size, path.name)
    columns = [_column(file, field, f"{path.name}, {field.name}") for field in fields]
    zeros: dict[bool, int] = {}  # by whether the column has a zone
    for column in columns:
        if column.first is not None:
            has_zone = column.field.type.tz is not None
            zeros[has_zone] = min(column.zero, zeros.get(has_zone, column.zero))
    return [
        column if column.first is None else replace(column, zero=zeros[column.field.type.tz is not None])
        for column in columns
    ]


def _column(file: "pq.ParquetFile", field: "pa.Field", where: str) -> _Column:
    import pyarrow as pa  # noqa: PLC0415

    if not pa.types.is_timestamp(field.type):
        return _Column(field, where)
    instants = next(_numbers(file, _Column(field, where, 0)), None)
    if instants is None:
        raise RecordingFormatError(f"{where}: expected an instant in each row; some are missing")
    first = int(instants[0])
    return _Column(field, where, first, first * (10**9 // _PER_SECOND[field.type.unit]))


def _numbers(file: "pq.ParquetFile", column: _Column) -> Iterator[npt.NDArray[Any]]:
    """Yield the numbers of a column as they are stored; a missing one is NaN, and refused among instants."""
    import pyarrow as pa  # noqa: PLC0415

    kind = column.field.type
    for batch in file.iter_batches(PIECE, columns=[column.field.name], use_threads=False):
        values = batch.column(0)
        if column.first is not None and values.null_count:
            raise RecordingFormatError(f"{column.where}: expected an instant in each row; some are missing")
        if column.first is not None or _is_duration(kind):
            values = values.cast(pa.int32() if kind.bit_width == 32 else pa.int64())
        elif pa.types.is_decimal(kind):
            values = values.cast(pa.float64())
        if len(values):
            yield values.to_numpy(zero_copy_only=False)


def _samples_of(file: "pq.ParquetFile", column: _Column) -> Iterator[SampleArray]:
    kind = column.field.type
    for numbers in _numbers(file, column):
        if column.first is not None:
            late = (column.first * (10**9 // _PER_SECOND[kind.unit]) - column.zero) / 1e9
            yield native_samples((numbers - column.first) / np.float64(_PER_SECOND[kind.unit]) + late)
        else:
            yield native_samples(numbers / np.float64(_PER_SECOND[kind.unit]) if _is_duration(kind) else numbers)


def _pieces(path: Path, columns: list[_Column], wanted: Collection[int]) -> Iterator[tuple[int, SampleArray]]:
    with _opened(path) as file:
        for number in wanted:
            yield from ((number, piece) for piece in _samples_of(file, columns[number]))


def _channel(file: "pq.ParquetFile", columns: list[_Column], number: int, path: Path) -> Channel:
    column = columns[number]
    field, own = column.field, _samples_of(file, column)
    samples = stored_samples((file.metadata.num_rows,), own, number, partial(_pieces, path, columns))
    if column.first is None:
        return Channel(field.name, samples, "s" if _is_duration(field.type) else _unit(field))
    # without a zone, the file does not say when it was; what is finer than a datetime tells is left to the seconds
    at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=column.zero // 1000)
    return Channel(field.name, samples, "s", ChannelTime(None if field.type.tz is None else at))


def _unit(field: "pa.Field") -> str | None:
    stated = {key.decode().lower(): value.decode() for key, value in (field.metadata or {}).items()}
    return stated.get("unit") or stated.get("units") or None
