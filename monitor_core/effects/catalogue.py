"""Which effects apply to an axis, and a model with some of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from monitor_core.effects.drive_effects import DRIVE_EFFECTS
from monitor_core.effects.effect import Effect
from monitor_core.effects.motion_effects import MOTION_EFFECTS
from monitor_core.effects.wrong_parameter import PREFIX, wrong_motion_parameter, wrong_parameter
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics, ExtendedModel, SecondAxis, physics_of
from monitor_core.models.motion import MotionModel
from monitor_core.models.protocol import DriveModel
from monitor_core.models.published.receptance import ReceptanceParameters

#: A second axis that stands on the table of the described one, and one whose table that one stands on.
CARRIED_AXIS, CARRYING_AXIS = "carried-axis", "carrying-axis"
#: What a file states of a stack of two axes, beside the parameters of the second one.
OF_STACK = {
    "position_m": "position",
    "direction_cosine": "direction_cosine",
    "yaw_stiffness_nm_per_rad": "yaw_stiffness",
    "yaw_damping_nms_per_rad": "yaw_damping",
    "yaw_inertia_kg_m2": "yaw_inertia",
    "lower_offset_m": "lower_offset",
    "upper_offset_m": "upper_offset",
    "upper_centre_m": "upper_centre",
}

Physics = TypeVar("Physics")
Model = TypeVar("Model", ExtendedModel, MotionModel)


def applicable_effects(axis: Physics, effects: Sequence[Effect[Physics]]) -> tuple[Effect[Physics], ...]:
    """Return the effects that act on something an axis has.

    ``OutsideValidityError`` if two of them have one key, so that a file could not tell which is meant.
    """
    applicable = tuple(effect for effect in effects if effect.applies(axis))
    keys = [effect.key for effect in applicable]
    for key in keys:
        if keys.count(key) > 1:
            raise OutsideValidityError(f"effects must have different keys; got {key} twice")
    return applicable


def with_effects(
    model: Model, values: Mapping[str, Mapping[str, float]], effects: Sequence[Effect[Any]] | None = None
) -> Model:
    """Return the extended or motion model with effects added, one after the other.

    The values of parameters, by their names, stand under the keys of the effects, as in ``[effects]`` of a model file.
    The table of effects is that of the product for such a model, or one with a user's own; every ``wrong-parameter:…``
    and a second axis are known without being in it. ``OutsideValidityError`` if a key is unknown, or an effect refuses
    axis or values.
    """
    if effects is None:
        effects = MOTION_EFFECTS if isinstance(model, MotionModel) else DRIVE_EFFECTS
    axis: Any = model.physics
    for key, of_effect in values.items():
        if key in (CARRIED_AXIS, CARRYING_AXIS) and isinstance(model, ExtendedModel):
            axis = _with_second_axis(axis, key, of_effect)
        else:
            axis = _effect_named(key, axis, model, effects).added_to(axis, of_effect)
    return replace(model, physics=axis)


def _with_second_axis(axis: AxisPhysics, key: str, values: Mapping[str, float]) -> AxisPhysics:
    """Return an axis stacked with a second one of the receptance family."""
    try:
        if axis.second is not None or "position_m" not in values:
            raise OutsideValidityError("expected one second axis, with its position_m")
        own = {name: value for name, value in values.items() if name not in OF_STACK}
        second = SecondAxis(
            physics=physics_of(ReceptanceParameters.from_file_names(own, "receptance")),
            carried=key == CARRIED_AXIS,
            **{OF_STACK[name]: value for name, value in values.items() if name in OF_STACK},
        )
        return replace(axis, second=second)
    except OutsideValidityError as error:
        raise OutsideValidityError(f"the effect {key}: {error}") from error


def second_axis_at(model: DriveModel, position: float) -> ExtendedModel:
    """Return a model with the table of its second axis elsewhere; ``OutsideValidityError`` if it states none."""
    if not isinstance(model, ExtendedModel) or model.physics.second is None:
        raise OutsideValidityError(f"a second axis at {position} m needs a model that states one; this one does not")
    second = replace(model.physics.second, position=position)
    return replace(model, physics=replace(model.physics, second=second))


def _effect_named(
    key: str, axis: object, model: ExtendedModel | MotionModel, effects: Sequence[Effect[Any]]
) -> Effect[Any]:
    """Return the effect of this key that applies; any of this key, which will say that it does not, if none does."""
    if key.startswith(PREFIX):
        name = key.removeprefix(PREFIX)
        if isinstance(model, MotionModel):
            return wrong_motion_parameter(name, model.parameters)
        return wrong_parameter(name, model.parameters)
    of_key = [effect for effect in effects if effect.key == key]
    if not of_key:
        keys = ", ".join(dict.fromkeys(effect.key for effect in effects))
        raise OutsideValidityError(f"the key of an effect must be one of {keys}, {PREFIX}<parameter>; got {key!r}")
    applicable = applicable_effects(axis, of_key)
    return applicable[0] if applicable else of_key[0]
