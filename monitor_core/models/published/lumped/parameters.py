"""Parameters of the lumped model: Table 1 of Nguyen et al. (2018) and what it leaves out."""

import math
from dataclasses import dataclass

from monitor_core.models.ball_screw import BallScrew
from monitor_core.models.parameters import DriveParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class LumpedParameters(BallScrew, DriveParameters):
    """Table 1 of the paper, and what it leaves out.

    The paper states neither shear modulus nor inertias of motor and coupling, nor any damping. Without a motor inertia
    a free motor end carries the inertia of the screw alone.
    """

    table_mass: float  # [kg]
    screw_mass: float  # [kg]
    nut_mass: float  # [kg]
    screw_inertia: float  # J_s [kg·m²]
    screw_length: float  # L [m]
    screw_minor_diameter: float  # [m]
    screw_lead: float  # l [m]
    youngs_modulus: float  # E [Pa]
    shear_modulus: float  # G [Pa]
    bearing_stiffness: float  # [N/m]
    bracket_stiffness: float = math.inf  # [N/m]
    nut_stiffness: float  # K of the catalogue, or the rigidity itself without a load rating [N/m]
    dynamic_load_rating: float | None = None  # C_d [N]
    coupling_stiffness: float  # [N·m/rad]
    motor_inertia: float = 0.0  # [kg·m²]
    coupling_inertia: float = 0.0  # [kg·m²]
    loss_factor: float = 0.0  # of the joints: bearing, bracket, nut, coupling [-]
    table_damping: float = 0.0  # [N·s/m]

    @property
    def stretched_diameter(self) -> float:
        """Minor diameter, which carries the load [m]."""
        return self.screw_minor_diameter

    @property
    def twisted_diameter(self) -> float:
        """Minor diameter, in torsion too, Eq. (3) [m]."""
        return self.screw_minor_diameter

    @property
    def mass_per_length(self) -> float:
        """Stated mass over length [kg/m]."""
        return self.screw_mass / self.screw_length

    @property
    def inertia_per_length(self) -> float:
        """J_s over length [kg·m]."""
        return self.screw_inertia / self.screw_length

    def moving_mass(self, payload_mass: float) -> float:
        """Return Σm of Eq. (6): table, screw, nut and payload [kg]."""
        return self.table_mass + self.screw_mass + self.nut_mass + payload_mass
