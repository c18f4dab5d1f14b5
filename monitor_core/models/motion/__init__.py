"""Predict the motor force of a rigid axis in motion from its mass and friction, as a controller records it."""

from monitor_core.models.motion.kinematics import Kinematics, cutoff_frequency, kinematics_of
from monitor_core.models.motion.model import FAMILY, MotionModel, MotionParameters, MotionPhysics, forces

__all__ = [
    "FAMILY",
    "Kinematics",
    "MotionModel",
    "MotionParameters",
    "MotionPhysics",
    "cutoff_frequency",
    "forces",
    "kinematics_of",
]
