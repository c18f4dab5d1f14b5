"""Make an FRF set of raw files and their channel map: one response, under conditions of its own, from each file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.frf_set import FrequencyResponseSet, MeasuredResponse
from monitor_core.recordings.raw.channels import Channels, FrequencyResponse
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.mapping.doubts import require_place
from monitor_core.recordings.raw.mapping.imported import LeftOut, Progress, facts_of_file
from monitor_core.recordings.raw.mapping.map_records import ChannelMap, MappedChannel, ResponseLines, Tolerances
from monitor_core.recordings.raw.mapping.mapped import signal_of
from monitor_core.recordings.raw.mapping.stated_units import resolved_response, unknown_unit


@dataclass(frozen=True, slots=True, eq=False)
class ImportedFrfSet:
    """An FRF set of raw files, and what is to be said of it."""

    responses: FrequencyResponseSet
    left_out: tuple[LeftOut, ...] = ()
    remarks: tuple[str, ...] = ()
    tolerances: Tolerances = field(default_factory=Tolerances)


def import_frf_set(paths: Sequence[Path], channel_map: ChannelMap, progress: Progress | None = None) -> ImportedFrfSet:
    """Make an FRF set, one response of each file; lines at 0 Hz and below are left out.

    ``RecordingFormatError`` if the map is none of an FRF set, or files and map do not fit each other: a channel or a
    response that is not there, a unit that contradicts the file, columns of unequal length, lines that do not rise, a
    position that is not stated.
    """
    lines = channel_map.signals
    if not isinstance(lines, ResponseLines):
        names = ", ".join(path.name for path in paths)
        raise RecordingFormatError(f"{names}: expected a map of an FRF set; got one of a {channel_map.kind}")
    if not paths:
        raise RecordingFormatError("expected at least one raw file; got none")
    measured, left_out, remarks = [], list[LeftOut](), dict[str, None]()
    for path in paths:
        if progress is not None:
            progress(path.name)
        channels = read_channels(path, channel_map.text)
        response, left = _measured(path, channels, lines, channel_map)
        measured.append(response)
        left_out += left
        remarks |= dict.fromkeys(_unknown_units(channels, lines))
    return ImportedFrfSet(
        FrequencyResponseSet(_with_deviations(measured, paths)), tuple(left_out), tuple(remarks), channel_map.tolerances
    )


def _measured(
    path: Path, channels: Channels, lines: ResponseLines, channel_map: ChannelMap
) -> tuple[MeasuredResponse, list[LeftOut]]:
    facts = facts_of_file(path, channel_map)
    if facts.position is None:
        raise RecordingFormatError(f"{path.name} [window], position_mm: expected a number [mm]; it is missing")
    require_place(facts.position, path.name)
    frequency, response, deviation, factor = _read(channels, lines)
    above = frequency > 0.0
    left = []
    if not above.all():
        left.append(LeftOut(f"{np.sum(~above)} of {above.size} lines of {path.name}", "they are not above 0 Hz"))
    frequency, response = frequency[above], response[above]
    deviation = _deviation(lines, response, None if deviation is None else deviation[above], factor, path.name)
    with naming(path.name):
        conditions = DriveConditions(
            position=facts.position,
            preload=facts.preload,
            payload_mass=facts.payload_mass or 0.0,
            excitation_level=lines.excitation_level,
        )
        observation = FrequencyResponseObservation(
            conditions, frequency, response, deviation, lines.excitation, lines.response_point, lines.resolution
        )
        return MeasuredResponse(observation, facts.temperature), left


def _unknown_units(channels: Channels, lines: ResponseLines) -> Iterator[str]:
    for source in (lines.frequency, *(lines.parts or ()), lines.deviation):
        if source is not None:
            where = f"{channels.file_name}, {source.channel}"
            yield from unknown_unit(source.unit, channels.channel(source.channel).unit, where)
    if lines.response is not None:
        response, source = _response_named(channels, lines.response)
        for unit in (response.response_unit, response.reference_unit):
            yield from unknown_unit(source.unit, unit, f"{channels.file_name}, {response.name}")


def _read(channels: Channels, lines: ResponseLines) -> tuple[FloatArray, ComplexArray, FloatArray | None, float]:
    """Return frequency [Hz], response, its standard deviation where a column holds it, and the factor to SI."""
    if lines.response is not None:
        named, source = _response_named(channels, lines.response)
        response: ComplexArray = named.response * source.factor
        column = None if lines.deviation is None else _column(channels, lines.deviation)
        return np.asarray(named.frequency, dtype=np.float64), response, column, source.factor
    if lines.frequency is None or lines.parts is None:
        raise RecordingFormatError(f"{channels.file_name}: expected columns of a frequency response")
    sources = [lines.frequency, *lines.parts, *([] if lines.deviation is None else [lines.deviation])]
    columns = [_column(channels, source) for source in sources]
    if len({values.shape for values in columns}) > 1:
        got = ", ".join(f"{s.channel!r} {v.shape}" for s, v in zip(sources, columns, strict=True))
        raise RecordingFormatError(f"{channels.file_name}: expected channels of one length; got {got}")
    frequency, value, angle_or_imaginary, *deviation = columns
    if lines.polar and np.any(value < 0.0):
        raise RecordingFormatError(
            f"{channels.file_name}, {sources[1].channel}: expected magnitudes of 0 or above; line "
            f"{int(np.argmax(value < 0.0)) + 1} is below: "
            f'decibels are said as unit = "dB re 1 {sources[1].unit or "m/(N.s2)"}"'
        )
    whole: ComplexArray = value * np.exp(1j * angle_or_imaginary) if lines.polar else value + 1j * angle_or_imaginary
    _, first = signal_of(channels, lines.parts[0])
    return frequency, whole, deviation[0] if deviation else None, first.factor


def _column(channels: Channels, source: MappedChannel) -> FloatArray:
    signal, source = signal_of(channels, source)
    if signal.samples.ndim != 1:
        raise RecordingFormatError(
            f"{channels.file_name}, {signal.name}: expected one column; got an array of shape {signal.samples.shape}: "
            "row or column takes one of it"
        )
    samples: FloatArray = signal.samples.astype(np.float64)
    return source.factor * (10.0 ** (samples / 20.0) if source.in_decibels else samples)


def _response_named(channels: Channels, source: MappedChannel) -> tuple[FrequencyResponse, MappedChannel]:
    for response in channels.responses:
        if response.name == source.channel:
            return response, resolved_response(source, response, f"{channels.file_name}, {response.name}")
    there = ", ".join(repr(response.name) for response in channels.responses[:20]) or "none"
    raise RecordingFormatError(
        f"{channels.file_name}: expected a frequency response {source.channel!r}; the file has {there}"
    )


def _deviation(
    lines: ResponseLines, response: ComplexArray, column: FloatArray | None, factor: float, where: str
) -> FloatArray:
    if column is not None:
        return column
    if lines.standard_deviation is not None:
        return np.full(response.size, lines.standard_deviation * factor)
    deviation: FloatArray = (lines.relative_deviation or 0.0) * np.abs(response)
    if not np.all(deviation > 0.0):
        raise RecordingFormatError(
            f"{where}: expected a response other than 0 where its deviation is relative; line "
            f"{int(np.argmin(deviation)) + 1} is 0: state standard_deviation"
        )
    return deviation


def _with_deviations(measured: Sequence[MeasuredResponse], paths: Sequence[Path]) -> tuple[MeasuredResponse, ...]:
    """Count temperatures from the mean of the set, as the file does that states no reference."""
    stated = [m.temperature for m in measured if m.temperature is not None]
    if not stated or len(set(stated)) == 1:
        return tuple(measured)
    if len(stated) < len(measured):
        without = next(path.name for m, path in zip(measured, paths, strict=True) if m.temperature is None)
        raise RecordingFormatError(
            f"{without}: expected temperature_c, because other files of the set state different ones; it is missing"
        )
    reference = sum(stated) / len(stated)
    return tuple(
        replace(
            m,
            observation=replace(
                m.observation,
                conditions=replace(m.observation.conditions, temperature_deviation=(m.temperature or 0.0) - reference),
            ),
        )
        for m in measured
    )
