"""The extended drive: one closed form for all families, to which effects can be added."""

from monitor_core.models.extended.lines import PreparedLines, ResponseCase, prepare_lines
from monitor_core.models.extended.model import ExtendedModel, paper_motor_end, physics_of
from monitor_core.models.extended.modes import natural_frequencies
from monitor_core.models.extended.physics import (
    AddedPhysics,
    AxisPhysics,
    AxisSetting,
    BodyPhysics,
    JointPhysics,
    ScrewBending,
    ScrewPhysics,
    moving_mass,
)
from monitor_core.models.extended.responses import responses
from monitor_core.models.extended.slopes import Move, log_response_slopes

__all__ = [
    "AddedPhysics",
    "AxisPhysics",
    "AxisSetting",
    "BodyPhysics",
    "ExtendedModel",
    "JointPhysics",
    "Move",
    "PreparedLines",
    "ResponseCase",
    "ScrewBending",
    "ScrewPhysics",
    "log_response_slopes",
    "moving_mass",
    "natural_frequencies",
    "paper_motor_end",
    "physics_of",
    "prepare_lines",
    "responses",
]
