"""What a transmission-line model needs to know of an axis, and what follows from it for the lines."""

import math
from dataclasses import dataclass

from monitor_core.models.parameters import DriveParameters, transmission_ratio
from monitor_core.models.rod import axial_rigidity, torsional_rigidity


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmissionLineParameters(DriveParameters):
    """Axis of a transmission-line model.

    The shaft twists with ``screw_diameter`` and stretches with ``screw_minor_diameter``: the figures of [1]_ follow
    from 40 mm in torsion and 34.1 mm axially. There is no loss factor: it has no counterpart in the time domain, for
    which this family is made; damping is viscous.

    References
    ----------
    .. [1] V. Y. Moreno-Castaneda et al., LAMDAMAP 2005.
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
    def transmission_ratio(self) -> float:
        """Travel per radian in metres."""
        return transmission_ratio(self.screw_lead)

    @property
    def rotor_inertia(self) -> float:
        """Inertia that turns with the motor, in kg·m²."""
        return self.motor_inertia + self.coupling_inertia

    @property
    def torsional_rigidity(self) -> float:
        """GJ, J = πd⁴/32 with the outer diameter, in N·m²."""
        return torsional_rigidity(self.shear_modulus, self.screw_diameter)

    @property
    def axial_rigidity(self) -> float:
        """EA with the diameter that carries the load, in newtons."""
        return axial_rigidity(self.youngs_modulus, self.screw_minor_diameter)

    @property
    def torsional_speed(self) -> float:
        """Speed of torsional waves √(G/ρ), Eq. (11), in metres per second."""
        return math.sqrt(self.shear_modulus / self.density)

    @property
    def axial_speed(self) -> float:
        """Speed of axial waves √(E/ρ), Eq. (13), in metres per second."""
        return math.sqrt(self.youngs_modulus / self.density)
