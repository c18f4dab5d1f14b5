"""Read named values of one place in a file (HDF5 attributes, a TOML table), each with its type and unit."""

import math
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import TypeVar

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.timestamps import parse_instant

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
        if any("\ud800" <= letter <= "\udfff" for letter in value):
            raise RecordingFormatError(f"{self._place(name)}: expected UTF-8 text; got {value[:40]!a}")
        return str(value)

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

    def choice(self, name: str, kind: type[Choice]) -> Choice:
        """Return one of the words of an enumeration."""
        text = self.text(name)
        try:
            return kind(text)
        except ValueError:
            words = " or ".join(repr(str(word)) for word in kind)
            raise RecordingFormatError(f"{self._place(name)}: expected {words}; got {text!r}") from None

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

    def table(self, name: str) -> "Fields":
        """Return the fields of a table inside this one."""
        value = self._required(name, f"a table [{name}]")
        if not isinstance(value, dict):
            raise RecordingFormatError(f"{self._place(name)}: expected a table [{name}]; got {_shown(value)}")
        return Fields(value, f"{self.where} [{name}]")

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
