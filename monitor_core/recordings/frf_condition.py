"""Read and write one condition of an FRF set: the response, its noise, the conditions it was measured under."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.elements.hdf5 import attributes, column, values_of, write_attributes
from monitor_core.recordings.elements.response_units import excitation_unit, is_response_unit, response_unit
from monitor_core.recordings.elements.units import metres, to_millimetres

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
    frequency, deviation = (np.asarray(values_of(values), dtype=np.float64) for values in columns[::2])
    response = np.asarray(values_of(columns[1]), dtype=np.complex128)
    _require(np.isfinite(frequency) & (frequency > 0.0), frequency, "positive, finite frequencies [Hz]", where)
    _require(np.diff(frequency, prepend=0.0) > 0.0, frequency, "rising frequencies [Hz]", where)
    _require(np.isfinite(response), response, "a finite response", where)
    _require(np.isfinite(deviation) & (deviation > 0.0), deviation, "positive, finite standard deviations", where)
    return frequency, response, deviation


def _require(fits: BoolArray, values: FloatArray | ComplexArray, expected: str, where: str) -> None:
    """Refuse a column by its first value that does not fit."""
    if not fits.all():
        first = int(np.argmin(fits))
        raise RecordingFormatError(f"{where}: expected {expected}; value {first + 1} of {fits.size} is {values[first]}")


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
