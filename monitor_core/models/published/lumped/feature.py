"""Compute the coefficients of the preload feature in closed form. Nguyen et al. (2018), Eqs. (1)–(6) and (8)."""

import math
from dataclasses import dataclass

from monitor_core.errors import OutsideValidityError
from monitor_core.models.published.lumped.parameters import LumpedParameters


@dataclass(frozen=True, slots=True)
class FeatureCoefficients:
    """Coefficients of Eq. (8) as the model has them, in SI units; of an axis at hand they are regressed."""

    k1: float  # of x² [s²/m²]
    k2: float  # of x [s²/m]
    k3: float  # of preload^(−1/3) [s²·N^(1/3)]
    k4: float  # constant [s²]


def feature_coefficients(parameters: LumpedParameters, payload_mass: float = 0.0) -> FeatureCoefficients:
    r"""Return k1…k4 of the preload feature in closed form.

    .. math::

        k_1 &= -\frac{4\pi^2 \Sigma m \, i^2}{G J L}, \qquad
        k_2 = 4\pi^2 \Sigma m \left( \frac{1}{E A} + \frac{i^2}{G J} \right), \\
        k_3 &= 4\pi^2 \Sigma m \frac{(0.1\,C_d)^{1/3}}{0.8 K}, \qquad
        k_4 = 4\pi^2 \Sigma m \left( \frac{1}{k_{bearing}} + \frac{1}{k_{bracket}} + \frac{i^2}{k_{coupling}} \right)

    with :math:`A = \pi d^2/4`, :math:`J = \pi d^4/32` of the minor diameter: Eqs. (1)–(6) of Nguyen et al. (2018)
    ordered as Eq. (8).

    The loss factor does not enter; the payload is in kilograms. The "calculated" k of Table 3 do not follow from
    Table 1 so, see docs/reference/errata.md. ``OutsideValidityError`` without a dynamic load rating: the nut then does
    not follow the preload.
    """
    if parameters.dynamic_load_rating is None:
        raise OutsideValidityError(
            "without dynamic_load_rating_n the nut does not follow the preload; state the rating"
        )
    d, ratio = parameters.screw_minor_diameter, parameters.transmission_ratio
    axial = 4.0 / (math.pi * d**2 * parameters.youngs_modulus)  # per metre of screw [1/N]
    torsional = ratio**2 * 32.0 / (math.pi * d**4 * parameters.shear_modulus)  # per metre of screw [1/N]
    nut = (0.1 * parameters.dynamic_load_rating) ** (1.0 / 3.0) / (0.8 * parameters.nut_stiffness)
    constant = (
        1.0 / parameters.bearing_stiffness
        + 1.0 / parameters.bracket_stiffness
        + ratio**2 / parameters.coupling_stiffness
    )
    scale = 4.0 * math.pi**2 * parameters.moving_mass(payload_mass)
    return FeatureCoefficients(
        -scale * torsional / parameters.screw_length, scale * (axial + torsional), scale * nut, scale * constant
    )
