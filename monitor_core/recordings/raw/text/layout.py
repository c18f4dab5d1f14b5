"""State how a text file of columns is written, where it is not plain: ``[text]`` of a channel map, never guessed."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.units import canonical_unit

#: Word of ``separator`` → the separator; ``None`` is any number of blanks.
SEPARATORS: Mapping[str, str | None] = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": None}
SEPARATOR_NAMES: Mapping[str | None, str] = {sign: word for word, sign in SEPARATORS.items()}
#: Word of ``decimal`` → the sign.
DECIMALS = {"point": ".", "comma": ","}
_ENCODINGS = ("utf-8", "latin-1", "utf-16")
_TIME_WORDS = frozenset(("time", "zeit", "timestamp", "zeitstempel", "temps", "tempo"))
_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)")
_WORD = re.compile(r"[^\W\d_]+")


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
    believe: str | None = None  # "rows": where the header of an export states another number of samples

    @classmethod
    def from_fields(cls, fields: Fields) -> "TextLayout":
        """Read ``[text]`` of a channel map.

        ``RecordingFormatError`` for an entry that is not known or does not fit, and for rows in contradiction.
        """
        fields.only(frozenset(cls.__slots__))
        layout = cls(
            separator=fields.optional_word("separator", SEPARATORS),
            decimal=fields.optional_word("decimal", DECIMALS) or "point",
            header_row=_row(fields, "header_row", 0),
            unit_row=_row(fields, "unit_row", 1),
            first_row=_row(fields, "first_row", 1),
            comment=fields.optional_text("comment"),
            encoding=fields.optional_word("encoding", _ENCODINGS) or "utf-8",
            sheet=fields.optional_text("sheet"),
            believe=fields.optional_word("believe", ("rows",)),
        )
        for name, row in (("header_row", layout.header_row or 0), ("unit_row", layout.unit_row or 0)):
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
        usual = {"decimal": "point", "first_row": after_heads, "encoding": "utf-8"}
        stated = {name: getattr(self, name) for name in self.__slots__}
        return {name: value for name, value in stated.items() if value is not None and value != usual.get(name)}


def _row(fields: Fields, name: str, least: int) -> int | None:
    if name not in fields:
        return None
    value = fields.number(name, "-")
    if not value.is_integer() or value < least:
        raise RecordingFormatError(f"{fields.where}, {name}: expected a row counted from {least}; got {value:g}")
    return int(value)


def time_columns(names: Sequence[str]) -> dict[int, int] | None:
    """Return the column of times of each column of values, if columns come in pairs of time and value; else None.

    So traces of drives are written, as those of SINUMERIK and SINAMICS: the columns of times have one name, or are
    numbered. Signals that were sampled more slowly have fewer rows: their cells are blank.
    """
    if len(names) < 4 or len(names) % 2:
        return None
    of_times = [_is_time(name) for name in names]
    if not all(of_times[0::2]) or any(of_times[1::2]):
        return None
    return {column: column - 1 for column in range(1, len(names), 2)}


def _is_time(name: str) -> bool:
    words = _WORD.findall(_BRACKETS.sub(" ", name))
    return bool(words) and any(word == "t" or word.lower() in _TIME_WORDS for word in (words[0], words[-1]))


def has_equal_names(names: Sequence[str]) -> bool:
    """Tell whether the columns of times share a name, as no other file of columns has them."""
    return len(set(names[0::2])) < len(names[0::2])


def distinct_names(names: Sequence[str]) -> list[str]:
    """Return the names, with numbers where columns of times share one: "Time 1", "Time 2", …."""
    if not has_equal_names(names):
        return list(names)
    numbered = [_BRACKETS.sub("", name).strip() or name for name in names]
    return [f"{numbered[i]} {i // 2 + 1}" if i % 2 == 0 else name for i, name in enumerate(names)]


def units_in_names(names: Sequence[str]) -> dict[int, str]:
    """Return the units in brackets behind names, such as "Time [ms]", where they are known here."""
    brackets = {i: match for i, name in enumerate(names) if (match := _BRACKETS.search(name)) is not None}
    units = {i: (match[1] or match[2] or "").strip() for i, match in brackets.items()}
    return {i: unit for i, unit in units.items() if canonical_unit(unit) is not None}


def is_bracketed(cell: str) -> bool:
    """Tell whether a cell stands in brackets, as units do."""
    return len(cell) > 2 and _BRACKETS.fullmatch(cell) is not None
