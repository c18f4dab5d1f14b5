"""Read and write measured frequency responses of one axis under several conditions, ``*.frf.h5``.

Root attributes ``format`` = "preload-frf-set", ``version`` = 1. Each group ``/conditions/NNNN`` holds one response with
the noise of its lines (datasets ``frequency_hz``, ``response``, ``standard_deviation``) and the conditions it was
measured under; the attributes and their units are those of ``docs/reference/recordings.md``. What was excited and what
answers imply the unit of the response, so a wrong one is refused, never converted. Attributes that are not known here
are left alone.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import naming, refusing
from monitor_core.recordings.elements.hdf5 import attributes, column, numbered_groups, open_hdf5, write_attributes
from monitor_core.recordings.elements.units import (
    excitation_unit,
    is_response_unit,
    metres,
    response_unit,
    to_millimetres,
)

if TYPE_CHECKING:
    import h5py

_ABSOLUTE_ZERO = -273.15  # [°C]
_REAL = ("float64", "float32", "int64", "int32")  # frequencies are often whole numbers
_COMPLEX = ("complex128",)
TEMPERATURES = frozenset(("temperature_c", "temperature_delta_c"))
_LEVELS = {"N.m": "excitation_rms_nm", "N": "excitation_rms_n"}  # attribute of the excitation level, by its unit
_KNOWN_ATTRIBUTES = TEMPERATURES.union(
    _LEVELS.values(), ("input", "output", "response_unit", "position_mm", "preload_n", "payload_kg", "resolution_hz")
)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredResponse:
    """One condition of a set: the observation, and the temperature as stated with its deviation."""

    observation: FrequencyResponseObservation
    temperature: float | None = None  # of the axis [°C]; None: not stated

    def __post_init__(self) -> None:
        if self.temperature is not None and not _ABSOLUTE_ZERO < self.temperature < math.inf:
            raise OutsideValidityError(
                f"temperature must lie above {_ABSOLUTE_ZERO} °C and be finite; got {self.temperature} °C"
            )


def read_condition(group: "h5py.Group", where: str, reference: float | None) -> MeasuredResponse:
    """Read a condition; deviations are from the reference temperature where the set states none [°C]."""
    fields = attributes(group, _KNOWN_ATTRIBUTES, where)
    excitation = fields.choice("input", ExcitationPoint)
    response_point = fields.choice("output", ResponsePoint)
    if not is_response_unit(unit := fields.text("response_unit"), excitation, response_point):
        raise RecordingFormatError(
            f"{where}, response_unit: expected {response_unit(excitation, response_point)!r} for {response_point} per "
            f"{excitation}; got {unit!r}"
        )
    frequency, response, deviation = _read_lines(group, where)
    with naming(where):
        observation = FrequencyResponseObservation(
            _conditions(fields, excitation_unit(excitation), reference),
            frequency,
            response,
            deviation,
            excitation,
            response_point,
            fields.optional_number("resolution_hz", "Hz") or 0.0,
        )
        return MeasuredResponse(observation, fields.optional_number("temperature_c", "°C"))


def _conditions(fields: Fields, unit: str, reference: float | None) -> DriveConditions:
    level = _LEVELS[unit]
    for other in set(_LEVELS.values()) - {level}:
        if other in fields:
            raise RecordingFormatError(f"{fields.where}: expected {level} for an input in {unit}; got {other}")
    if reference is None:
        deviation = fields.optional_number("temperature_delta_c", "K") or 0.0
    else:
        deviation = fields.number("temperature_c", "°C") - reference
    return DriveConditions(
        position=metres(fields.number("position_mm", "mm")),
        preload=fields.optional_number("preload_n", "N"),
        payload_mass=fields.optional_number("payload_kg", "kg") or 0.0,
        temperature_deviation=deviation,
        excitation_level=fields.optional_number(level, unit) or 0.0,
    )


def _read_lines(group: "h5py.Group", where: str) -> tuple[FloatArray, ComplexArray, FloatArray]:
    names = {"frequency_hz": _REAL, "response": _COMPLEX, "standard_deviation": _REAL}
    columns = [column(group, name, where, types) for name, types in names.items()]
    if len({values.size for values in columns}) != 1:  # before any of them takes memory
        sizes = ", ".join(f"{values.size} in {name}" for name, values in zip(names, columns, strict=True))
        raise RecordingFormatError(f"{where}: expected as many values in each dataset; got {sizes}")
    frequency, deviation = (np.asarray(values.values(), dtype=np.float64) for values in columns[::2])
    response = np.asarray(columns[1].values(), dtype=np.complex128)
    _require(np.isfinite(frequency) & (frequency > 0.0), frequency, "positive, finite frequencies [Hz]", where)
    _require(np.diff(frequency, prepend=0.0) > 0.0, frequency, "rising frequencies [Hz]", where)
    _require(np.isfinite(response), response, "a finite response", where)
    _require(np.isfinite(deviation) & (deviation > 0.0), deviation, "positive, finite standard deviations", where)
    return frequency, response, deviation


def _require(fits: BoolArray, values: FloatArray | ComplexArray, expected: str, where: str) -> None:
    """Refuse a column by its first value that does not fit."""
    if not fits.all():
        i = int(np.argmin(fits))
        raise RecordingFormatError(f"{where}: expected {expected}; value {i + 1} of {fits.size} is {values[i]}")


def write_condition(group: "h5py.Group", measured: MeasuredResponse) -> None:
    """Write a condition into its empty group."""
    observation = measured.observation
    group["frequency_hz"] = observation.frequency
    group["response"] = observation.response
    group["standard_deviation"] = observation.standard_deviation
    conditions = observation.conditions
    stated = {
        "input": str(observation.excitation),
        "output": str(observation.response_point),
        "response_unit": response_unit(observation.excitation, observation.response_point),
        "position_mm": to_millimetres(conditions.position),
        "preload_n": conditions.preload,
        "payload_kg": conditions.payload_mass,
        "temperature_c": measured.temperature,
        "temperature_delta_c": conditions.temperature_deviation,
        _LEVELS[excitation_unit(observation.excitation)]: conditions.excitation_level
        or None,  # 0: small signals, no level
        "resolution_hz": observation.resolution or None,
    }
    write_attributes(group, stated)


FORMAT = "preload-frf-set"
VERSION = 1
_ROOT_ATTRIBUTES = frozenset(("format", "version"))


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponseSet:
    """Measured responses of one axis, in the order of the file."""

    measured: tuple[MeasuredResponse, ...]

    @property
    def observations(self) -> tuple[FrequencyResponseObservation, ...]:
        """What an identification takes."""
        return tuple(measured.observation for measured in self.measured)


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponseSetReader:
    """An open file; see :func:`open_frf_set`."""

    conditions: tuple[str, ...]  # names of the groups, in order
    _group: "h5py.Group"
    _where: str
    _reference: float | None  # temperature that deviations are from, where the set states none [°C]

    def measured(self, condition: str) -> MeasuredResponse:
        """Read one condition by the name of its group."""
        where = f"{self._where} /conditions/{condition}"
        with refusing(where, "a readable frequency response"):
            return read_condition(self._group[condition], where, self._reference)


@contextmanager
def open_frf_set(path: Path) -> Iterator[FrequencyResponseSetReader]:
    """Open an FRF set (``*.frf.h5``) and check its frame; a response is read when asked for, inside the ``with`` block.

    ``RecordingFormatError`` if the file is no such set: one sentence says what was expected, what was got, and where.
    """
    with open_hdf5(path) as file:
        with refusing(path.name, f"a {FORMAT} file"):
            reader = _set_reader(file, path.name)
        yield reader


def read_frf_set(path: Path) -> FrequencyResponseSet:
    """Read an FRF set in SI units; raises as :func:`open_frf_set`.

    Of what is not stated, the preload is None and the payload and the deviation from the reference temperature are 0;
    an excitation level that is not stated counts as small signals.
    """
    with open_frf_set(path) as reader:
        return FrequencyResponseSet(tuple(reader.measured(name) for name in reader.conditions))


def write_frf_set(
    path: Path, responses: FrequencyResponseSet, *, tolerances: Mapping[str, float | None] | None = None
) -> None:
    """Write an FRF set; the same set gives the same bytes, whenever it is written.

    The name is usually ``*.frf.h5``; an existing file is replaced. ``tolerances`` say how well settings are known, by
    the names of root attributes. ``RecordingFormatError`` if the set holds no
    response.
    """
    import h5py  # noqa: PLC0415  # file libraries are imported where they are needed

    if not responses.measured:
        raise RecordingFormatError(f"{path.name}: expected at least one condition; got none")
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION})
        write_attributes(file, tolerances or {})
        conditions = file.create_group("conditions")
        for number, measured in enumerate(responses.measured):
            write_condition(conditions.create_group(f"{number:04d}"), measured)


def _set_reader(file: "h5py.File", where: str) -> FrequencyResponseSetReader:
    root = attributes(file, _ROOT_ATTRIBUTES, f"{where} /")
    root.require_format(FORMAT, VERSION)
    conditions = numbered_groups(file, "conditions", 4, where)
    temperatures = conditions.stated(TEMPERATURES)
    if not temperatures:
        raise RecordingFormatError(f"{where}: expected at least one condition; got none")
    return FrequencyResponseSetReader(
        tuple(temperatures), conditions.folder, where, _reference_temperature(temperatures)
    )


def _reference_temperature(temperatures: Mapping[str, Fields]) -> float | None:
    """Return the temperature that deviations are from where none is stated: the mean of the set [°C].

    Which reference is taken is without meaning as long as it is one for all; a set that mixes its own with this is
    refused.
    """
    stated = [fields for fields in temperatures.values() if "temperature_c" in fields]
    alone = [fields for fields in stated if "temperature_delta_c" not in fields]
    values = [fields.number("temperature_c", "°C") for fields in stated]
    if not alone or len(set(values)) == 1:
        return None
    if len(alone) < len(temperatures):
        raise RecordingFormatError(
            f"{alone[0].where}, temperature_delta_c: expected a deviation from the reference [K], because the "
            f"temperatures of the set differ ({min(values):g} to {max(values):g} °C) and not all stand alone; it is "
            "missing"
        )
    return sum(values) / len(values)
