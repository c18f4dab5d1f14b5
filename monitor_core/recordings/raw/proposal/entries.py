"""Write the entries of a channel map, each with a remark: as the file says, to confirm, or to fill in."""

from collections.abc import Iterator, Sequence

from monitor_core.recordings.elements.units import RAW_UNITS, Quantity, canonical_unit
from monitor_core.recordings.raw.channel_kind import ChannelKind, units_of
from monitor_core.recordings.raw.proposal.parts import Part

CONFIRM, FILL_IN = "# confirm:", "# fill in"
#: Usual sensitivities: how their unit is written, by what is measured and the raw unit.
_SENSITIVITY_UNITS = {
    Quantity.TORQUE: {"A": "N.m/A", "mA": "N.m/A", "V": "V/N.m", "mV": "mV/N.m"},
    Quantity.FORCE: {"A": "N/A", "mA": "N/A", "V": "mV/N", "mV": "mV/N"},
    Quantity.ACCELERATION: {"V": "mV/g", "mV": "mV/g"},
    Quantity.POSITION: {"V": "V/mm", "mV": "mV/mm"},
}


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


def entry(name: str, value: str, remark: str) -> str:
    """Return the line of an entry that has a value; a remark without a # is a plain comment."""
    return f"{f'{name} = {value}':<38} {remark if remark.startswith('#') else f'# {remark}'}"


def blank(name: str, remark: str) -> str:
    """Return the place of an entry that the file does not say: a comment, so that its absence is refused by name."""
    return f"{f'# {name} =':<38} {FILL_IN}: {remark}"


def channel_lines(part: Part | None, quantity: Quantity | None, parts: Sequence[Part]) -> Iterator[str]:
    """Return the entries of a channel: its name, its unit, and how a raw unit becomes the quantity."""
    kind = None if quantity is None else ChannelKind(str(quantity))
    if part is None:
        yield blank("channel", f"one of {', '.join(printed(other.channel.name) for other in parts[:6])}")
        yield blank("unit", choice_of_units(kind))
        return
    others = [other for other in parts if other.kind is part.kind and other is not part and part.kind is not None]
    also = f"; also {', '.join(printed(other.channel.name) for other in others[:4])}" if others else ""
    looks = f"{part.kind}-like" if part.kind is not None else "by its place in the file, no name or unit says it"
    yield entry("channel", printed(part.channel.name), f"{CONFIRM} {looks}{also}")
    if part.entry is not None:
        yield entry(part.entry, str(part.number), f"{CONFIRM} {part.entry} of the array, counted from 1")
    unit = part.unit if kind is None or part.unit in units_of(kind) else None
    if unit is None:
        got = f" (the file says {plain(part.channel.unit)})" if part.channel.unit else ""
        yield blank("unit", f"{choice_of_units(kind)}{got}")
        return
    in_file = canonical_unit(part.channel.unit) is not None
    yield entry("unit", printed(unit), "as the file says" if in_file else f"{CONFIRM} as the name of the channel says")
    if unit in RAW_UNITS:
        usual = None if quantity is None else _SENSITIVITY_UNITS[quantity].get(unit)
        yield blank("sensitivity", "how much of it is one unit of the quantity, or the other way round")
        if usual is None:
            yield blank("sensitivity_unit", f'such as "{unit}/N" or "N/{unit}"')
        else:
            yield entry("sensitivity_unit", printed(usual), f"{CONFIRM} unit of the sensitivity")


def choice_of_units(kind: ChannelKind | None) -> str:
    """Return the units that a channel of a kind may be in, as words to choose from."""
    if kind is None:
        return "what its numbers are in, such as N.m, N, V or A"
    return " | ".join(printed(unit) for unit in units_of(kind))
