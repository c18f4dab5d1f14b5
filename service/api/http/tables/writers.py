"""Write tables as CSV or Parquet, some rows at a time: what is written is given away at once."""

import io
import re
from collections.abc import Sequence
from datetime import datetime
from typing import Any, Protocol

from service.api.http.tables.columns import Cell, Column, Kind
from service.errors import NotAcceptableError
from service.json_types import Json

CSV_TYPE, PARQUET_TYPE = "text/csv; charset=utf-8", "application/vnd.apache.parquet"
#: So many rows are kept until they are written as one group of a Parquet file.
ROWS_OF_GROUP = 20_000
#: Text that a spreadsheet would compute, and what would be taken for it once it is marked.
_COMPUTED = re.compile(r"'*[=+\-@\t\r]")


class TableWriter(Protocol):
    """Takes records and returns the bytes of the file as far as they are known."""

    media_type: str

    def begin(self) -> bytes:
        """Begin the file."""

    def add(self, records: Sequence[Json]) -> bytes:
        """Add a row for each record."""

    def end(self) -> bytes:
        """End the file."""


class CsvWriter:
    """RFC 4180 in UTF-8. An empty cell is nothing, an empty text is ``""``: Python's own module writes both alike."""

    media_type = CSV_TYPE

    def __init__(self, columns: Sequence[Column]) -> None:
        self._columns = columns

    def begin(self) -> bytes:
        """Return the names of the columns."""
        return _line([_quoted(column.name) for column in self._columns]).encode()

    def add(self, records: Sequence[Json]) -> bytes:
        """Return a line for each record."""
        return "".join(_line([_csv(column.cell(record)) for column in self._columns]) for record in records).encode()

    def end(self) -> bytes:
        """Return nothing more."""
        return b""


def _line(cells: list[str]) -> str:
    return ",".join(cells) + "\r\n"


def _csv(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    if isinstance(cell, str):
        return _quoted(f"'{cell}" if _COMPUTED.match(cell) else cell)
    return repr(cell)


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


class ParquetWriter:
    """Parquet by pyarrow; raises NotAcceptableError where that is not installed."""

    media_type = PARQUET_TYPE

    def __init__(self, columns: Sequence[Column]) -> None:
        try:
            import pyarrow as pa  # noqa: PLC0415  # an extra
            import pyarrow.parquet as pq  # noqa: PLC0415
        except ImportError as error:
            raise NotAcceptableError(
                "a Parquet table needs pyarrow, which is not installed here: ask for format=csv, or install the extra "
                "parquet of the service"
            ) from error
        types = {
            Kind.INTEGER: pa.int64(),
            Kind.NUMBER: pa.float64(),
            Kind.BOOLEAN: pa.bool_(),
            Kind.MOMENT: pa.timestamp("us", "UTC"),
        }
        self._columns = columns
        self._arrow = pa
        self._schema = pa.schema([(column.name, types.get(column.kind, pa.string())) for column in columns])
        self._file = _Given()
        self._writer = pq.ParquetWriter(pa.PythonFile(self._file, "w"), self._schema)
        self._waiting: list[Any] = []  # record batches

    def begin(self) -> bytes:
        """Return the first bytes."""
        return self._file.take()

    def add(self, records: Sequence[Json]) -> bytes:
        """Keep the rows, and write those that are kept once they are many."""
        cells = [
            self._arrow.array(_cells(column, records), field.type)
            for column, field in zip(self._columns, self._schema, strict=True)
        ]
        self._waiting.append(self._arrow.record_batch(cells, schema=self._schema))
        if sum(batch.num_rows for batch in self._waiting) >= ROWS_OF_GROUP:
            self._write()
        return self._file.take()

    def end(self) -> bytes:
        """Write what is left, and where everything is."""
        self._write()
        self._writer.close()
        return self._file.take()

    def _write(self) -> None:
        self._writer.write_table(self._arrow.Table.from_batches(self._waiting, self._schema))
        self._waiting.clear()


def _cells(column: Column, records: Sequence[Json]) -> list[Cell | datetime]:
    cells = [column.cell(record) for record in records]
    if column.kind is Kind.MOMENT:
        return [datetime.fromisoformat(cell) if isinstance(cell, str) else None for cell in cells]
    return list(cells)


class _Given(io.RawIOBase):
    """A file whose bytes are given away as they come."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._position = 0

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:  # noqa: ANN401 - any buffer
        self._parts.append(bytes(data))
        self._position += len(self._parts[-1])
        return len(self._parts[-1])

    def tell(self) -> int:
        return self._position

    def take(self) -> bytes:
        """Return what was written since the last time."""
        given, self._parts = b"".join(self._parts), []
        return given


WRITERS: dict[str, type[CsvWriter] | type[ParquetWriter]] = {"csv": CsvWriter, "parquet": ParquetWriter}
