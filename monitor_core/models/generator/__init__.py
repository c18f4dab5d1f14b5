"""Generate recorded sessions from a drive model: moves of the table, modes, friction, sensors."""

from monitor_core.models.generator.moves import RampMoves
from monitor_core.models.generator.scan import GuideFriction
from monitor_core.models.generator.session import (
    EXCITED,
    MOTOR_END,
    SimulationSettings,
    condition_grid,
    simulate_measurements,
    simulate_session,
)

__all__ = [
    "EXCITED",
    "MOTOR_END",
    "GuideFriction",
    "RampMoves",
    "SimulationSettings",
    "condition_grid",
    "simulate_measurements",
    "simulate_session",
]
