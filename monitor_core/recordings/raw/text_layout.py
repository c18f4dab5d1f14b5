"""Say how a text file of columns is written, where it is not plain: ``[text]`` of a channel map."""

from dataclasses import dataclass
from enum import StrEnum

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.fields import Fields


class _Separator(StrEnum):
    TAB = "tab"
    SEMICOLON = "semicolon"
    COMMA = "comma"
    BLANK = "blank"


class _Decimal(StrEnum):
    POINT = "point"
    COMMA = "comma"


class _Encoding(StrEnum):
    UTF_8 = "utf-8"
    LATIN_1 = "latin-1"
    UTF_16 = "utf-16"


ENTRIES = frozenset((
    "separator", "decimal", "header_row", "unit_row", "first_row", "comment", "encoding", "sheet",
))  # fmt: skip


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Where the columns of a text stand and how they are written; rows are counted from 1."""

    separator: str | None = None  # tab | semicolon | comma | blank; None: the plain reader tells
    decimal: str = "point"  # point | comma
    header_row: int | None = None  # of the names; 0: there is none; None: the plain reader tells
    unit_row: int | None = None
    first_row: int | None = None  # of numbers; None: the row after header and units
    comment: str | None = None  # lines that begin so are left out, and still count as rows
    encoding: str = "utf-8"
    sheet: str | None = None  # of a workbook

    @classmethod
    def from_fields(cls, fields: Fields) -> "TextLayout":
        """Read ``[text]`` of a channel map; ``RecordingFormatError`` for an entry that is not known or does not fit."""
        fields.only(ENTRIES)
        separator = fields.optional_choice("separator", _Separator)
        return cls(
            separator=None if separator is None else str(separator),
            decimal=str(fields.optional_choice("decimal", _Decimal) or _Decimal.POINT),
            header_row=_row(fields, "header_row", 0),
            unit_row=_row(fields, "unit_row", 1),
            first_row=_row(fields, "first_row", 1),
            comment=fields.text("comment") if "comment" in fields else None,
            encoding=str(fields.optional_choice("encoding", _Encoding) or _Encoding.UTF_8),
            sheet=fields.text("sheet") if "sheet" in fields else None,
        )


def _row(fields: Fields, name: str, least: int) -> int | None:
    if name not in fields:
        return None
    value = fields.number(name, "-")
    if not value.is_integer() or value < least:
        raise RecordingFormatError(f"{fields.where}, {name}: expected a row counted from {least}; got {value:g}")
    return int(value)
