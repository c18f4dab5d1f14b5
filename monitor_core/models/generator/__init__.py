"""Generate recorded sessions from a drive model: moves of the table, modes, friction, sensors."""

from monitor_core.models.generator.motion import (
    RecordedMotion as RecordedMotion,
    channels_of_motion as channels_of_motion,
    simulate_motion as simulate_motion,
    windows_of_motion as windows_of_motion,
)
from monitor_core.models.generator.moves import RampMoves as RampMoves
from monitor_core.models.generator.scan import GuideFriction as GuideFriction
from monitor_core.models.generator.session import (
    EXCITED as EXCITED,
    MOTOR_END as MOTOR_END,
    WINDOW_SPACING as WINDOW_SPACING,
    SimulationSettings as SimulationSettings,
    condition_grid as condition_grid,
    simulate_measurements as simulate_measurements,
    simulate_session as simulate_session,
)
from monitor_core.models.generator.stated import (
    StatedSimulation as StatedSimulation,
    stated_simulation as stated_simulation,
)
