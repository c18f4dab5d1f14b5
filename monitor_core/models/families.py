"""The families of drive models, by their names in files: one visible table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from monitor_core.errors import OutsideValidityError
from monitor_core.models.hybrid import HybridModel, HybridParameters
from monitor_core.models.lumped import LumpedModel, LumpedParameters
from monitor_core.models.protocol import DriveModel
from monitor_core.models.receptance import ReceptanceModel, ReceptanceParameters
from monitor_core.models.transmission_line import TransmissionLineModel, TransmissionLineParameters

Parameters = TypeVar("Parameters", LumpedParameters, HybridParameters, ReceptanceParameters, TransmissionLineParameters)


@dataclass(frozen=True, slots=True)
class Family(Generic[Parameters]):
    """One way to predict an axis."""

    name: str
    parameters: type[Parameters]
    model: Callable[[Parameters], DriveModel]

    def read(self, values: Mapping[str, float]) -> Parameters:
        """Return the record of parameters from their names in files, with units.

        Raises
        ------
        OutsideValidityError
            If a name is missing or not one of this family, or a value is out of range.
        """
        return self.parameters.from_file_names(values, self.name)

    def build(self, values: Mapping[str, float]) -> DriveModel:
        """Return a model with these parameters; raises as :meth:`read`."""
        return self.model(self.read(values))


# Nguyen et al. (2018), Sun et al. (2022), Tian et al., Moreno-Castaneda et al. (2005)
LUMPED = Family("lumped", LumpedParameters, LumpedModel)
HYBRID = Family("hybrid", HybridParameters, HybridModel)
RECEPTANCE = Family("receptance", ReceptanceParameters, ReceptanceModel)
TRANSMISSION_LINE = Family("transmission-line", TransmissionLineParameters, TransmissionLineModel)

AnyFamily = (
    Family[LumpedParameters]
    | Family[HybridParameters]
    | Family[ReceptanceParameters]
    | Family[TransmissionLineParameters]
)
FAMILIES: tuple[AnyFamily, ...] = (LUMPED, HYBRID, RECEPTANCE, TRANSMISSION_LINE)


def family_named(name: str) -> AnyFamily:
    """Return a family by its name in files.

    Raises
    ------
    OutsideValidityError
        If there is none of this name.
    """
    for family in FAMILIES:
        if family.name == name:
            return family
    raise OutsideValidityError(f"family must be one of {', '.join(family.name for family in FAMILIES)}; got {name!r}")


def build_model(family: str, parameters: Mapping[str, float]) -> DriveModel:
    """Build a model from the name of its family and its parameters by their names in files.

    Parameters
    ----------
    family : str
        ``lumped``, ``hybrid``, ``receptance`` or ``transmission-line``.
    parameters : mapping of str to float
        SI values by names that end with the unit, such as ``table_mass_kg``.

    Returns
    -------
    DriveModel
        Of that family.

    Raises
    ------
    OutsideValidityError
        If the family is unknown, a name is missing or not one of the family, or a value is out of range.
    """
    return family_named(family).build(parameters)
