"""Generate recorded sessions from a drive model: moves of the table, modes, friction, sensors."""

from monitor_core.models.generator.moves import RampMoves as RampMoves
from monitor_core.models.generator.scan import GuideFriction as GuideFriction
from monitor_core.models.generator.session import (
    EXCITED as EXCITED,
    MOTOR_END as MOTOR_END,
    SimulationSettings as SimulationSettings,
    condition_grid as condition_grid,
    simulate_measurements as simulate_measurements,
    simulate_session as simulate_session,
)
