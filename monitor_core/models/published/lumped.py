"""The lumped model: one spring, one moving mass, and the preload in the spring. Nguyen et al. (2018), Eqs. (1)–(8).

Its parameters (Table 1, and what that leaves out), the stiffness of the chain of screw, coupling, joints and nut
(Eqs. (1)–(5)), the coefficients of the preload feature in closed form (Eqs. (1)–(6) and (8)), and the drive.
The table stands at the position x from the fixed bearing [m]; one that is not on the screw raises
``OutsideValidityError``.
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.ball_screw import BallScrew, nut_rigidity
from monitor_core.models.bracket import BeyondContacts, beyond_contacts
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveConditions, MotorEnd, require_position
from monitor_core.models.published.small_drive import (
    DriveEquations,
    SecondOrderSystem,
    SmallDrive,
    complex_stiffness,
    series_stiffness,
)


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


@dataclass(frozen=True, slots=True)
class LumpedModel(SmallDrive):
    r"""The drive of Nguyen et al. (2018): moving mass on a spring, the torsion of the screw put into that spring.

    With the motor end *clamped*, which is the paper's case, the modes are Eqs. (6) and (7),

    .. math::

        f_{ax} = \frac{1}{2\pi} \sqrt{\frac{k_{ax}}{m_{table} + m_{screw} + m_{nut} + m_{payload}}}, \qquad
        f_{rot} = \frac{1}{2\pi} \sqrt{\frac{k_{rot}}{J_s}}

    each without regard to the other: the rotational mode moves neither table nor motor, and the receptance at the table
    is :math:`1/(k_{ax}(1 + j\eta_e) + j\omega c_t - \omega^2 \Sigma m)`.

    With an end that turns, the same spring lies between an inertia J and the table, :math:`q = (\theta, x_t)`:

    .. math::

        \mathbf M = \begin{bmatrix} J & 0 \\ 0 & \Sigma m \end{bmatrix}, \qquad
        \mathbf K = k_{ax} \begin{bmatrix} i^2 & -i \\ -i & 1 \end{bmatrix}

    *Free*: J is of motor, coupling and screw. *Prescribed* torque at the screw: J is the screw's, and the coupling is
    not in the spring. Without inertias of motor and coupling the two differ by the coupling's compliance alone, which
    the first keeps between J and the table; they meet where the coupling is rigid.

    Notes
    -----
    An accelerometer on the nut has the screw's mass behind the bracket, with the table, as Σm has it.

    Neglected: the mass of the screw between bearing and nut as such (all of it travels with the table in Σm, although
    it is held axially by the bearing; all of its inertia turns with the motor end), the free rotation of the far end
    (Eq. 3 holds it), the far bearing, bending, and every mode beyond the first axial one. The paper gives no damping
    values; the dampers of its Fig. 2 are replaced by a loss factor of the joints and a damper at the guides.
    """

    paper_motor_end = MotorEnd.CLAMPED
    parameters: LumpedParameters

    def equations(self, conditions: DriveConditions, motor_end: MotorEnd = MotorEnd.CLAMPED) -> DriveEquations:
        """Return the matrices: q = (x_t, φ) with a clamped motor end, (θ, x_t) otherwise [m], [rad]."""
        p, i = self.parameters, self.parameters.transmission_ratio
        mass = p.moving_mass(conditions.payload_mass)
        k = axial_stiffness(p, conditions, coupling=motor_end is not MotorEnd.PRESCRIBED)
        if motor_end is MotorEnd.CLAMPED:
            system = SecondOrderSystem(
                np.diag([mass, p.screw_inertia]),
                np.diag([p.table_damping, 0.0]),
                np.diag([k, rotational_stiffness(p, conditions.position)]),
            )
            return DriveEquations(system, np.array([0.0, 0.0]), np.array([1.0, 0.0]))
        motor = p.motor_inertia + p.coupling_inertia if motor_end is MotorEnd.FREE else 0.0
        system = SecondOrderSystem(
            np.diag([motor + p.screw_inertia, mass]),
            np.diag([0.0, p.table_damping]),
            k * np.array([[i**2, -i], [-i, 1.0]]),
        )
        return DriveEquations(system, np.array([1.0, 0.0]), np.array([0.0, 1.0]))

    def beyond_contacts(self, s: ComplexArray, conditions: DriveConditions) -> BeyondContacts:
        """Return what the contacts of the nut carry: table and screw, behind the bracket, and the nut's own mass."""
        p = self.parameters
        return beyond_contacts(
            s,
            table_mass=p.table_mass + p.screw_mass + conditions.payload_mass,
            nut_mass=p.nut_mass,
            table_damping=p.table_damping,
            bracket_stiffness=p.bracket_stiffness,
            loss_factor=p.loss_factor,
        )
