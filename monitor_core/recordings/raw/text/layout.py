"""State how a text file of columns is written, where it is not plain: ``[text]`` of a channel map, never guessed."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

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
#: Word of ``separator`` → the separator; ``None`` is any number of blanks.
SEPARATORS: Mapping[str, str | None] = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": None}
SEPARATOR_NAMES: Mapping[str | None, str] = {sign: word for word, sign in SEPARATORS.items()}


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Where the columns of a text stand and how they are written; rows are counted from 1."""

    separator: str | None = None  # tab | semicolon | comma | blank; None: the plain reader finds it
    decimal: str = "point"  # point | comma
    header_row: int | None = None  # of the names; 0: there is none; None: the plain reader finds it
    unit_row: int | None = None
    first_row: int | None = None  # of numbers; None: the row after header and units
    comment: str | None = None  # lines that begin so are left out, and still count as rows
    encoding: str = "utf-8"
    sheet: str | None = None  # of a workbook

    @classmethod
    def from_fields(cls, fields: Fields) -> "TextLayout":
        """Read ``[text]`` of a channel map.

        ``RecordingFormatError`` for an entry that is not known or does not fit, and for rows in contradiction.
        """
        fields.only(ENTRIES)
        separator = fields.optional_choice("separator", _Separator)
        layout = cls(
            separator=None if separator is None else str(separator),
            decimal=str(fields.optional_choice("decimal", _Decimal) or _Decimal.POINT),
            header_row=_row(fields, "header_row", 0),
            unit_row=_row(fields, "unit_row", 1),
            first_row=_row(fields, "first_row", 1),
            comment=fields.text("comment") if "comment" in fields else None,
            encoding=str(fields.optional_choice("encoding", _Encoding) or _Encoding.UTF_8),
            sheet=fields.text("sheet") if "sheet" in fields else None,
        )
        above = {"header_row": layout.header_row or 0, "unit_row": layout.unit_row or 0}
        for name, row in above.items():
            if layout.first_row is not None and row >= layout.first_row:
                raise RecordingFormatError(
                    f"{fields.where}: expected {name} above first_row; got rows {row} and {layout.first_row}"
                )
        if layout.unit_row is not None and layout.unit_row == layout.header_row:
            raise RecordingFormatError(
                f"{fields.where}: expected names and units in rows of their own; got row {layout.unit_row} for both"
            )
        return layout

    def entries(self) -> dict[str, str | int]:
        """Return the entries of ``[text]`` that say this layout, without those that say what holds anyway."""
        after_heads = max(self.header_row or 0, self.unit_row or 0) + 1
        stated: dict[str, str | int | None] = {
            "separator": self.separator,
            "decimal": None if self.decimal == "point" else self.decimal,
            "header_row": self.header_row,
            "unit_row": self.unit_row,
            "first_row": None if self.first_row == after_heads else self.first_row,
            "comment": self.comment,
            "encoding": None if self.encoding == "utf-8" else self.encoding,
            "sheet": self.sheet,
        }
        return {name: value for name, value in stated.items() if value is not None}


def propose_layout(path: Path) -> TextLayout | None:
    """Propose how a text file is written; ``None`` where the reader takes the file without a layout.

    The first 256 KiB and the end of the file are looked at. It is a proposal, for a person to confirm in a channel map;
    no reader applies it by itself. ``RecordingFormatError`` if no rows of numbers are found.
    """
    from monitor_core.recordings.raw.text.proposal import propose  # noqa: PLC0415  # it stands on this module

    found = propose(path)
    return None if found is None else found.layout


def propose_layout_for_blanks(path: Path) -> TextLayout | None:
    """Propose how a plain text file with blank cells is written; ``None`` if no layout reads it."""
    from monitor_core.recordings.raw.text.proposal import propose_for_blanks  # noqa: PLC0415  # it stands on this module

    return propose_for_blanks(path)


def _row(fields: Fields, name: str, least: int) -> int | None:
    if name not in fields:
        return None
    value = fields.number(name, "-")
    if not value.is_integer() or value < least:
        raise RecordingFormatError(f"{fields.where}, {name}: expected a row counted from {least}; got {value:g}")
    return int(value)
