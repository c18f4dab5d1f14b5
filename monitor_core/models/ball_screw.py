"""Derive quantities of a ball screw from its stated parameters: rigidities, mass per length, travel per angle.

Each family has its own record of parameters, with the symbols of its paper. What follows from them is the same.
"""

from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import transmission_ratio
from monitor_core.models.rod import axial_rigidity, torsional_rigidity


def nut_rigidity(nut_stiffness: float, preload: float | None, dynamic_load_rating: float | None) -> float:
    r"""Return the axial rigidity of the nut in newtons per metre.

    .. math::

        k_{nut} = 0.8 K \left( \frac{P}{0.1\,C_d} \right)^{1/3}

    Eq. (1) of Nguyen et al. (2018), after the catalogues (ISO 3408-4). Where neither preload nor load rating is stated
    the nut has the stated stiffness whatever its preload, as in the other three papers.

    ``nut_stiffness`` is :math:`K` of the catalogue, or the rigidity itself [N/m]; preload and load rating are
    :math:`P` and :math:`C_d` [N]. ``OutsideValidityError`` if only one of the two is stated, or the preload exceeds
    the 10 % of the load rating up to which the source states the equation.
    """
    if preload is None and dynamic_load_rating is None:
        return nut_stiffness
    if preload is None:
        raise OutsideValidityError(
            "the nut rigidity of this model follows the preload (dynamic_load_rating_n is stated); state the preload"
        )
    if dynamic_load_rating is None:
        raise OutsideValidityError(
            f"a preload of {preload} N has no effect in a model without dynamic_load_rating_n; state the rating"
        )
    rated_preload = 0.1 * dynamic_load_rating
    if preload > rated_preload * (1.0 + 1e-9):
        raise OutsideValidityError(
            f"preload must not exceed 10 % of the dynamic load rating, {rated_preload:g} N; got {preload:g} N"
        )
    return float(0.8 * nut_stiffness * (preload / rated_preload) ** (1.0 / 3.0))


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
