"""Sentences that a page puts into its own language: an English text, and the values in it, each by its name."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from monitor_core.uncertainty import plus_minus


class Stated(float):
    """A number as somebody stated it, shown with all its digits."""


class Sentence(str):
    """A sentence that was written in English before, within another."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class PlusMinus:
    """A number with half of its interval, shown with two digits of that."""

    value: float
    half: float

    def __str__(self) -> str:
        return plus_minus(self.value, self.half)


Value = int | float | str | datetime | PlusMinus


@dataclass(frozen=True, slots=True)
class Said:
    """A sentence: its text, which is the key in the catalogues of languages, and the values in it."""

    text: str
    values: Mapping[str, Value] = field(default_factory=dict)


def N_(text: str) -> str:  # noqa: N802 - the name that tools for catalogues look for
    """Mark a text for the catalogue; it is translated where it is shown."""
    return text


def in_english(said: Said) -> str:
    """Write a sentence as programs get it."""
    return said.text % {name: _written(value) for name, value in said.values.items()}


def _written(value: Value) -> str:
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d}"
    if isinstance(value, Stated):
        return f"{value:.10g}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
