"""The visible table of the effects of a rigid axis in motion, and a model with some of them."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

from monitor_core.effects.coulomb_friction import COULOMB_FRICTION
from monitor_core.effects.direction_dependent_friction import DIRECTION_DEPENDENT_FRICTION
from monitor_core.effects.effect import Effect
from monitor_core.effects.force_delay import FORCE_DELAY
from monitor_core.effects.force_offset import FORCE_OFFSET
from monitor_core.effects.force_scale import FORCE_SCALE
from monitor_core.effects.stribeck_friction import STRIBECK_FRICTION
from monitor_core.effects.viscous_friction import VISCOUS_FRICTION
from monitor_core.effects.wrong_parameter import stated_names, wrong_value
from monitor_core.errors import OutsideValidityError
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics

#: Keys as in FORMATS, section 6, and viscous friction for models that state none.
MOTION_EFFECTS: tuple[Effect[MotionPhysics], ...] = (
    COULOMB_FRICTION,
    FORCE_OFFSET,
    DIRECTION_DEPENDENT_FRICTION,
    STRIBECK_FRICTION,
    FORCE_DELAY,
    FORCE_SCALE,
    VISCOUS_FRICTION,
)


def with_motion_effects(
    model: MotionModel,
    values: Mapping[str, Mapping[str, float]],
    effects: Sequence[Effect[MotionPhysics]] = MOTION_EFFECTS,
) -> MotionModel:
    """Return the model with effects added, one after the other.

    Parameters
    ----------
    model : MotionModel
    values : mapping of str to mapping of str to float
        Values of the parameters by their names, by the keys of the effects: the ``[effects]`` of a model file. Every
        ``wrong-parameter:…`` is known without being in the table.
    effects : sequence of Effect
        The table: that of the product, or with a user's own.

    Raises
    ------
    OutsideValidityError
        If a key is unknown, or an effect refuses axis or values.
    """
    known = {effect.key: effect for effect in (*effects, *wrong_motion_parameters(model.parameters))}
    axis = model.physics
    for key, of_effect in values.items():
        if key not in known:
            raise OutsideValidityError(f"the key of an effect must be one of {', '.join(known)}; got {key!r}")
        axis = known[key].added_to(axis, of_effect)
    return replace(model, physics=axis)


def wrong_motion_parameter(name: str, parameters: MotionParameters) -> Effect[MotionPhysics]:
    """Return the effect that one parameter of a rigid axis has another value; as :func:`wrong_parameter`."""
    return wrong_value(name, parameters, _names(parameters), _carried_over)


def wrong_motion_parameters(parameters: MotionParameters) -> tuple[Effect[MotionPhysics], ...]:
    """Return the effect of each parameter that moves a force and is not zero."""
    return tuple(wrong_motion_parameter(name, parameters) for name in _names(parameters))


def _names(parameters: MotionParameters) -> dict[str, str]:
    """Leave out the lead: it makes a force of a measured torque and is no part of a prediction."""
    of_axis = {item.name for item in fields(MotionPhysics)}
    return {name: field for name, field in stated_names(parameters).items() if field in of_axis}


def _carried_over(declared: MotionParameters, true: MotionParameters, axis: MotionPhysics) -> MotionPhysics:
    before, after = MotionModel.of(declared).physics, MotionModel.of(true).physics
    return replace(
        axis,
        moving_mass=axis.moving_mass + (after.moving_mass - before.moving_mass),
        viscous_friction=axis.viscous_friction + (after.viscous_friction - before.viscous_friction),
    )
