"""Answer a list as a file, CSV or Parquet, page after page: a million rows take as much memory as a thousand.

The columns are the members of the wire class of a record, so they are the same whatever the list holds. A pair of
numbers takes two, ``.lower`` and ``.upper``; what has another number of members from one record to the next takes one
of JSON.
"""

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from itertools import chain
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field
from pydantic_core import to_jsonable_python

from service.errors import NotAcceptableError
from service.json_types import JsonObject
from service.operations.fields import RequestModel

CSV_TYPE, PARQUET_TYPE = "text/csv; charset=utf-8", "application/vnd.apache.parquet"
#: So many records are read at a time, and so many kept until they are written as one group of a Parquet file.
ROWS_OF_PAGE, ROWS_OF_GROUP = 1000, 20_000
#: Text that a spreadsheet would compute, and what would be taken for it once it is marked.
_COMPUTED = re.compile(r"'*[=+\-@\t\r]")
#: For the description of the API: what a list is answered with besides JSON.
TABLE_CONTENT: JsonObject = {
    CSV_TYPE.partition(";")[0]: {"schema": {"type": "string"}},
    PARQUET_TYPE: {"schema": {"type": "string", "contentMediaType": PARQUET_TYPE}},
}
TABLE_RESPONSE: JsonObject = {"content": TABLE_CONTENT}


class TableQuery(RequestModel):
    """Whether a list is answered as a file; it is extended by which part of it."""

    format: Literal["csv", "parquet"] | None = Field(
        default=None, description="the whole list as a table; with limit or cursor, that page of it"
    )


class Column(NamedTuple):
    """A column: its name, the member of a record, which end of a pair (None: it is none), and the type of its cells."""

    name: str
    member: str
    end: int | None
    type: type  # dict: JSON

    def cell(self, record: JsonObject) -> Any:  # noqa: ANN401 - a number, text, bool, or None for an empty cell
        """Return what a record, as it is in JSON, has here."""
        value: Any = record[self.member]
        if value is None:
            return None
        if self.type is dict:
            return json.dumps(value, ensure_ascii=False, separators=(",", ":"))
        return value if self.end is None else value[self.end]


def columns_of(record: type[BaseModel]) -> list[Column]:
    """Return the columns of a wire class."""
    columns = []
    for name, field in record.model_fields.items():
        stated: Any = field.annotation
        kinds = [each for each in get_args(stated) if each is not NoneType] if _is_union(stated) else [stated]
        kind = dict if len(kinds) > 1 else get_origin(kinds[0]) or kinds[0]
        if kind is tuple:
            columns += [Column(f"{name}.{end}", name, i, float) for i, end in enumerate(("lower", "upper"))]
        else:
            simple = str if kind is Literal else kind
            columns.append(Column(name, name, None, simple if simple in _SIMPLE else dict))
    return columns


def _is_union(annotation: object) -> bool:
    return get_origin(annotation) in (Union, UnionType)


_SIMPLE = (int, float, bool, str, datetime)
Query = TypeVar("Query", bound=TableQuery)
#: The records of a page and where the next one begins; None: it is the last.
Page = tuple[Sequence[BaseModel | Mapping[str, object]], object]


def table(name: str, record: type[BaseModel], query: Query, read: Callable[[Query], Page]) -> StreamingResponse:
    """Answer the list that ``read`` gives page by page as the file that ``query`` asks for.

    Raises NotAcceptableError if Parquet is asked for and pyarrow is not installed, and what the first page raises.
    """
    columns, pages = columns_of(record), _pages(query, read)
    whole = chain([next(pages)], pages)
    kind = query.format or "csv"
    parts, media_type = (_csv(columns, whole), CSV_TYPE) if kind == "csv" else (_parquet(columns, whole), PARQUET_TYPE)
    headers = {"Content-Disposition": f'attachment; filename="{name}.{kind}"'}
    return StreamingResponse(parts, media_type=media_type, headers=headers)


def _pages(query: Query, read: Callable[[Query], Page]) -> Iterator[list[JsonObject]]:
    is_whole = not {"limit", "cursor"} & query.model_fields_set
    query = query.model_copy(update={"limit": ROWS_OF_PAGE}) if is_whole else query
    cursor: object = True
    while cursor is not None:
        records, cursor = read(query)
        yield to_jsonable_python(records)
        if not is_whole:
            return
        query = query.model_copy(update={"cursor": cursor})


def _csv(columns: Sequence[Column], pages: Iterator[list[JsonObject]]) -> Iterator[bytes]:
    """Write RFC 4180 in UTF-8; an empty cell is nothing, an empty text is ``""``: the module csv writes both alike."""
    yield _line([_quoted(column.name) for column in columns])
    for records in pages:
        yield b"".join(_line([_text(column.cell(record)) for column in columns]) for record in records)


def _line(cells: list[str]) -> bytes:
    return (",".join(cells) + "\r\n").encode()


def _text(cell: object) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    if isinstance(cell, str):
        return _quoted(f"'{cell}" if _COMPUTED.match(cell) else cell)
    return repr(cell)


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def _parquet(columns: Sequence[Column], pages: Iterator[list[JsonObject]]) -> Iterator[bytes]:
    try:
        import pyarrow as pa  # noqa: PLC0415  # an extra
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError as error:
        raise NotAcceptableError(
            "a Parquet table needs pyarrow, which is not installed here: ask for format=csv, or have it installed "
            "where the service runs: pip install pyarrow"
        ) from error
    types = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), datetime: pa.timestamp("us", "UTC")}
    schema = pa.schema([(column.name, types.get(column.type, pa.string())) for column in columns])

    def batch(records: list[JsonObject]) -> Any:  # noqa: ANN401 - a record batch
        cells = {column.name: [column.cell(record) for record in records] for column in columns}
        for column in columns:
            if column.type is datetime:
                cells[column.name] = [cell and datetime.fromisoformat(cell) for cell in cells[column.name]]
        return pa.RecordBatch.from_pydict(cells, schema)

    def parts() -> Iterator[bytes]:
        file, waiting = _Given(), list[Any]()
        with pq.ParquetWriter(pa.PythonFile(file, "w"), schema) as writer:
            for records in pages:
                waiting.append(batch(records))
                if sum(each.num_rows for each in waiting) >= ROWS_OF_GROUP:
                    writer.write_table(pa.Table.from_batches(waiting, schema))
                    waiting.clear()
                yield file.take()
            writer.write_table(pa.Table.from_batches(waiting, schema))
        yield file.take()

    return parts()


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
