"""The axis that measurements are compared with: what its description leaves to be adjusted, and by how much."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Protocol, TypeVar

from monitor_core.effects import (
    DRIVE_EFFECTS,
    MOTION_EFFECTS,
    Effect,
    MachineSizes,
    sized_for,
    stated_names,
    with_effects,
    wrong_motion_parameters,
    wrong_parameter,
)
from monitor_core.models.extended import AxisPhysics, ExtendedModel, physics_of
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics
from monitor_core.models.parameters import DriveParameters, name_in_file, unit_of

#: Units of what is measured with a rule, or taken from a table of materials.
_OF_SHAPE = ("m", "Pa", "kg/m³")

Physics_co = TypeVar("Physics_co", covariant=True)
Parameters = TypeVar("Parameters", bound=DriveParameters)


class DescribedAxis(Protocol[Physics_co]):
    """A described axis whose uncertain parameters may move within their tolerances."""

    @property
    def uncertain(self) -> Mapping[str, float]:
        """Standard deviation of ln(true/stated) of each parameter that may move, by its name in files."""
        ...

    def physics(self, ln_ratios: Mapping[str, float]) -> Physics_co:
        """Return the axis with these parameters moved; raises OutsideValidityError where there is none."""
        ...


@dataclass(frozen=True, eq=False)
class DescribedDrive:
    """A drive of one of the families, with the effects its file already has."""

    stated: DriveParameters
    uncertain: Mapping[str, float]
    present: Mapping[str, Mapping[str, float]]  # effects of the file
    table: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS

    def physics(self, ln_ratios: Mapping[str, float]) -> AxisPhysics:
        """Return the axis with these parameters moved."""
        return _physics_of(self, tuple(ln_ratios.items()))

    def candidates(self, sizes: MachineSizes) -> tuple[Effect[AxisPhysics], ...]:
        """Return what this axis may lack: every effect of the table, every uncertain parameter beyond its tolerance.

        Ranges of effects are multiples of the sizes of the axis as it was measured.

        A description without any tolerance may be wrong in each of its parameters, but those of a plain shape: lengths,
        diameters and materials.
        """
        stated = stated_names(self.stated)
        names = self.uncertain or [name for name, field in stated.items() if unit_of(field) not in _OF_SHAPE]
        return (*sized_for(self.table, sizes), *(wrong_parameter(name, self.stated) for name in names))


@lru_cache(maxsize=32)
def _physics_of(drive: DescribedDrive, ln_ratios: tuple[tuple[str, float], ...]) -> AxisPhysics:
    """Return the axis with these parameters moved: a search asks again and again while it moves effects alone."""
    parameters = moved(drive.stated, dict(ln_ratios))
    physics = physics_of(parameters)
    if not drive.present:
        return physics
    return with_effects(ExtendedModel(parameters, physics), drive.present, drive.table).physics


@dataclass(frozen=True, eq=False)
class DescribedRigidAxis:
    """A rigid axis in motion, with the effects its file already has."""

    stated: MotionParameters
    uncertain: Mapping[str, float]
    present: Mapping[str, Mapping[str, float]]  # effects of the file
    table: Sequence[Effect[MotionPhysics]] = MOTION_EFFECTS

    def physics(self, ln_ratios: Mapping[str, float]) -> MotionPhysics:
        """Return the axis with these parameters moved."""
        return with_effects(MotionModel.of(moved(self.stated, ln_ratios)), self.present, self.table).physics

    def candidates(self, sizes: MachineSizes) -> tuple[Effect[MotionPhysics], ...]:
        """Return what this axis may lack: every effect of the table, and every stated parameter being wrong.

        Ranges of effects are multiples of the sizes of the motion.
        """
        return (*sized_for(self.table, sizes), *wrong_motion_parameters(self.stated))


def moved(stated: Parameters, ln_ratios: Mapping[str, float]) -> Parameters:
    """Return stated parameters with some of them moved, by ln(moved/stated) and their names in files."""
    names = {name_in_file(item.name): item.name for item in fields(stated)}
    changes = {
        names[name]: getattr(stated, names[name]) * math.exp(ratio) for name, ratio in ln_ratios.items() if ratio
    }
    return replace(stated, **changes)
