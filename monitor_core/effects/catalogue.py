"""The visible table of drive effects, and a model with some of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from monitor_core.effects.added_mass import ADDED_MASS
from monitor_core.effects.base_compliance import BASE_COMPLIANCE
from monitor_core.effects.cubic_stiffness import CUBIC_STIFFNESS
from monitor_core.effects.effect import Effect
from monitor_core.effects.far_bearing_stiffness import FAR_BEARING_STIFFNESS
from monitor_core.effects.guide_friction import GUIDE_FRICTION
from monitor_core.effects.guide_stiffness import GUIDE_STIFFNESS
from monitor_core.effects.loss_factor import LOSS_FACTOR
from monitor_core.effects.payload_mass import PAYLOAD_MASS
from monitor_core.effects.periodic_preload import PERIODIC_PRELOAD
from monitor_core.effects.position_offset import POSITION_OFFSET
from monitor_core.effects.preload_exponent import PRELOAD_EXPONENT
from monitor_core.effects.screw_axial_stiffness import SCREW_AXIAL_STIFFNESS
from monitor_core.effects.screw_distributed_mass import SCREW_DISTRIBUTED_MASS
from monitor_core.effects.second_mode import SECOND_MODE
from monitor_core.effects.sensor_mounting_resonance import SENSOR_MOUNTING_RESONANCE
from monitor_core.effects.series_compliance import SERIES_COMPLIANCE
from monitor_core.effects.servo_stiffness import SERVO_STIFFNESS
from monitor_core.effects.thermal_preload import THERMAL_PRELOAD
from monitor_core.effects.thermal_stiffness import THERMAL_STIFFNESS
from monitor_core.effects.torque_delay import TORQUE_DELAY
from monitor_core.effects.torsional_flexibility import (
    TORSIONAL_FLEXIBILITY,
    TORSIONAL_FLEXIBILITY_OF_LUMPED_INERTIA,
)
from monitor_core.effects.wrong_parameter import PREFIX, wrong_parameter
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics, ExtendedModel

#: Keys as in FORMATS, section 6. Two entries share one: which of them an axis can have depends on its inertia.
DRIVE_EFFECTS: tuple[Effect[AxisPhysics], ...] = (
    ADDED_MASS,
    PAYLOAD_MASS,
    SERIES_COMPLIANCE,
    FAR_BEARING_STIFFNESS,
    SCREW_AXIAL_STIFFNESS,
    SCREW_DISTRIBUTED_MASS,
    TORSIONAL_FLEXIBILITY,
    TORSIONAL_FLEXIBILITY_OF_LUMPED_INERTIA,
    LOSS_FACTOR,
    GUIDE_FRICTION,
    GUIDE_STIFFNESS,
    PRELOAD_EXPONENT,
    THERMAL_PRELOAD,
    THERMAL_STIFFNESS,
    POSITION_OFFSET,
    TORQUE_DELAY,
    SENSOR_MOUNTING_RESONANCE,
    BASE_COMPLIANCE,
    SERVO_STIFFNESS,
    PERIODIC_PRELOAD,
    CUBIC_STIFFNESS,
    SECOND_MODE,
)


def applicable_effects(
    axis: AxisPhysics, effects: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS
) -> tuple[Effect[AxisPhysics], ...]:
    """Return the effects that act on something an axis has.

    Raises
    ------
    OutsideValidityError
        If two of them have one key, so that a file could not tell which is meant.
    """
    applicable = tuple(effect for effect in effects if effect.applies(axis))
    keys = [effect.key for effect in applicable]
    for key in keys:
        if keys.count(key) > 1:
            raise OutsideValidityError(f"effects must have different keys; got {key} twice")
    return applicable


def with_effects(
    model: ExtendedModel,
    values: Mapping[str, Mapping[str, float]],
    effects: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS,
) -> ExtendedModel:
    """Return the model with effects added, one after the other.

    Parameters
    ----------
    model : ExtendedModel
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
    axis = model.physics
    for key, of_effect in values.items():
        axis = _effect_named(key, axis, model, effects).added_to(axis, of_effect)
    return replace(model, physics=axis)


def _effect_named(
    key: str, axis: AxisPhysics, model: ExtendedModel, effects: Sequence[Effect[AxisPhysics]]
) -> Effect[AxisPhysics]:
    """Return the effect of this key that applies; any of this key, which will say that it does not, if none does."""
    if key.startswith(PREFIX):
        return wrong_parameter(key.removeprefix(PREFIX), model.parameters)
    of_key = [effect for effect in effects if effect.key == key]
    if not of_key:
        known = ", ".join(dict.fromkeys(effect.key for effect in effects))
        raise OutsideValidityError(f"the key of an effect must be one of {known}, {PREFIX}<parameter>; got {key!r}")
    applicable = applicable_effects(axis, of_key)
    return applicable[0] if applicable else of_key[0]
