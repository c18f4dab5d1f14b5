"""A proposed channel map as the fields of a form, and the map that the filled-in form stands for."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

_TABLE: Final = re.compile(r"\[(?P<name>[\w.-]+)\]\s*(?:#\s*(?P<remark>.*))?")
_ENTRY: Final = re.compile(r'(?P<name>[a-z_]+) = (?P<value>"(?:[^"\\]|\\.)*"|[^#]*?)\s*(?:#\s*(?P<remark>.*))?')
_BLANK: Final = re.compile(r"# (?P<name>[a-z_]+) =\s*# fill in: (?P<remark>.*)")
_OPTIONAL: Final = re.compile(r"# (?P<name>[a-z_]+) = (?P<value>\"[^\"]*\"|\S+)\s*#\s*(?P<remark>.*)")
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
    example: str = ""  # of an entry that may be left out
    quoted: bool = False  # whether it is a text


@dataclass(frozen=True, slots=True)
class MapTable:
    """A table of a channel map; the first has no name."""

    name: str
    remark: str
    fields: list[MapField]


def map_tables(text: str) -> list[MapTable]:
    """Read a map that :func:`proposed_map` wrote, entry by entry; what is commented out has no value."""
    tables = [MapTable("", "", [])]
    for line in text.splitlines():
        if found := _TABLE.fullmatch(line):
            tables.append(MapTable(found["name"], found["remark"] or "", []))
        elif (entry := _field(line, tables[-1].name)) is not None:
            tables[-1].fields.append(entry)
    return [table for table in tables if table.fields]


def _field(line: str, table: str) -> MapField | None:
    if found := _BLANK.fullmatch(line):
        return MapField(f"{table}.{found['name']}", found["name"], "", found["remark"], required=True)
    if found := _OPTIONAL.fullmatch(line):
        example = found["value"]
        return MapField(
            f"{table}.{found['name']}", found["name"], "", found["remark"].removeprefix("optional: "),
            required=False, example=_unquoted(example), quoted=example.startswith('"'),
        )  # fmt: skip
    if found := _ENTRY.fullmatch(line):
        remark = (found["remark"] or "").removeprefix("confirm: ")
        value = found["value"].strip()
        return MapField(
            f"{table}.{found['name']}", found["name"], _unquoted(value), remark, required=True,
            quoted=value.startswith('"'),
        )  # fmt: skip
    return None


def filled_map(proposed: str, values: Mapping[str, str]) -> str:
    """Return the map of a filled-in form: the proposal with these values, without what was left empty."""
    lines: list[str] = []
    for table in map_tables(proposed):
        entries = [(field, values.get(field.key, "").strip()) for field in table.fields]
        if table.name and any(value for _, value in entries):
            lines += ["", f"[{table.name}]"]
        lines += [f"{field.name} = {_literal(value, quoted=field.quoted)}" for field, value in entries if value]
    return "\n".join(lines) + "\n"


def _unquoted(value: str) -> str:
    return str(json.loads(value)) if value.startswith('"') else value


def _literal(value: str, *, quoted: bool) -> str:
    """Return a value as TOML writes it: numbers and moments as they are, all else as a text."""
    return json.dumps(value) if quoted or not _PLAIN.fullmatch(value) else value
