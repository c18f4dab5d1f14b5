"""The effects that an axis may have beyond its model: one module each, and the tables of drives and of motions."""

from monitor_core.effects.catalogue import DRIVE_EFFECTS, applicable_effects, with_effects
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.effects.motion_catalogue import (
    MOTION_EFFECTS,
    with_motion_effects,
    wrong_motion_parameter,
    wrong_motion_parameters,
)
from monitor_core.effects.wrong_parameter import PREFIX, stated_names, wrong_parameter, wrong_parameters

__all__ = [
    "DRIVE_EFFECTS",
    "MOTION_EFFECTS",
    "PREFIX",
    "ConditionAxis",
    "Effect",
    "EffectParameter",
    "applicable_effects",
    "stated_names",
    "with_effects",
    "with_motion_effects",
    "wrong_motion_parameter",
    "wrong_motion_parameters",
    "wrong_parameter",
    "wrong_parameters",
]
