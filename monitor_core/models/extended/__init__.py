"""The extended drive: one closed form for all families, to which effects can be added."""

from monitor_core.models.extended.lines import (
    PreparedLines as PreparedLines,
    ResponseCase as ResponseCase,
    prepare_lines as prepare_lines,
)
from monitor_core.models.extended.model import (
    ExtendedModel as ExtendedModel,
    elastic_frequencies as elastic_frequencies,
    paper_motor_end as paper_motor_end,
    physics_of as physics_of,
)
from monitor_core.models.extended.modes import natural_frequencies as natural_frequencies
from monitor_core.models.extended.physics import (
    AddedPhysics as AddedPhysics,
    AxisPhysics as AxisPhysics,
    AxisSetting as AxisSetting,
    BodyPhysics as BodyPhysics,
    JointPhysics as JointPhysics,
    Move as Move,
    ScrewBending as ScrewBending,
    ScrewPhysics as ScrewPhysics,
    SecondAxis as SecondAxis,
    moving_mass as moving_mass,
)
from monitor_core.models.extended.responses import responses as responses
from monitor_core.models.extended.slopes import log_response_slopes as log_response_slopes
