"""Read the table ``[frf]`` of a channel map: which columns are lines of a frequency response, and how well known."""

import math

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.units import excitation_unit, response_factor
from monitor_core.recordings.raw.mapping.map_entries import PLACE, inner_table, place_of
from monitor_core.recordings.raw.mapping.map_records import MappedChannel, ResponseLines

_DEGREE = {"deg": math.pi / 180.0, "rad": 1.0}


def response_lines(frf: Fields) -> ResponseLines:
    """Return where the lines of a response stand; raises RecordingFormatError where that is not said once."""
    excitation, point = frf.choice("input", ExcitationPoint), frf.choice("output", ResponsePoint)
    pairs = [pair for pair in (("real", "imaginary"), ("magnitude", "phase")) if pair[0] in frf or pair[1] in frf]
    ways = [*(" and ".join(pair) for pair in pairs), *(["response"] if "response" in frf else [])]
    if len(ways) != 1:
        raise RecordingFormatError(
            f"{frf.where}: expected real and imaginary, magnitude and phase, or response; got "
            f"{', '.join(ways) or 'none of them'}"
        )
    whole = None
    parts: tuple[MappedChannel, MappedChannel] | None = None
    if pairs:
        first, second = (inner_table(frf, name, PLACE | {"unit"}) for name in pairs[0])
        value = _quotient(first, excitation, point)
        parts = (value, _phase(second) if pairs[0][1] == "phase" else _quotient(second, excitation, point))
    else:
        whole = value = _quotient(inner_table(frf, "response", frozenset(("channel", "unit"))), excitation, point)
    if (whole is None) != ("frequency" in frf):
        missing = "it is missing" if whole is None else "it stands in the response of the file"
        raise RecordingFormatError(f"{frf.where}, frequency: expected where the lines stand, once; {missing}")
    level, other = ("excitation_rms_n", "excitation_rms_nm")[:: 1 if excitation_unit(excitation) == "N" else -1]
    if other in frf:
        raise RecordingFormatError(f"{frf.where}: expected {level} for {excitation}; got {other}")
    number, relative, column = _deviation(frf, value.factor, excitation, point)
    return ResponseLines(
        excitation,
        point,
        whole,
        _frequency(frf) if whole is None else None,
        parts,
        bool(pairs) and pairs[0][1] == "phase",
        number,
        relative,
        column,
        frf.positive("resolution_hz", "Hz") if "resolution_hz" in frf else 0.0,
        frf.positive(level, excitation_unit(excitation)) if level in frf else 0.0,
    )


def _deviation(
    frf: Fields, factor: float, excitation: ExcitationPoint, point: ResponsePoint
) -> tuple[float | None, float | None, MappedChannel | None]:
    """Return the noise of the lines in one of three ways: a number, a part of the magnitude, or a column."""
    stated = [name for name in ("standard_deviation", "relative") if name in frf]
    if len(stated) != 1:
        raise RecordingFormatError(
            f"{frf.where}: expected standard_deviation or relative, how well the lines are known; got "
            f"{' and '.join(stated) or 'neither'}"
        )
    if stated == ["relative"]:
        return None, frf.positive("relative", "-"), None
    if isinstance(frf.values["standard_deviation"], dict):
        return None, None, _quotient(inner_table(frf, "standard_deviation", PLACE | {"unit"}), excitation, point)
    return frf.positive("standard_deviation", "unit of the response") * factor, None, None


def _quotient(fields: Fields, excitation: ExcitationPoint, point: ResponsePoint) -> MappedChannel:
    unit = fields.text("unit")
    row, column = place_of(fields)
    factor = response_factor(unit, excitation, point, f"{fields.where}, unit")
    return MappedChannel(fields.text("channel"), unit, factor, row=row, column=column)


def _phase(fields: Fields) -> MappedChannel:
    unit = fields.text("unit")
    if unit not in _DEGREE:
        raise RecordingFormatError(f"{fields.where}, unit: expected 'deg' or 'rad'; got {unit!r}")
    row, column = place_of(fields)
    return MappedChannel(fields.text("channel"), unit, _DEGREE[unit], row=row, column=column)


def _frequency(frf: Fields) -> MappedChannel:
    fields = inner_table(frf, "frequency", PLACE | {"unit"})
    unit = fields.text("unit")
    if unit not in ("Hz", "kHz"):
        raise RecordingFormatError(f"{fields.where}, unit: expected 'Hz' or 'kHz'; got {unit!r}")
    row, column = place_of(fields)
    return MappedChannel(fields.text("channel"), unit, 1.0 if unit == "Hz" else 1e3, row=row, column=column)
