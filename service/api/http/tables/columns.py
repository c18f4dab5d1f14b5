"""Flatten the records of a list into the columns of a table, as the description of the API says what they are.

Columns follow from the description alone, so that two tables of a list have the same ones, whatever is in them:

* a member of a record within a record: both names with a dot between, ``configuration.baseline_size``;
* a pair of numbers: ``.lower`` and ``.upper``;
* what has another number of members from one record to the next (lists, objects without stated members, alternatives):
  one column that holds JSON.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from service.json_types import Json, JsonObject

#: A JSON schema, or the object that holds all of them.
Schema: TypeAlias = Mapping[str, Json]
_PAIR = ("lower", "upper")


class Kind(StrEnum):
    """What the cells of a column are."""

    INTEGER = "integer"
    NUMBER = "number"
    BOOLEAN = "boolean"
    TEXT = "string"
    MOMENT = "date-time"
    DOCUMENT = "json"


#: None is an empty cell.
Cell: TypeAlias = int | float | bool | str | None


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name, where its cells are in a record, and what they are."""

    name: str
    path: tuple[str | int, ...]
    kind: Kind

    def cell(self, record: Json) -> Cell:
        """Return what a record has here."""
        value: object = record
        for step in self.path:
            if isinstance(step, int):
                value = value[step] if isinstance(value, Sequence) else None
            else:
                value = value.get(step) if isinstance(value, Mapping) else None
        if value is None or isinstance(value, int | float | str):
            return json.dumps(value) if self.kind is Kind.DOCUMENT and value is not None else value
        return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def lists_of(answer: Schema, components: Schema) -> dict[str, tuple[Column, ...]]:
    """Return the lists that an answer holds, in their order, with the columns of each."""
    members = _as_schema(_resolved(answer, components).get("properties"))
    found = {}
    for name, member in members.items():
        schema = _resolved(_as_schema(member), components)
        if schema.get("type") == "array" and "items" in schema:
            item = _as_schema(schema["items"])
            columns = _columns("", (), item, components)
            found[name] = tuple(Column(column.name or name, column.path, column.kind) for column in columns)
    return found


def _columns(name: str, path: tuple[str | int, ...], schema: Schema, components: Schema) -> list[Column]:
    schema = _resolved(schema, components)
    if members := _as_schema(schema.get("properties")):
        inside = f"{name}." if name else ""
        return [
            column
            for member, its in members.items()
            for column in _columns(f"{inside}{member}", (*path, member), _as_schema(its), components)
        ]
    places = schema.get("prefixItems")
    if isinstance(places, Sequence) and len(places) == len(_PAIR):
        pair = [_kind(_resolved(_as_schema(place), components)) for place in places]
        if pair == [Kind.NUMBER, Kind.NUMBER]:
            return [Column(f"{name}.{end}", (*path, i), Kind.NUMBER) for i, end in enumerate(_PAIR)]
    return [Column(name, path, _kind(schema))]


def _kind(schema: Schema) -> Kind:
    kind = schema.get("format") if schema.get("format") == Kind.MOMENT else schema.get("type")
    if kind is None and (stated := [type(value) for value in _stated(schema)]):  # an enumeration without a type
        kind = {str: "string", bool: "boolean", int: "integer"}.get(stated[0])
    simple = (Kind.INTEGER, Kind.NUMBER, Kind.BOOLEAN, Kind.TEXT, Kind.MOMENT)
    return Kind(kind) if kind in simple else Kind.DOCUMENT


def _stated(schema: Schema) -> Sequence[Json]:
    if "const" in schema:
        return [schema["const"]]
    values = schema.get("enum")
    return values if isinstance(values, Sequence) else []


def _resolved(schema: Schema, components: Schema) -> Schema:
    """Follow references, and pass over the alternative of a null: any cell may be empty."""
    while True:
        reference, choice = schema.get("$ref"), schema.get("anyOf")
        if isinstance(reference, str):
            schema = _as_schema(components[reference.rpartition("/")[2]])
        elif isinstance(choice, Sequence):
            others = [_as_schema(each) for each in choice if _as_schema(each).get("type") != "null"]
            if len(others) != 1:
                return {}
            schema = others[0]
        else:
            return schema


def _as_schema(value: Json) -> Schema:
    return value if isinstance(value, Mapping) else {}


def records_of(answer: JsonObject, name: str) -> Sequence[Json]:
    """Return the records of a list of an answer."""
    records = answer[name]
    return records if isinstance(records, Sequence) else ()
