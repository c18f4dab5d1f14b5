"""A proposed channel map as the fields of a form, and the map that the filled-in form stands for."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from monitor_core.recordings.raw.proposal.entries import MapEntry, MapProposal, Mark

#: What a person types that TOML takes without quotes: numbers and moments.
_PLAIN: Final = re.compile(
    r"[+-]?\d+(\.\d+)?([eE][+-]?\d+)?|\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)|true|false"
)


@dataclass(frozen=True, slots=True)
class MapField:
    """An entry of a channel map."""

    key: str  # of the form: table and name
    name: str
    value: str  # proposed; empty: to be filled in, or left out
    remark: str
    required: bool
    example: str  # of an entry that may be left out
    quoted: bool  # whether it is a text


@dataclass(frozen=True, slots=True)
class FieldTable:
    """A table of a channel map; the first has no name."""

    name: str
    remark: str
    fields: list[MapField]


def map_fields(proposal: MapProposal) -> list[FieldTable]:
    """Return the fields of a proposed map, table by table."""
    return [
        FieldTable(table.name, table.remark, [_field(entry, table.name) for entry in table.entries])
        for table in proposal.tables
        if table.entries
    ]


def _field(entry: MapEntry, table: str) -> MapField:
    optional = entry.mark is Mark.OPTIONAL
    value, example = ("", entry.value) if optional else (entry.value, "")
    key = f"{table}.{entry.name}"
    return MapField(key, entry.name, value, entry.remark, not optional, example, quoted=entry.is_text)


def filled_map(tables: Sequence[FieldTable], values: Mapping[str, str]) -> str:
    """Return the map of a filled-in form, as TOML, without what was left empty."""
    lines: list[str] = []
    for table in tables:
        entries = [(field, values.get(field.key, "").strip()) for field in table.fields]
        if table.name and any(value for _, value in entries):
            lines += ["", f"[{table.name}]"]
        lines += [f"{field.name} = {_literal(value, quoted=field.quoted)}" for field, value in entries if value]
    return "\n".join(lines) + "\n"


def filled_files(names: Sequence[str], values: Mapping[str, Mapping[str, str]]) -> str:
    """Return the part of the map that says of each file what it was measured under, by the names of the entries."""
    lines: list[str] = []
    for name in names:
        own = {entry: value for entry, value in values[name].items() if value}
        lines += ["", "[[files]]", f"name = {json.dumps(name)}"]
        lines += [f"{entry} = {_literal(value, quoted=False)}" for entry, value in own.items()]
    return "\n".join(lines) + "\n"


def _literal(value: str, *, quoted: bool) -> str:
    """Return a value as TOML writes it: numbers and moments as they are, all else as a text."""
    return json.dumps(value) if quoted or not _PLAIN.fullmatch(value) else value
