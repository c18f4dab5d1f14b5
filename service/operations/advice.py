"""Explain codes of states, causes, refusals and doubts, and list what to check, with tool and minutes.

The table is ``advice.toml`` in this folder. A file of the plant (``PRELOAD_ADVICE_FILE``) has the same form: its rows
come first, since who knows the machine knows better; its ``says`` takes the place of the table's.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from service.errors import DataFolderError, first_refusal

TABLE = Path(__file__).parent / "advice.toml"

Section = Literal["cause", "state", "refusal", "doubt", "uncharted"]
Words = Annotated[str, Field(min_length=1, max_length=300)]


class Look(BaseModel):
    """Something to check: what may be the cause, what it does to the reading, and how to find out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cause: Words
    effect: Words
    check: Words
    tool: Words
    minutes: int = Field(ge=1, le=600)


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    says: Words | None = None
    look: tuple[Look, ...] = ()


@dataclass(frozen=True, slots=True)
class Advice:
    """What a code means in plain words, and what to check, the likeliest first."""

    section: Section
    code: str
    says: str
    look: tuple[Look, ...]
    n_own: int  # so many rows, the first ones, are of the plant's own file


_TABLES: TypeAdapter[dict[Section, dict[str, _Entry]]] = TypeAdapter(dict[Section, dict[str, _Entry]])


@dataclass(frozen=True, slots=True)
class AdviceTable:
    """All advice, by section and code; see :func:`read_advice`."""

    entries: Mapping[tuple[Section, str], Advice]

    def of(self, section: Section, code: str) -> Advice | None:
        """Return what is known of a code, None where nothing is."""
        return self.entries.get((section, code))


def read_advice(own: Path | None) -> AdviceTable:
    """Return the table of the product with the rows of a file of the plant, where there is one.

    Raises DataFolderError, with one sentence, if that file cannot be read, says something else, or names a code that
    is not in the table.
    """
    entries = {(section, code): entry for section, codes in _read(TABLE).items() for code, entry in codes.items()}
    added: dict[tuple[Section, str], _Entry] = {}
    for section, codes in ({} if own is None else _read(own)).items():
        for code, entry in codes.items():
            if (section, code) not in entries:
                codes_of_section = ", ".join(name for place, name in entries if place == section)
                raise DataFolderError(f"the advice in {own}: expected a {section} of {codes_of_section}; got {code}")
            added[section, code] = entry
    return AdviceTable({key: _joined(key, entry, added.get(key, _Entry())) for key, entry in entries.items()})


def _joined(key: tuple[Section, str], entry: _Entry, own: _Entry) -> Advice:
    says = own.says or entry.says
    if says is None:
        raise DataFolderError(f"the advice in {TABLE}: {'.'.join(key)} says nothing")
    return Advice(*key, says, (*own.look, *entry.look), len(own.look))


def _read(path: Path) -> dict[Section, dict[str, _Entry]]:
    try:
        return _TABLES.validate_python(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataFolderError(f"the advice in {path} cannot be read: {error}") from error
    except ValidationError as error:
        raise DataFolderError(f"the advice in {path}: {first_refusal(error, shows_input=False)}") from error
