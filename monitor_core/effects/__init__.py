"""Effects that an axis may have beyond its model.

Those of drives and of rigid axes in motion stand in a table each, ``drive_effects`` and ``motion_effects``; laws,
ports, units and wrong parameters are made for an axis.
"""

from monitor_core.effects.catalogue import (
    applicable_effects as applicable_effects,
    second_axis_at as second_axis_at,
    with_effects as with_effects,
)
from monitor_core.effects.drive_effects import DRIVE_EFFECTS as DRIVE_EFFECTS
from monitor_core.effects.effect import (
    ConditionAxis as ConditionAxis,
    Effect as Effect,
    EffectParameter as EffectParameter,
    sized_for as sized_for,
)
from monitor_core.effects.motion_effects import MOTION_EFFECTS as MOTION_EFFECTS
from monitor_core.effects.ports import (
    PORT_EFFECTS as PORT_EFFECTS,
    Port as Port,
    at_port as at_port,
    port_of as port_of,
)
from monitor_core.effects.sizes import MachineSizes as MachineSizes, Reference as Reference
from monitor_core.effects.variation import (
    Form as Form,
    Law as Law,
    Variable as Variable,
    Variation as Variation,
    varying as varying,
)
from monitor_core.effects.wrong_parameter import (
    PREFIX as PREFIX,
    stated_names as stated_names,
    wrong_motion_parameter as wrong_motion_parameter,
    wrong_motion_parameters as wrong_motion_parameters,
    wrong_parameter as wrong_parameter,
    wrong_parameters as wrong_parameters,
)
