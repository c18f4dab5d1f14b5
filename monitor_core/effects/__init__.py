"""Effects that an axis may have beyond its model.

Those of drives and of rigid axes in motion stand in a table each, ``drive_effects`` and ``motion_effects``; laws,
ports, units and wrong parameters are made for an axis.
"""

from monitor_core.effects.catalogue import applicable_effects, with_effects
from monitor_core.effects.drive_effects import DRIVE_EFFECTS
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, sized_for
from monitor_core.effects.motion_effects import MOTION_EFFECTS
from monitor_core.effects.ports import PORT_EFFECTS, Port, at_port, port_of
from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.effects.variation import Form, Law, Variable, Variation, varying
from monitor_core.effects.wrong_parameter import (
    PREFIX,
    stated_names,
    wrong_motion_parameter,
    wrong_motion_parameters,
    wrong_parameter,
    wrong_parameters,
)

__all__ = [
    "DRIVE_EFFECTS",
    "MOTION_EFFECTS",
    "PORT_EFFECTS",
    "PREFIX",
    "ConditionAxis",
    "Effect",
    "EffectParameter",
    "Form",
    "Law",
    "MachineSizes",
    "Port",
    "Reference",
    "Variable",
    "Variation",
    "applicable_effects",
    "at_port",
    "port_of",
    "sized_for",
    "stated_names",
    "varying",
    "with_effects",
    "wrong_motion_parameter",
    "wrong_motion_parameters",
    "wrong_parameter",
    "wrong_parameters",
]
