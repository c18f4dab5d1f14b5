"""Define tables of the trend by their records: as long as the history, narrow, and in the order of reading."""

from collections.abc import Collection, Mapping
from dataclasses import fields
from datetime import datetime
from types import NoneType
from typing import Any, Final, get_args

from sqlalchemy import Boolean, Column, Connection, Executable, Float, Integer, String, Table
from sqlalchemy.types import TypeEngine

from service.store.tables import Base, UtcMicroseconds

_TYPES: Final[dict[object, TypeEngine[Any]]] = {
    int: Integer(), float: Float(), bool: Boolean(), str: String(), datetime: UtcMicroseconds(),
}  # fmt: skip


def table_of(
    name: str, record: type, *columns: Column[Any], key: Collection[str], types: dict[str, TypeEngine[Any]]
) -> Table:
    """Return the table of a record: columns of its own, then one for each field, of the type of its annotation."""
    held = list(columns)
    for field in fields(record):
        kinds = get_args(field.type) or (field.type,)
        kind = types.get(field.name) or _TYPES[kinds[0]]
        held.append(Column(field.name, kind, primary_key=field.name in key, nullable=NoneType in kinds))
    return Table(name, Base.metadata, *held, sqlite_with_rowid=False)


def stored_rows(connection: Connection, query: Executable, values: Mapping[str, object]) -> list[tuple[Any, ...]]:
    """Return rows as the driver has them, tuples of what is stored: to make all of them of its type takes longest."""
    with connection.execute(query, values) as result:
        return [] if result.cursor is None else list(result.cursor.fetchall())
