"""The proposal of a channel map as a record: its entries, with what is known of each; TOML is one way to print it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from monitor_core.recordings.elements.units import Quantity, canonical_unit, is_raw, quantity_of_unit
from monitor_core.recordings.raw.channel_kind import units_of
from monitor_core.recordings.raw.proposal.parts import Part

#: Usual sensitivities: how their unit is written, by what is measured and the raw unit.
_SENSITIVITY_UNITS = {
    Quantity.TORQUE: {"A": "N.m/A", "mA": "N.m/A", "V": "V/N.m", "mV": "mV/N.m", "%": "N.m/100%"},
    Quantity.CURRENT: {"V": "V/A", "mV": "mV/A", "%": "A/100%"},
    Quantity.FORCE: {"A": "N/A", "mA": "N/A", "V": "mV/N", "mV": "mV/N"},
    Quantity.ANGLE: {"count": "count/rev", "V": "V/rev", "mV": "mV/rev"},
    Quantity.SPEED: {"V": "V/(rev/min)", "mV": "mV/(rev/min)"},
    Quantity.ACCELERATION: {"V": "mV/g", "mV": "mV/g"},
    Quantity.POSITION: {
        "V": "V/mm",
        "mV": "mV/mm",
        "count": "nm/count",
        "deg": "mm/rev",
        "rad": "mm/rev",
        "rev": "mm/rev",
    },
}


class Mark(StrEnum):
    """What is known of the value of an entry; the word is that of the printed map."""

    STATED = ""  # by the file
    CONFIRM = "confirm"  # read from names, units and shapes
    FILL_IN = "fill in"  # the file does not say it
    OPTIONAL = "optional"  # may be left out; the value is an example


@dataclass(frozen=True, slots=True)
class MapEntry:
    """An entry of a proposed map."""

    name: str
    value: str  # a text without its quotes, or a number as TOML writes it; empty where it is to be filled in
    remark: str
    mark: Mark = Mark.CONFIRM
    is_text: bool = True


@dataclass(frozen=True, slots=True)
class MapTable:
    """A table of a proposed map; the first has no name."""

    name: str
    lines: tuple[MapEntry | str, ...]  # a text is a comment
    remark: str = ""
    above: str = ""  # a comment above its name
    optional: bool = False  # all of it is an example: its name, too, is printed as a comment

    @property
    def entries(self) -> tuple[MapEntry, ...]:
        """The entries, without the comments between them."""
        return tuple(line for line in self.lines if isinstance(line, MapEntry))


@dataclass(frozen=True, slots=True)
class MapProposal:
    """A channel map for a raw file, to look through and to fill in."""

    in_file: tuple[str, ...]  # what the file holds, a line each
    tables: tuple[MapTable, ...]
    file_name: str

    @property
    def n_places(self) -> int:
        """How many entries are to be filled in."""
        return sum(entry.mark is Mark.FILL_IN for table in self.tables for entry in table.entries)

    @property
    def asks_for_start(self) -> bool:
        """Whether neither channels nor texts of times say when the file begins."""
        return any(entry.name == "started_at" for table in self.tables for entry in table.entries)

    def for_axis(self, axis_id: str) -> "MapProposal":
        """Return the proposal with a name of the axis that is known, in place of the name of the file."""
        first, *others = self.tables
        entry = MapEntry("axis_id", axis_id, "", Mark.STATED)
        return replace(self, tables=(replace(first, lines=(entry,)), *others))

    def toml(self) -> str:
        """Print it: what is missing stands as a comment, so that its absence is refused by name."""
        lines = [
            f"# What the channels of {plain(self.file_name)} mean, proposed by `preload check`.",
            f'# Lines marked "{Mark.FILL_IN}": the file does not say it; take the # in front away and write the value.',
            f'# Lines marked "{Mark.CONFIRM}": read from names, units and shapes; look whether they are right.',
            "#",
            "# In the file:",
            *(f"#   {line}" for line in self.in_file),
        ]
        for table in self.tables:
            if "." not in table.name:
                lines.append("")
            if table.above:
                lines.append(f"# {table.above}")
            if table.name:
                name = f"{'# ' if table.optional else ''}[{table.name}]"
                lines.append(f"{name:<38} # {table.remark}" if table.remark else name)
            lines += [f"# {line}" if isinstance(line, str) else _printed_entry(line) for line in table.lines]
        return "\n".join(lines) + "\n"


def _printed_entry(entry: MapEntry) -> str:
    is_comment = entry.mark in (Mark.FILL_IN, Mark.OPTIONAL)
    value = "" if entry.mark is Mark.FILL_IN else f" {printed(entry.value) if entry.is_text else entry.value}"
    stated = f"{'# ' if is_comment else ''}{entry.name} ={value}"
    remark = f"{entry.mark}: {entry.remark}" if entry.mark else entry.remark
    return f"{stated:<38} # {remark}" if remark else stated


def printed(text: str) -> str:
    """Return a text as TOML writes it, with everything escaped that would move a cursor or hide letters."""
    escaped = "".join(f"\\{letter}" if letter in '"\\' else _escaped(letter) for letter in text)
    return f'"{escaped}"'


def _escaped(letter: str) -> str:
    if letter.isprintable():
        return letter
    code = ord(letter)
    return f"\\u{code:04X}" if code < 0x10000 else f"\\U{code:08X}"


def plain(text: str) -> str:
    """Return a text for a comment, which ends with its line."""
    return "".join(_escaped(letter) for letter in text)


def missing(name: str, remark: str) -> MapEntry:
    """Return an entry that the file does not say."""
    return MapEntry(name, "", remark, Mark.FILL_IN, is_text=False)


def number(name: str, value: str, remark: str, mark: Mark = Mark.CONFIRM) -> MapEntry:
    """Return an entry whose value is a number, as it is to be written."""
    return MapEntry(name, value, remark, mark, is_text=False)


def channel_entries(part: Part | None, quantity: Quantity | None, parts: Sequence[Part]) -> Iterator[MapEntry]:
    """Yield the entries of a channel: its name, its unit, and how a raw unit becomes the quantity."""
    if part is None:
        yield missing("channel", f"one of {', '.join(printed(other.channel.name) for other in parts[:6])}")
        yield missing("unit", choice_of_units(quantity))
        return
    others = [other for other in parts if other.kind is part.kind and other is not part and part.kind is not None]
    also = f"; also {', '.join(printed(other.channel.name) for other in others[:4])}" if others else ""
    looks = f"{part.kind}-like" if part.kind is not None else "by its place in the file, no name or unit says it"
    yield from place_entries(part, f"{looks}{also}")
    unit = part.unit if quantity is None or part.unit in units_of(quantity) else None
    if unit is None:
        got = f" (the file says {plain(part.channel.unit)})" if part.channel.unit else ""
        yield missing("unit", f"{choice_of_units(quantity)}{got}")
        return
    if canonical_unit(part.channel.unit) is not None:
        yield MapEntry("unit", unit, "as the file says", Mark.STATED)
    else:
        yield MapEntry("unit", unit, "as the name of the channel says")
    if is_raw(unit) and quantity_of_unit(unit) is not quantity:
        usual = None if quantity is None else _SENSITIVITY_UNITS[quantity].get(unit)
        of_what = "rated value, that of 100 %" if unit == "%" else "how much of it is one unit of the quantity"
        yield missing("sensitivity", f"{of_what}{'' if unit == '%' else ', or the other way round'}")
        if usual is None:
            yield missing("sensitivity_unit", f'such as "{unit}/N" or "N/{unit}"')
        else:
            yield MapEntry("sensitivity_unit", usual, "unit of the sensitivity")


def place_entries(part: Part, remark: str) -> Iterator[MapEntry]:
    """Yield where the numbers of a channel stand: its name, and the row or column of an array."""
    yield MapEntry("channel", part.channel.name, remark)
    if part.entry is not None:
        yield number(part.entry, str(part.number), f"{part.entry} of the array, counted from 1")


def choice_of_units(quantity: Quantity | None) -> str:
    """Return the units that a channel of a quantity may be in, as words to choose from."""
    if quantity is None:
        return "what its numbers are in, such as N.m, N, V or A"
    return " | ".join(printed(unit) for unit in units_of(quantity))
