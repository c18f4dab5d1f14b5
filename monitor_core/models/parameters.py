"""Define the parameters of the drive models: one vocabulary, and the base of the families' records.

The names are those of the model file without the unit that ends them there. ``PARAMETERS`` is the
vocabulary; a family's record picks from it, so that a quantity means the same in every family.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Self, TypeVar

from monitor_core.errors import OutsideValidityError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Record = TypeVar("_Record", bound="DataclassInstance")


@dataclass(frozen=True, slots=True)
class ParameterName:
    """One word of the vocabulary."""

    name: str
    suffix: str  # how its unit ends the name in a file
    unit: str
    meaning: str


PARAMETERS: tuple[ParameterName, ...] = (
    ParameterName("table_mass", "kg", "kg", "table with what is fixed to it"),
    ParameterName("screw_mass", "kg", "kg", "whole screw"),
    ParameterName("nut_mass", "kg", "kg", "nut"),
    ParameterName("screw_length", "m", "m", "between the bearings"),
    ParameterName("screw_diameter", "m", "m", "outer diameter"),
    ParameterName("screw_minor_diameter", "m", "m", "diameter that carries the load"),
    ParameterName("screw_lead", "m", "m", "travel per turn"),
    ParameterName("youngs_modulus", "pa", "Pa", "of the screw"),
    ParameterName("shear_modulus", "pa", "Pa", "of the screw"),
    ParameterName("density", "kg_per_m3", "kg/m³", "of the screw"),
    ParameterName("screw_inertia", "kg_m2", "kg·m²", "whole screw, about its axis"),
    ParameterName("motor_inertia", "kg_m2", "kg·m²", "rotor"),
    ParameterName("coupling_inertia", "kg_m2", "kg·m²", "coupling, on the side of the rotor"),
    ParameterName("bearing_stiffness", "n_per_m", "N/m", "fixed bearing, axial"),
    ParameterName("far_bearing_stiffness", "n_per_m", "N/m", "far bearing, axial; 0: it carries no axial load"),
    ParameterName("bracket_stiffness", "n_per_m", "N/m", "between nut and table; infinite where not stated"),
    ParameterName("nut_stiffness", "n_per_m", "N/m", "nut rigidity; with a dynamic load rating the catalogue's K"),
    ParameterName("dynamic_load_rating", "n", "N", "C_d; makes the nut rigidity follow the preload"),
    ParameterName("coupling_stiffness", "nm_per_rad", "N·m/rad", "coupling, torsional"),
    ParameterName("loss_factor", "", "-", "energy loss factor of the joints' springs"),
    ParameterName("bearing_damping", "ns_per_m", "N·s/m", "fixed bearing"),
    ParameterName("far_bearing_damping", "ns_per_m", "N·s/m", "far bearing"),
    ParameterName("nut_damping", "ns_per_m", "N·s/m", "nut"),
    ParameterName("coupling_damping", "nms_per_rad", "N·m·s/rad", "coupling"),
    ParameterName("table_damping", "ns_per_m", "N·s/m", "guides, viscous, to ground"),
    ParameterName("motor_damping", "nms_per_rad", "N·m·s/rad", "rotor, viscous, to ground"),
    ParameterName("screw_nut_segment_mass", "kg", "kg", "rigid piece of the screw inside the nut"),
    ParameterName("screw_nut_segment_inertia", "kg_m2", "kg·m²", "of that piece"),
    ParameterName("screw_motor_segment_inertia", "kg_m2", "kg·m²", "rigid piece of the screw before the coupling"),
    ParameterName("moving_mass", "kg", "kg", "of a rigid axis, with what its rotating parts add"),
    ParameterName("viscous_friction", "ns_per_m", "N·s/m", "of a rigid axis, guides and screw together"),
)
#: Beyond these no drive was meant, but a slip of the unit or of the keyboard.
_PLAUSIBLE = {"m": (1e-6, 1e3), "-": (0.0, 0.9)}
_ANY_SCALE = (1e-30, 1e30)
#: Of each field of a family's record its name, its default, whether it must be positive, and where it is plausible.
_Ranges = tuple[tuple[str, object, bool, tuple[float, float]], ...]
_RANGES: dict[type, _Ranges] = {}  # by family, filled when first asked for
_VOCABULARY = {word.name: word for word in PARAMETERS}


def name_in_file(name: str) -> str:
    """Return the name with its unit, as files have it: ``table_mass`` → ``table_mass_kg``."""
    word = _VOCABULARY[name]
    return f"{word.name}_{word.suffix}" if word.suffix else word.name


def unit_of(name: str) -> str:
    """Return the unit of a parameter."""
    return _VOCABULARY[name].unit


def fields_by_name(record: type["DriveParameters"]) -> dict[str, str]:
    """Return the fields of a family's record by their names in files."""
    return {name_in_file(item.name): item.name for item in fields(record)}


def transmission_ratio(screw_lead: float) -> float:
    """Return the travel per angle, lead/2π, in m/rad."""
    return screw_lead / (2.0 * math.pi)


def _after_value(name: str) -> str:
    unit = unit_of(name)
    return "" if unit == "-" else f" {unit}"


def _ranges(record: type["DriveParameters"]) -> _Ranges:
    if record not in _RANGES:
        _RANGES[record] = tuple(
            (
                item.name,
                item.default,
                item.default in (MISSING, math.inf),
                _PLAUSIBLE.get(unit_of(item.name), _ANY_SCALE),
            )
            for item in fields(record)
        )
    return _RANGES[record]


@cache
def _names_of_damping(record: type) -> tuple[str, ...]:
    return tuple(item.name for item in fields(record) if item.name.endswith(("_damping", "loss_factor")))


def scaled_damping(record: _Record, share: float) -> _Record:
    """Return a record of parameters with a share of each of its dampers and loss factors, itself if that is all."""
    return with_share_of(record, _names_of_damping(type(record)), share)


def with_share_of(record: _Record, names: Iterable[str], share: float) -> _Record:
    """Return a record with a share of each of some numbers, itself where that is the same."""
    changed = {name: share * value for name in names if (value := getattr(record, name))}
    return record if not changed or share == 1.0 else replace(record, **changed)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveParameters:
    """Base of the families' records: every field is a word of the vocabulary, finite and not negative.

    A field without a default must be stated and be positive; a default says what *not stated* means (no damping, no
    such part, a rigid bracket).
    """

    def __post_init__(self) -> None:
        for name, default, required, (lowest, highest) in _ranges(type(self)):
            value = getattr(self, name)
            if value is None or value == math.inf == default:
                continue
            if not math.isfinite(value) or value < 0.0 or (required and value == 0.0):
                expected = "positive and finite" if required else "finite and not negative"
                raise OutsideValidityError(f"{name_in_file(name)} must be {expected}; got {value}{_after_value(name)}")
            if value and not lowest <= value <= highest:
                raise OutsideValidityError(
                    f"{name_in_file(name)} must lie within {lowest:g} and {highest:g}{_after_value(name)}; "
                    f"got {value:g}"
                )

    @classmethod
    def from_file_names(cls, values: Mapping[str, float], family: str) -> Self:
        """Make the record from the names that a model file uses; a missing, unknown or impossible value is refused."""
        field_of = {name_in_file(item.name): item for item in fields(cls)}
        unknown = sorted(set(values) - set(field_of))
        if unknown:
            raise OutsideValidityError(
                f"a {family} model has no parameter {unknown[0]}; it has {', '.join(sorted(field_of))}"
            )
        missing = [name for name, item in field_of.items() if item.default is MISSING and name not in values]
        if missing:
            raise OutsideValidityError(f"a {family} model needs {', '.join(missing)}; the file does not state it")
        return cls(**{field_of[name].name: value for name, value in values.items()})

    def to_file_names(self) -> dict[str, float]:
        """Return what is stated, by the names that a model file uses."""
        stated = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            name_in_file(name): value for name, value in stated.items() if value is not None and math.isfinite(value)
        }
