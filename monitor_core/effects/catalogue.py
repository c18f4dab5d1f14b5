"""Which effects apply to an axis, and a model with some of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from monitor_core.effects.drive_effects import DRIVE_EFFECTS
from monitor_core.effects.effect import Effect
from monitor_core.effects.motion_effects import MOTION_EFFECTS
from monitor_core.effects.wrong_parameter import PREFIX, wrong_motion_parameter, wrong_parameter
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import ExtendedModel
from monitor_core.models.motion import MotionModel

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
    is known without being in it. ``OutsideValidityError`` if a key is unknown, or an effect refuses axis or values.
    """
    if effects is None:
        effects = MOTION_EFFECTS if isinstance(model, MotionModel) else DRIVE_EFFECTS
    axis: Any = model.physics
    for key, of_effect in values.items():
        axis = _effect_named(key, axis, model, effects).added_to(axis, of_effect)
    return replace(model, physics=axis)


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
