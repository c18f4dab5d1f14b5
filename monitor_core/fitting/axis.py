"""Describe an axis: family, parameters, what a fit may adjust and by how much, and effects that it already has."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Protocol, TypeVar

from monitor_core.effects import (
    DRIVE_EFFECTS,
    MOTION_EFFECTS,
    PREFIX,
    Effect,
    MachineSizes,
    sized_for,
    stated_names,
    with_effects,
    wrong_motion_parameters,
    wrong_parameter,
)
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.models.extended import AxisPhysics, ExtendedModel, physics_of
from monitor_core.models.families import FAMILIES, build_model
from monitor_core.models.motion import FAMILY as MOTION, MotionModel, MotionParameters, MotionPhysics
from monitor_core.models.parameters import DriveParameters, name_in_file, unit_of
from monitor_core.models.protocol import DriveModel

#: Units of what is measured with a rule, or taken from a table of materials.
_OF_SHAPE = ("m", "Pa", "kg/m³")

Physics_co = TypeVar("Physics_co", covariant=True)
Parameters = TypeVar("Parameters", bound=DriveParameters)
Physics = TypeVar("Physics")


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

        Ranges of effects are multiples of the sizes of the axis as it was measured. An effect that the file states at
        its null values is known to be absent.

        A description without any tolerance may be wrong in each of its parameters, but those of a plain shape: lengths,
        diameters and materials.
        """
        stated = stated_names(self.stated)
        names = self.uncertain or [name for name, field in stated.items() if unit_of(field) not in _OF_SHAPE]
        sought = _not_stated_absent(self.table, self.present)
        return (*sized_for(sought, sizes), *(wrong_parameter(name, self.stated) for name in names))


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

        Ranges of effects are multiples of the sizes of the motion; what is stated at its null values is absent.
        """
        sought = _not_stated_absent(self.table, self.present)
        return (*sized_for(sought, sizes), *wrong_motion_parameters(self.stated))


def _not_stated_absent(
    table: Sequence[Effect[Physics]], present: Mapping[str, Mapping[str, float]]
) -> list[Effect[Physics]]:
    return [effect for effect in table if present.get(effect.key) != effect.null_values()]


def moved(stated: Parameters, ln_ratios: Mapping[str, float]) -> Parameters:
    """Return stated parameters with some of them moved, by ln(moved/stated) and their names in files."""
    names = {name_in_file(item.name): item.name for item in fields(stated)}
    changes = {
        names[name]: getattr(stated, names[name]) * math.exp(ratio) for name, ratio in ln_ratios.items() if ratio
    }
    return replace(stated, **changes)


_Observation = TypeVar("_Observation", ModalObservation, FrequencyResponseObservation)

#: The parameter by which a nut follows its preload.
_RATING = "dynamic_load_rating_n"


@dataclass(frozen=True, slots=True)
class AxisDescription:
    """What a model file states, by the names of the file."""

    family: str
    parameters: Mapping[str, float]  # SI, by names that end with the unit
    uncertain: Mapping[str, float] = field(default_factory=dict)  # relative standard deviation [-]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # by key; values by names with units
    simulation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # of sessions without a machine

    @property
    def nut_follows_preload(self) -> bool:
        """Whether the rigidity of the nut follows from the preload."""
        return _RATING in self.parameters

    def build(self, effects: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS) -> DriveModel:
        """Return the model: that of the family, or with effects the extended drive with them added in their order.

        ``effects`` says what the keys may mean: the table of the product, or with a user's own.
        ``OutsideValidityError`` if an effect is unknown, or does not fit the axis or its values; if it is a motion
        model, which has no frequency response; or as :func:`build_model` says.
        """
        if self.family == MOTION:
            raise OutsideValidityError(
                "expected a drive with natural frequencies, of the family "
                f"{', '.join(family.name for family in FAMILIES)}; got a motion model, which is a rigid axis"
            )
        family_model = build_model(self.family, self.parameters)
        if not self.effects:
            return family_model
        return with_effects(ExtendedModel.of(family_model.parameters), self.effects, effects)

    def build_motion(self, effects: Sequence[Effect[MotionPhysics]] = MOTION_EFFECTS) -> MotionModel:
        """Return the rigid axis of a motion model, with its effects added in their order.

        ``effects`` says what the keys may mean: the table of the product, or with a user's own.
        ``OutsideValidityError`` if an effect is unknown, or does not fit the axis or its values; or if it is the model
        of a drive.
        """
        if self.family != MOTION:
            raise OutsideValidityError(f"expected a model of the family {MOTION}; got one of {self.family}")
        stated = MotionParameters.from_file_names(self.parameters, self.family)
        return with_effects(MotionModel.of(stated), self.effects, effects)

    def drive(self, effects: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS) -> DescribedDrive:
        """Return the drive with what may be adjusted; raises as :meth:`build`."""
        self.build(effects)  # so that its effects are sound
        corrected = self.with_corrected_parameters()
        return DescribedDrive(corrected.build(effects).parameters, corrected.uncertain, corrected.effects, effects)

    def rigid_axis(self, effects: Sequence[Effect[MotionPhysics]] = MOTION_EFFECTS) -> DescribedRigidAxis:
        """Return the rigid axis with what may be adjusted; raises as :meth:`build_motion`."""
        self.build_motion(effects)  # so that its effects are sound
        corrected = self.with_corrected_parameters()
        stated = corrected.build_motion(effects).parameters
        return DescribedRigidAxis(stated, corrected.uncertain, corrected.effects, effects)

    def with_corrected_parameters(self) -> "AxisDescription":
        """Return the same axis, one that can be built, with its ``wrong-parameter:`` effects gone into its parameters.

        Such a parameter can then be called wrong once more.
        """
        wrong = {key.removeprefix(PREFIX): values for key, values in self.effects.items() if key.startswith(PREFIX)}
        return replace(
            self,
            parameters={
                name: value * math.exp(wrong[name]["ln_ratio"]) if name in wrong else value
                for name, value in self.parameters.items()
            },
            effects={key: values for key, values in self.effects.items() if not key.startswith(PREFIX)},
        )


def at_preload_of_nut(observations: Sequence[_Observation], axis: AxisDescription) -> tuple[_Observation, ...]:
    """Leave out a preload that all share where the nut does not follow it: its rigidity is that at this preload.

    Raises OutsideValidityError if the preload varies: a nut of one rigidity cannot follow it.
    """
    preloads = {observation.conditions.preload for observation in observations}
    if axis.nut_follows_preload or preloads <= {None}:
        return tuple(observations)
    if len(preloads) > 1:
        rising = sorted(preloads, key=lambda preload: preload or 0.0)
        listed = ", ".join("none stated" if preload is None else f"{preload:g} N" for preload in rising)
        raise OutsideValidityError(
            f"a model without {_RATING} has the nut rigidity of one preload; got measurements at {listed}: "
            "state the rating"
        )
    return tuple(replace(each, conditions=replace(each.conditions, preload=None)) for each in observations)
