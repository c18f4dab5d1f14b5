"""Prepare the statements that every window needs: SQLAlchemy writes them once, then the driver runs them.

SQLAlchemy's own way to run a statement takes several times as long as a small database takes to answer it. Errors are
those of the driver, which :mod:`service.store.database` turns into the service's like those of SQLAlchemy.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Delete, Dialect, Insert, Select, Update

_Statement = Select[Any] | Insert | Update | Delete

_Convert = Callable[[Any], Any] | None


@dataclass(frozen=True, slots=True)
class _Written:
    """A statement as one database wants it."""

    text: str
    constants: dict[str, object]  # values that stand in the statement itself, by parameter
    names: list[str]  # of the parameters, in the order of the text
    to_driver: list[tuple[str, _Convert]]  # by parameter, in that order
    by_position: bool


class _Prepared:
    """A statement with named parameters. Values are converted as SQLAlchemy converts them, both ways.

    A parameter stands once in a statement, and holds one value: lists of values are for SQLAlchemy to write out.
    """

    def __init__(self, statement: _Statement, columns: Sequence[str] = ()) -> None:
        self._statement = statement
        self._columns = columns
        self._written: dict[str, _Written] = {}  # by name of the dialect

    def _run(self, connection: Connection, values: dict[str, object]) -> Any:  # noqa: ANN401 - a cursor of the driver
        dialect = connection.dialect
        written = self._written.get(dialect.name)
        if written is None:
            written = self._written[dialect.name] = _write(self._statement, self._columns, dialect)
        given = written.constants | values if written.constants else values
        converted = [given[name] if convert is None else convert(given[name]) for name, convert in written.to_driver]
        cursor = connection.connection.cursor()
        cursor.execute(
            written.text, converted if written.by_position else dict(zip(written.names, converted, strict=True))
        )
        return cursor


class PreparedSelect(_Prepared):
    """A SELECT."""

    def __init__(self, statement: Select[Any]) -> None:
        super().__init__(statement)
        self._kinds = [column.type for column in statement.selected_columns]
        self._from_driver: dict[str, list[tuple[int, Callable[[Any], Any]]]] = {}  # by dialect, of columns that want it

    def rows(self, connection: Connection, values: dict[str, object]) -> Sequence[Sequence[Any]]:
        """Return what it finds."""
        cursor, dialect = self._run(connection, values), connection.dialect
        convert = self._from_driver.get(dialect.name)
        if convert is None:
            kinds = zip(self._kinds, cursor.description, strict=True)
            processors = [
                kind.dialect_impl(dialect).result_processor(dialect, described[1]) for kind, described in kinds
            ]
            convert = self._from_driver[dialect.name] = [
                (i, own) for i, own in enumerate(processors) if own is not None
            ]
        fetched: list[tuple[Any, ...]] = cursor.fetchall()
        if not convert:
            return fetched
        rows = [list(row) for row in fetched]
        for row in rows:
            for i, own in convert:
                row[i] = own(row[i])
        return rows


class PreparedChange(_Prepared):
    """An INSERT or UPDATE, given the columns that it sets, or a DELETE."""

    def __init__(self, statement: Insert | Update | Delete, columns: Sequence[str] = ()) -> None:
        super().__init__(statement, columns)

    def run(self, connection: Connection, values: dict[str, object]) -> int:
        """Run it, and return how many rows it met."""
        n_rows: int = self._run(connection, values).rowcount
        return n_rows


def _write(statement: _Statement, columns: Sequence[str], dialect: Dialect) -> _Written:
    compiled = statement.compile(dialect=dialect, column_keys=list(columns) or None)
    names = compiled.positiontup or list(compiled.binds)
    return _Written(
        text=compiled.string,
        names=list(names),
        constants={name: bind.value for name, bind in compiled.binds.items() if not bind.required},
        to_driver=[(name, compiled.binds[name].type.dialect_impl(dialect).bind_processor(dialect)) for name in names],
        by_position=compiled.positiontup is not None,
    )
