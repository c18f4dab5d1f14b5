"""Model of a rigid axis in motion, as a file declares it."""

from dataclasses import dataclass
from typing import Self

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.motion.kinematics import Kinematics
from monitor_core.models.motion.physics import MotionPhysics, forces
from monitor_core.models.parameters import DriveParameters, transmission_ratio

#: By its name in files. It has no natural frequencies and is none of the drive families.
FAMILY = "motion"


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionParameters(DriveParameters):
    """What a file states of a rigid axis."""

    moving_mass: float  # with what the rotating parts add to it [kg]
    viscous_friction: float = 0.0  # [N·s/m]
    screw_lead: float | None = None  # where the record is of torque [m]

    def __post_init__(self) -> None:
        DriveParameters.__post_init__(self)
        if self.screw_lead == 0.0:
            raise OutsideValidityError("screw_lead_m must be positive and finite; got 0.0 m")

    def force_of_torque(self, torque: FloatArray) -> FloatArray:
        """Return the axial force F = 2πT/p of a motor torque, shape (n_samples,) [N]; the lead has to be stated."""
        if self.screw_lead is None:
            raise OutsideValidityError(
                "a motion record of torque needs screw_lead_m in the motion model to become a force; it is not stated"
            )
        return torque / transmission_ratio(self.screw_lead)


@dataclass(frozen=True, slots=True)
class MotionModel:
    """A rigid axis: what its file states, and what it is made of with the effects added to it."""

    parameters: MotionParameters
    physics: MotionPhysics

    @classmethod
    def of(cls, parameters: MotionParameters) -> Self:
        """Return the axis as stated, nothing added."""
        return cls(
            parameters,
            MotionPhysics(moving_mass=parameters.moving_mass, viscous_friction=parameters.viscous_friction),
        )

    def forces(self, motion: Kinematics) -> FloatArray:
        """Return the recorded motor force of a motion, shape (n_samples,) [N]; see :func:`forces`."""
        return forces(self.physics, motion)
