"""The axis that measurements are compared with: what its description leaves to be adjusted, and by how much."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

from monitor_core.effects import DRIVE_EFFECTS, stated_names, with_effects, wrong_parameter
from monitor_core.effects.effect import Effect
from monitor_core.models.extended import AxisPhysics, ExtendedModel, physics_of
from monitor_core.models.parameters import DriveParameters, name_in_file, unit_of

#: Units of what is measured with a rule, or taken from a table of materials.
_OF_SHAPE = ("m", "Pa", "kg/m³")

Physics_co = TypeVar("Physics_co", covariant=True)


class Subject(Protocol[Physics_co]):
    """A described axis whose uncertain parameters may move within their tolerances."""

    @property
    def uncertain(self) -> Mapping[str, float]:
        """Standard deviation of ln(true/stated) of each parameter that may move, by its name in files."""
        ...

    def physics(self, ln_ratios: Mapping[str, float]) -> Physics_co:
        """Return the axis with these parameters moved; raises OutsideValidityError where there is none."""
        ...


@dataclass(frozen=True, eq=False)
class DriveSubject:
    """A drive of one of the families, with the effects its file already has."""

    stated: DriveParameters
    uncertain: Mapping[str, float]
    present: Mapping[str, Mapping[str, float]]  # effects of the file
    table: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS

    def physics(self, ln_ratios: Mapping[str, float]) -> AxisPhysics:
        """Return the axis with these parameters moved."""
        moved = self.parameters(ln_ratios)
        physics = physics_of(moved)
        if not self.present:
            return physics
        return with_effects(ExtendedModel(moved, physics), self.present, self.table).physics

    def parameters(self, ln_ratios: Mapping[str, float]) -> DriveParameters:
        """Return the stated parameters with some of them moved."""
        fields = {name_in_file(field): field for field in self.stated.__dataclass_fields__}
        changes = {
            fields[name]: getattr(self.stated, fields[name]) * math.exp(ratio)
            for name, ratio in ln_ratios.items()
            if ratio
        }
        return replace(self.stated, **changes)

    def candidates(self) -> tuple[Effect[AxisPhysics], ...]:
        """Return what this axis may lack: every effect of the table, every uncertain parameter beyond its tolerance.

        A description without any tolerance may be wrong in each of its parameters, but those of a plain shape: lengths,
        diameters and materials.
        """
        stated = stated_names(self.stated)
        names = self.uncertain or [name for name, field in stated.items() if unit_of(field) not in _OF_SHAPE]
        return (*self.table, *(wrong_parameter(name, self.stated) for name in names))
