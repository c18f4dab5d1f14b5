"""Compute the stiffness of the chain of screw, coupling, joints and nut. Nguyen et al. (2018), Eqs. (1)–(5).

The table stands at the position x from the fixed bearing [m]; one that is not on the screw raises
``OutsideValidityError``.
"""

import math

from monitor_core.models.nut import nut_rigidity
from monitor_core.models.protocol import DriveConditions, require_position
from monitor_core.models.published.damping import complex_stiffness, series_stiffness
from monitor_core.models.published.lumped.parameters import LumpedParameters


def shaft_axial_stiffness(parameters: LumpedParameters, position: float) -> float:
    r"""Return the axial stiffness of the screw between fixed bearing and table in newtons per metre.

    .. math:: k_{shaft,ax} = \frac{\pi}{4 x} d_{minor}^2 E

    Eq. (2) of Nguyen et al. (2018), which calls d_minor a radius; the equation and Table 1 make it the diameter.
    """
    x = require_position(position, parameters.screw_length)
    return math.pi * parameters.screw_minor_diameter**2 * parameters.youngs_modulus / (4.0 * x)


def shaft_torsional_stiffness(parameters: LumpedParameters, position: float) -> float:
    r"""Return the torsional stiffness of the screw at the table in newton metres per radian.

    .. math:: k_{shaft,rot} = \frac{\pi L}{32\, x (L - x)} d_{minor}^4 G

    Eq. (3) of Nguyen et al. (2018), with the equals sign where it belongs.

    As printed, the equals sign stands before d⁴G. Read so, it is a shaft held against rotation at *both* ends,
    GJ/x + GJ/(L − x), although the far end of a screw turns freely: the compliance is L/(L − x) times too low. On the
    paper's axis torsion of the shaft is about 1 % of the whole compliance; at 750 mm f_ax comes out 1.1 % too high.
    """
    x, length = require_position(position, parameters.screw_length), parameters.screw_length
    d, G = parameters.screw_minor_diameter, parameters.shear_modulus
    return math.pi * length * d**4 * G / (32.0 * x * (length - x))


def rotational_stiffness(parameters: LumpedParameters, position: float, *, coupling: bool = True) -> complex:
    r"""Return the stiffness of screw and coupling in torsion in newton metres per radian.

    .. math:: \frac{1}{k_{rot}} = \frac{1}{k_{shaft,rot}} + \frac{1}{k_{coupling}}

    Eq. (5) of Nguyen et al. (2018), with the loss factor on the coupling; without ``coupling`` where the torque at the
    screw's own end is given.
    """
    spring = complex_stiffness(parameters.coupling_stiffness if coupling else math.inf, parameters.loss_factor)
    return series_stiffness(shaft_torsional_stiffness(parameters, position), spring)


def axial_stiffness(parameters: LumpedParameters, conditions: DriveConditions, *, coupling: bool = True) -> complex:
    r"""Return the stiffness between motor end and table, seen at the table, in newtons per metre.

    .. math::

        \frac{1}{k_{ax}} = \frac{1}{k_{shaft,ax}} + \frac{1}{k_{bearing}} + \frac{1}{k_{bracket}} + \frac{1}{k_{nut}}
        + \frac{i^2}{k_{rot}}

    Eq. (4) of Nguyen et al. (2018) with the nut of Eq. (1), and with the loss factor on each of the joints; the
    coupling as above. Preload and dynamic load rating that do not go together raise ``OutsideValidityError``.
    """
    nut = nut_rigidity(parameters.nut_stiffness, conditions.preload, parameters.dynamic_load_rating)
    joints = (parameters.bearing_stiffness, parameters.bracket_stiffness, nut)
    return series_stiffness(
        shaft_axial_stiffness(parameters, conditions.position),
        *(complex_stiffness(k, parameters.loss_factor) for k in joints),
        rotational_stiffness(parameters, conditions.position, coupling=coupling) / parameters.transmission_ratio**2,
    )
