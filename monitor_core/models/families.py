"""List the families of drive models by their names in files, and build a model from a name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveModel
from monitor_core.models.published.hybrid import HybridModel, HybridParameters
from monitor_core.models.published.lumped import LumpedModel, LumpedParameters
from monitor_core.models.published.receptance import ReceptanceModel, ReceptanceParameters
from monitor_core.models.published.transmission_line import TransmissionLineModel, TransmissionLineParameters


@dataclass(frozen=True, slots=True)
class Family:
    """One way to predict an axis: its name in files, its record of parameters, its model."""

    name: str
    parameters: type[DriveParameters]
    model: Callable[[Any], DriveModel]  # takes that record


FAMILIES: tuple[Family, ...] = (
    Family("lumped", LumpedParameters, LumpedModel),  # Nguyen et al. (2018)
    Family("hybrid", HybridParameters, HybridModel),  # Sun et al. (2022)
    Family("receptance", ReceptanceParameters, ReceptanceModel),  # Tian et al.
    Family("transmission-line", TransmissionLineParameters, TransmissionLineModel),  # Moreno-Castaneda et al. (2005)
)


def family_named(name: str) -> Family:
    """Return a family by its name in files; OutsideValidityError if there is none."""
    for family in FAMILIES:
        if family.name == name:
            return family
    raise OutsideValidityError(f"family must be one of {', '.join(family.name for family in FAMILIES)}; got {name!r}")


def build_model(family: str, parameters: Mapping[str, float]) -> DriveModel:
    """Build a model from the name of its family and its parameters by their names in files.

    The family is ``lumped``, ``hybrid``, ``receptance`` or ``transmission-line``; the parameters are SI values by names
    that end with the unit, such as ``table_mass_kg``. ``OutsideValidityError`` if the family is unknown, a name is
    missing or not one of the family, or a value is out of range.

    Examples
    --------
    Where all but the bearing is rigid, the table is a mass of 23 kg on a spring of 1e8 N/m: √(k/m)/2π is 331.9 Hz.

    >>> import monitor_core as mc
    >>> rigid = {name: 1e18 for name in (
    ...     "youngs_modulus_pa", "shear_modulus_pa", "nut_stiffness_n_per_m", "coupling_stiffness_nm_per_rad")}
    >>> sizes = {"screw_length_m": 1.0, "screw_minor_diameter_m": 0.02, "screw_lead_m": 0.005}
    >>> masses = {"table_mass_kg": 20.0, "screw_mass_kg": 2.0, "nut_mass_kg": 1.0, "screw_inertia_kg_m2": 1e-4}
    >>> axis = mc.build_model("lumped", {**rigid, **sizes, **masses, "bearing_stiffness_n_per_m": 1e8})
    >>> modes = axis.natural_frequencies(mc.DriveConditions(position=0.5), mc.MotorEnd.CLAMPED)
    >>> round(modes[0].frequency, 1)
    331.9
    """
    named = family_named(family)
    return named.model(named.parameters.from_file_names(parameters, named.name))
