r"""A declared parameter that is not what the file says.

The effect stands for building the family's model with another value p·exp(ln_ratio). What the model is made of, E S,
rotor inertia and so on, changes as it does between the two: a property of the screw by the ratio, since it is a product
of such parameters, and a joint or a body by the difference, since bodies and effects add to it. So wrong parameters
compose with each other and with effects to what the model would be with all of them, in any order.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial
from typing import TypeVar

from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics, BodyPhysics, JointPhysics, ScrewPhysics, physics_of
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics
from monitor_core.models.parameters import DriveParameters, name_in_file, unit_of

_Record = ScrewPhysics | JointPhysics | BodyPhysics
_Parameters = TypeVar("_Parameters", bound=DriveParameters)
_Physics = TypeVar("_Physics")
#: From declared and true parameters: the axis changed as the model changes between the two.
_CarriedOver = Callable[[_Parameters, _Parameters, _Physics], _Physics]

PREFIX = "wrong-parameter:"
#: Plausible |ln ratio| by unit: what is weighed or measured with a rule is misstated by less than a joint, whose
#: printed value may lack a power of ten. A pure number is like a joint.
_PLAUSIBLE = {"kg": 0.3, "kg·m²": 0.7, "m": 0.1, "Pa": 0.1, "kg/m³": 0.1}
_WIDE = 3.0
#: Beyond it any parameter is out of the range of its record.
_LARGEST_LN_RATIO = 200.0
#: A loss factor or another pure number cannot exceed what the parameters' record takes.
_HIGHEST_PURE_NUMBER = 0.9


def wrong_parameter(name: str, parameters: DriveParameters) -> Effect[AxisPhysics]:
    """Return the effect that one parameter of an axis has another value than declared.

    The name is as in files, such as ``bearing_stiffness_n_per_m``. The effect's own parameter is ``ln_ratio``, the
    logarithm of true over declared value; its range is that of a misprint, and what is tolerance is for the caller to
    say. ``OutsideValidityError`` if the axis does not state this parameter, or states it as zero, of which there is no
    ratio.
    """
    return _wrong_value(name, parameters, stated_names(parameters), _drive_carried_over)


def wrong_parameters(parameters: DriveParameters) -> tuple[Effect[AxisPhysics], ...]:
    """Return the effect of each parameter that an axis states and that is not zero."""
    return tuple(wrong_parameter(name, parameters) for name in stated_names(parameters))


def wrong_motion_parameter(name: str, parameters: MotionParameters) -> Effect[MotionPhysics]:
    """Return the effect that one parameter of a rigid axis has another value; as :func:`wrong_parameter`."""
    return _wrong_value(name, parameters, _motion_names(parameters), _motion_carried_over)


def wrong_motion_parameters(parameters: MotionParameters) -> tuple[Effect[MotionPhysics], ...]:
    """Return the effect of each parameter that moves a force and is not zero."""
    return tuple(wrong_motion_parameter(name, parameters) for name in _motion_names(parameters))


def stated_names(parameters: DriveParameters) -> dict[str, str]:
    """Return the fields that have a ratio, by their names in files."""
    values = parameters.to_file_names()
    names = {name_in_file(item.name): item.name for item in fields(parameters)}
    return {name: names[name] for name, value in values.items() if value > 0.0}


def _wrong_value(
    name: str,
    parameters: _Parameters,
    names: Mapping[str, str],
    carried_over: _CarriedOver[_Parameters, _Physics],
) -> Effect[_Physics]:
    """Return the effect that one parameter has another value; ``names`` are the fields of those that may be wrong."""
    if name not in names:
        raise OutsideValidityError(
            f"{PREFIX} must be followed by a parameter that the axis states and that is not zero: "
            f"{', '.join(names)}; got {name!r}"
        )
    field = names[name]
    value = getattr(parameters, field)
    lowest = highest = _PLAUSIBLE.get(unit_of(field), _WIDE)
    if unit_of(field) == "-":
        highest = min(highest, math.log(_HIGHEST_PURE_NUMBER / value))
    return Effect(
        key=f"{PREFIX}{name}",
        name=f"Wrong {name}",
        physics="The declared value is a misprint or another part was built in; it acts wherever the model uses it.",
        source="no source: the model's own equations with another value",
        parameters=(
            EffectParameter("ln_ratio", "-", lower=-lowest, upper=highest, scale=min(0.1, highest), beyond=False),
        ),
        add=partial(_add, parameters, field, carried_over),
        form_share=0.005,
    )


def _add(
    parameters: _Parameters,
    field: str,
    carried_over: _CarriedOver[_Parameters, _Physics],
    axis: _Physics,
    values: Mapping[str, float],
) -> _Physics:
    ln_ratio = values["ln_ratio"]
    if abs(ln_ratio) > _LARGEST_LN_RATIO:
        raise OutsideValidityError(f"ln_ratio must lie within ±{_LARGEST_LN_RATIO:g}; got {ln_ratio:g}")
    true = replace(parameters, **{field: getattr(parameters, field) * math.exp(ln_ratio)})
    return carried_over(parameters, true, axis)


def _drive_carried_over(
    declared_parameters: DriveParameters, true_parameters: DriveParameters, axis: AxisPhysics
) -> AxisPhysics:
    """Return the axis changed as the model changes from the declared to the true parameters."""
    declared, true = physics_of(declared_parameters), physics_of(true_parameters)
    screw = {name: getattr(axis.screw, name) * (new / old) for name, old, new in _differing(declared.screw, true.screw)}
    joints = {
        name: getattr(axis.joints, name) + (new - old) for name, old, new in _differing(declared.joints, true.joints)
    }
    bodies = {
        name: getattr(axis.bodies, name) + (new - old) for name, old, new in _differing(declared.bodies, true.bodies)
    }
    return replace(
        axis,
        screw=replace(axis.screw, **screw),
        joints=replace(axis.joints, **joints),
        bodies=replace(axis.bodies, **bodies),
    )


def _motion_names(parameters: MotionParameters) -> dict[str, str]:
    """Leave out the lead: it makes a force of a measured torque and is no part of a prediction."""
    of_axis = {item.name for item in fields(MotionPhysics)}
    return {name: field for name, field in stated_names(parameters).items() if field in of_axis}


def _motion_carried_over(declared: MotionParameters, true: MotionParameters, axis: MotionPhysics) -> MotionPhysics:
    old, new = MotionModel.of(declared).physics, MotionModel.of(true).physics
    return replace(
        axis,
        moving_mass=axis.moving_mass + (new.moving_mass - old.moving_mass),
        viscous_friction=axis.viscous_friction + (new.viscous_friction - old.viscous_friction),
    )


def _differing(declared: _Record, true: _Record) -> list[tuple[str, float, float]]:
    """Return name and both values of the fields in which two records of one kind differ."""
    pairs = ((item.name, getattr(declared, item.name), getattr(true, item.name)) for item in fields(declared))
    return [(name, old, new) for name, old, new in pairs if old != new]
