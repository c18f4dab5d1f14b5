"""Derive quantities of a ball screw from its stated parameters: rigidity, mass per length, travel per angle.

Each family has its own record of parameters, with the symbols of its paper. What follows from them is the same.
"""

from monitor_core.models.parameters import transmission_ratio
from monitor_core.models.rod import axial_rigidity, torsional_rigidity


class BallScrew:
    """Quantities of a ball screw that follow from the parameters of a family's record."""

    __slots__ = ()
    screw_diameter: float  # [m]
    screw_lead: float  # [m]
    youngs_modulus: float  # [Pa]
    shear_modulus: float  # [Pa]
    density: float  # [kg/m³]
    motor_inertia: float  # [kg·m²]
    coupling_inertia: float  # [kg·m²]

    @property
    def transmission_ratio(self) -> float:
        """Travel per angle, lead/2π: i, r_g or i_b of the papers [m/rad]."""
        return transmission_ratio(self.screw_lead)

    @property
    def rotor_inertia(self) -> float:
        """Motor and coupling: what turns on the motor's side of the coupling [kg·m²]."""
        return self.motor_inertia + self.coupling_inertia

    @property
    def stretched_diameter(self) -> float:
        """Diameter that counts in tension: the outer one, unless the family says otherwise [m]."""
        return self.screw_diameter

    @property
    def twisted_diameter(self) -> float:
        """Diameter that counts in torsion: the outer one, unless the family says otherwise [m]."""
        return self.screw_diameter

    @property
    def axial_rigidity(self) -> float:
        """E S [N]."""
        return axial_rigidity(self.youngs_modulus, self.stretched_diameter)

    @property
    def torsional_rigidity(self) -> float:
        """G J with the polar area moment J = πd⁴/32 [N·m²]."""
        return torsional_rigidity(self.shear_modulus, self.twisted_diameter)

    @property
    def mass_per_length(self) -> float:
        """ρ S [kg/m]."""
        return axial_rigidity(self.density, self.stretched_diameter)

    @property
    def inertia_per_length(self) -> float:
        """ρ J with the polar area moment [kg·m]."""
        return torsional_rigidity(self.density, self.twisted_diameter)
