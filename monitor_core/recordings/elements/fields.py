"""Read named values of one place, each with its type and unit: HDF5 attributes, a TOML table, a JSON document.

What does not fit is refused with its place. Instants are RFC 3339 with a zone, never without.
"""

import math
import re
from collections.abc import Collection, Mapping, Set as AbstractSet
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import TypeVar

import numpy as np

from monitor_core.errors import RecordingFormatError

_RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)


def parse_instant(text: str, where: str) -> datetime:
    """Read an RFC 3339 instant with its time zone; digits beyond the microsecond are cut off.

    The text is such as ``2025-03-01T06:00:00Z`` or ``2025-03-01T07:00:00.25+01:00``; ``where`` names file and place for
    the message. ``RecordingFormatError`` if the text is no such instant, if the zone is missing, or if the calendar has
    no such day.

    Examples
    --------
    RFC 3339, section 5.8: 20 minutes and 50.52 seconds after the 23rd hour of April 12th, 1985 in UTC.

    >>> parse_instant("1985-04-12T23:20:50.52Z", "example").isoformat()
    '1985-04-12T23:20:50.520000+00:00'
    """
    reason = ""
    if _RFC_3339.fullmatch(text):
        try:
            return datetime.fromisoformat(text.upper())
        except ValueError as error:
            reason = f" ({error})"
    raise RecordingFormatError(
        f"{where}: expected an RFC 3339 time with zone such as 2025-03-01T06:00:00Z; got {text!r}{reason}"
    )


def format_instant(instant: datetime) -> str:
    """Write an instant as RFC 3339, keeping its offset; local mean times with seconds in the offset become UTC."""
    offset = instant.utcoffset()
    if offset is None:
        raise RecordingFormatError(f"expected a time with zone; got {instant.isoformat()}")
    return (instant if offset % timedelta(minutes=1) == timedelta(0) else instant.astimezone(UTC)).isoformat()


Choice = TypeVar("Choice", bound=StrEnum)


@dataclass(frozen=True, slots=True)
class Fields:
    """Values by name, and where they stand; nothing is converted from one type to another."""

    values: Mapping[str, object]
    where: str

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def text(self, name: str) -> str:
        """Return a text that is not empty."""
        value = self._required(name, "a text")
        if isinstance(value, bytes):
            value = value.decode("utf-8", "surrogateescape")
        if not isinstance(value, str) or not value:
            raise RecordingFormatError(f"{self._place(name)}: expected a text; got {_shown(value)}")
        if not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
            raise RecordingFormatError(f"{self._place(name)}: expected UTF-8 text; got {value[:40]!a}")
        return str(value)

    def optional_text(self, name: str) -> str | None:
        """Return a text that is not empty, or None where nothing is stated."""
        return self.text(name) if name in self.values else None

    def optional_word(self, name: str, words: Collection[str]) -> str | None:
        """Return one of some words, or None where nothing is stated."""
        return self.word(name, words) if name in self.values else None

    def number(self, name: str, unit: str) -> float:
        """Return a finite number; ``unit`` is said in the message."""
        expected = f"a number [{unit}]"
        value = self._required(name, expected)
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise RecordingFormatError(f"{self._place(name)}: expected {expected}; got {_shown(value)}")
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            number = math.inf
        if not math.isfinite(number):
            raise RecordingFormatError(f"{self._place(name)}: expected a finite number; got {number} {unit}")
        return number

    def optional_number(self, name: str, unit: str) -> float | None:
        """Return a finite number, or None where nothing is stated."""
        return self.number(name, unit) if name in self.values else None

    def not_negative(self, name: str, unit: str) -> float:
        """Return a number that is zero or above."""
        value = self.number(name, unit)
        if value < 0.0:
            raise RecordingFormatError(f"{self._place(name)}: must not be negative; got {value} {unit}")
        return value

    def positive(self, name: str, unit: str) -> float:
        """Return a number above zero."""
        value = self.number(name, unit)
        if not value > 0.0:
            raise RecordingFormatError(f"{self._place(name)}: expected a positive number; got {value} {unit}")
        return value

    def optional_positive(self, name: str, unit: str) -> float | None:
        """Return a number above zero, or None where nothing is stated."""
        return self.positive(name, unit) if name in self.values else None

    def count(self, name: str) -> int:
        """Return a whole number above zero."""
        value = self.positive(name, "-")
        if not value.is_integer():
            raise RecordingFormatError(f"{self._place(name)}: expected a whole number; got {value}")
        return int(value)

    def instant(self, name: str) -> datetime:
        """Return an RFC 3339 time with its zone (TOML has a type of its own for it)."""
        value = self.values.get(name)
        if isinstance(value, datetime):
            if value.tzinfo is not None:
                return value
            return parse_instant(value.isoformat(), self._place(name))
        return parse_instant(self.text(name), self._place(name))

    def word(self, name: str, words: Collection[str]) -> str:
        """Return one of some words."""
        text = self.text(name)
        if text not in words:
            listed = " or ".join(repr(str(word)) for word in words)
            raise RecordingFormatError(f"{self._place(name)}: expected {listed}; got {text!r}")
        return text

    def choice(self, name: str, kind: type[Choice]) -> Choice:
        """Return one of the words of an enumeration."""
        return kind(self.word(name, list(kind)))

    def optional_choice(self, name: str, kind: type[Choice]) -> Choice | None:
        """Return one of the words of an enumeration, or None where nothing is stated."""
        return self.choice(name, kind) if name in self.values else None

    def exactly(self, name: str, expected: str) -> None:
        """Refuse anything but one fixed text."""
        text = self.text(name)
        if text != expected:
            raise RecordingFormatError(f"{self._place(name)}: expected {expected!r}; got {text!r}")

    def require_format(self, name: str, version: int) -> None:
        """Refuse another format, or another version of it."""
        self.exactly("format", name)
        if (got := self.number("version", "-")) != version:
            raise RecordingFormatError(f"{self._place('version')}: expected {version}; got {got:g}")

    def table(self, name: str, known: AbstractSet[str] | None = None) -> "Fields":
        """Return the fields of a table inside this one, with no entries but those that are ``known``."""
        value = self._required(name, f"a table [{name}]")
        if not isinstance(value, dict):
            raise RecordingFormatError(f"{self._place(name)}: expected a table [{name}]; got {_shown(value)}")
        table = Fields(value, f"{self.where} [{name}]")
        if known is not None:
            table.only(known)
        return table

    def only(self, known: AbstractSet[str]) -> None:
        """Refuse a name that is not known: a slip of the pen would otherwise pass for *not stated*."""
        for name in self.values:
            if name not in known:
                raise RecordingFormatError(f"{self.where}: expected only {', '.join(sorted(known))}; got {name!r}")

    def _required(self, name: str, expected: str) -> object:
        if name not in self.values:
            raise RecordingFormatError(f"{self._place(name)}: expected {expected}; it is missing")
        return self.values[name]

    def _place(self, name: str) -> str:
        return f"{self.where}, {name}"


def _shown(value: object) -> str:
    plain = value.item() if isinstance(value, np.generic) else value
    text = repr(plain)
    return f"{type(plain).__name__} {text if len(text) <= 60 else text[:57] + '...'}"


def json_object(value: object, where: str) -> Fields:
    """Return the keys of a JSON object; null means the same as a key that is not there."""
    if not isinstance(value, dict):
        raise RecordingFormatError(f"{where}: expected a JSON object; got {type(value).__name__}")
    return Fields({key: entry for key, entry in value.items() if entry is not None}, where)


def json_table(fields: Fields, name: str) -> Fields:
    """Return the keys of an object inside another."""
    return json_object(fields.values.get(name), f"{fields.where}, {name}")


def json_list(fields: Fields, name: str) -> list[object]:
    """Return a list by its key."""
    value = fields.values.get(name)
    if not isinstance(value, list):
        raise RecordingFormatError(f"{fields.where}, {name}: expected a list; got {type(value).__name__}")
    return value


def json_numbers(values: object, n: int, place: str) -> list[float]:
    """Return so many finite numbers."""
    if not isinstance(values, list) or len(values) != n:
        raise RecordingFormatError(f"{place}: expected a list of {n} numbers; got {values!r:.60}")
    return [Fields({"item": value}, place).number("item", "SI") for value in values]
