"""A servo that holds the rotor like a spring."""

from collections.abc import Mapping

from monitor_core.effects.changes import changed_added
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.models.extended import AxisPhysics


def _add(axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
    return changed_added(axis, servo_stiffness=axis.added.servo_stiffness + values["stiffness_nm_per_rad"])


SERVO_STIFFNESS = Effect(
    key="servo-stiffness",
    name="Stiffness of the servo",
    physics=(
        "The position loop answers an angle of the rotor with a torque, seen as a spring to ground. The drive no "
        "longer turns freely; seen where the rotor takes part."
    ),
    source="no source: a proportional position loop",
    parameters=(EffectParameter("stiffness_nm_per_rad", "N·m/rad", lower=0.0, upper=1e5, scale=10.0),),
    add=_add,
)
