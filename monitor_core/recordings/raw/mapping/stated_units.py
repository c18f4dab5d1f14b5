"""Compare what a file states of its numbers with what the map says, before any of them is used.

A file states a unit as a property of a channel, in a row of units, as the label of an axis, or in the name of the
channel: "Acc [g]", "torque_nm". Every channel and every frequency response passes here, whatever its format.
"""

from collections.abc import Sequence
from dataclasses import replace

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import (
    FACTOR_TO_SI,
    Quantity,
    Unit,
    canonical_unit,
    is_raw,
    unit_of,
)
from monitor_core.recordings.raw.channel_kind import unit_in_name
from monitor_core.recordings.raw.channels import Channel, FrequencyResponse
from monitor_core.recordings.raw.mapping.map_records import MappedChannel

#: What a map says of numbers in such a unit.
_ADVICE = {
    "%": ': unit = "%" takes the rated value as sensitivity, with sensitivity_unit = "N.m/100%"',
    "dB": ': decibels of a frequency response are said as unit = "dB re 1 m/(N.s2)"',
}


def resolved(source: MappedChannel, channel: Channel, where: str) -> MappedChannel:
    """Return what the map says of a channel, with the unit of the file where the map leaves it to that.

    ``RecordingFormatError`` if file and map contradict each other, or if neither states the unit.
    """
    source = _with_unit(source, agreed_unit(channel.unit, unit_in_name(channel.name), _said(source), where), where)
    _require_measured(channel.measures if unit_of(channel.unit) is None else None, source, where)
    return source


def unknown_unit(in_map: str, of_file: str | None, where: str) -> tuple[str, ...]:
    """Say of a unit of the file that it is none known here, so that nothing holds it against that of the map."""
    unknown = in_map and any(map(str.isalpha, of_file or "")) and unit_of(of_file) is None
    said = f"{where}: the file says {of_file!r}, which is no unit known here; {in_map!r} of the map is used"
    return (said,) if unknown else ()


def resolved_response(source: MappedChannel, response: FrequencyResponse, where: str) -> MappedChannel:
    """Return the same of a frequency response, whose file states what answers and what it is divided by."""
    above, below = response.response_unit, response.reference_unit
    stated = None
    if unit_of(above) is not None and unit_of(below) is not None:
        stated = f"({above})/({below})"
    elif unit_of(above) is not None:
        stated = _quotient_of(str(above), unit_of(source.unit))
    source = _with_unit(source, agreed_unit(stated, unit_in_name(response.name), _said(source), where), where)
    _require_measured(response.measures if stated is None else None, source, where)
    return source


def _require_measured(measures: str | None, source: MappedChannel, where: str) -> None:
    """Refuse a unit of another quantity than the file names, where it names no unit; a raw unit says none."""
    named, said = unit_of(measures), unit_of(source.unit)
    if named is not None and said is not None and named.powers != said.powers and not is_raw(source.unit):
        raise RecordingFormatError(
            f"{where}: expected {source.unit!r} as the map says; the file says that it is a quantity in {measures!r}"
        )


def agreed_unit(of_file: str | None, of_name: str | None, in_map: str, where: str) -> str:
    """Return the unit that file and map agree on; texts that are no unit known here say nothing.

    Parameters
    ----------
    of_file, of_name : str or None
        Unit that the file states of the channel, and that its name does.
    in_map : str
        Unit of the map; empty where the map leaves it to the file.
    where : str
        File and channel, for messages.

    Returns
    -------
    str
        The unit of the map, or else of the file.

    Raises
    ------
    RecordingFormatError
        If two of them are different units, or if none is stated. A name says nothing where file and map agree.

    """
    unit, named, said = unit_of(of_file), unit_of(of_name), unit_of(in_map)
    if unit is not None and said is not None and unit.is_same(said):
        return in_map
    if unit is not None and named is not None and unit.powers == named.powers and not unit.is_same(named):
        raise RecordingFormatError(f"{where}: expected one unit; the file says {of_file!r}, and the name {of_name!r}")
    stated, who = (of_file, "the file says") if unit is not None else (of_name, "its name says")
    unit = unit or named
    if in_map:
        if unit is not None and (said is None or not unit.is_same(said)):
            advice = _ADVICE.get(canonical_unit(stated) or "", "")
            raise RecordingFormatError(f"{where}: expected {in_map!r} as the map says; {who} {stated!r}{advice}")
        return in_map
    if stated is None or unit is None:
        got = f"the file says {of_file!r}, which is no unit known here" if of_file else "neither file nor map states it"
        raise RecordingFormatError(f"{where}: expected unit, what the numbers are in; {got}")
    return stated


def _said(source: MappedChannel) -> str:
    return "dB" if source.in_decibels else source.unit


def _with_unit(source: MappedChannel, unit: str, where: str) -> MappedChannel:
    return source if source.unit else replace(source, unit=unit, factor=source.convert(unit, where=f"{where}, unit"))


def _quotient_of(above: str, said: Unit | None) -> str:
    """Return the quotient that a file means which states what answers alone: that of the map, if it can be one."""
    driven: Sequence[str] = [*FACTOR_TO_SI[Quantity.FORCE], *FACTOR_TO_SI[Quantity.TORQUE]]
    quotients = [f"({above})/({below})" for below in driven if below != "kgf"]  # g by kgf is m/s² by N
    units = {text: unit_of(text) for text in (above, *quotients)}
    return next((text for text, unit in units.items() if unit and said and unit.is_same(said)), quotients[0])
