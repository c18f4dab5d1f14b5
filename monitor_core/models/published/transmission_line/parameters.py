"""Parameters of a transmission-line model, and the wave speeds that follow from them."""

import math
from dataclasses import dataclass

from monitor_core.models.ball_screw import BallScrew
from monitor_core.models.parameters import DriveParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmissionLineParameters(BallScrew, DriveParameters):
    """Axis of a transmission-line model.

    The shaft twists with ``screw_diameter`` and stretches with ``screw_minor_diameter``: the figures of
    Moreno-Castaneda et al. (2005) follow from 40 mm in torsion and 34.1 mm axially. There is no loss factor: it has no
    counterpart in the time domain, for which this family is made; damping is viscous.
    """

    table_mass: float
    screw_length: float
    screw_diameter: float
    screw_minor_diameter: float
    screw_lead: float
    youngs_modulus: float
    shear_modulus: float
    density: float
    motor_inertia: float
    coupling_stiffness: float
    bearing_stiffness: float
    nut_stiffness: float
    coupling_inertia: float = 0.0
    far_bearing_stiffness: float = 0.0
    bracket_stiffness: float = math.inf
    dynamic_load_rating: float | None = None
    bearing_damping: float = 0.0
    far_bearing_damping: float = 0.0
    nut_damping: float = 0.0
    coupling_damping: float = 0.0
    table_damping: float = 0.0
    motor_damping: float = 0.0

    @property
    def stretched_diameter(self) -> float:
        """Diameter that carries the load, in metres."""
        return self.screw_minor_diameter

    @property
    def torsional_speed(self) -> float:
        """Speed of torsional waves √(G/ρ), Eq. (11), in metres per second."""
        return math.sqrt(self.shear_modulus / self.density)

    @property
    def axial_speed(self) -> float:
        """Speed of axial waves √(E/ρ), Eq. (13), in metres per second."""
        return math.sqrt(self.youngs_modulus / self.density)
