"""The hybrid model: a distributed screw that deforms as under a static load. Sun et al. (2022), Eqs. (1)–(14)."""

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import ComplexArray
from monitor_core.models.ball_screw import BallScrew, nut_rigidity
from monitor_core.models.bracket import BeyondContacts, beyond_contacts
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveConditions, MotorEnd, require_position
from monitor_core.models.published.small_drive import (
    DriveEquations,
    SecondOrderSystem,
    SmallDrive,
    complex_stiffness,
    equivalent_viscous_damping,
    series_stiffness,
    transfer_matrix,
    undamped_modes,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridParameters(BallScrew, DriveParameters):
    """Table 1 of the paper, read right.

    The polar area moment of the screw follows from its diameter: the J_s of Table 1 is neither that nor the inertia of
    such a bar. The coupling's stiffness is in N·m/rad, the nut's in N/m, against the units of the print. Eq. (5) counts
    the nut with a compliance of 2/k_n; ``nut_stiffness`` is the rigidity, k_n/2, as in every other family.
    """

    table_mass: float  # m_t [kg]
    screw_length: float  # l_s [m]
    screw_diameter: float  # d_s [m]
    screw_lead: float  # P_t [m]
    youngs_modulus: float  # E_s [Pa]
    shear_modulus: float  # G_s [Pa]
    density: float  # ρ_s [kg/m³]
    motor_inertia: float  # J_m [kg·m²]
    coupling_inertia: float = 0.0  # J_c [kg·m²]
    coupling_stiffness: float  # k_c [N·m/rad]
    bearing_stiffness: float  # k_b [N/m]
    nut_stiffness: float  # rigidity, half of the paper's k_n; K of the catalogue with a load rating [N/m]
    dynamic_load_rating: float | None = None  # [N]
    bracket_stiffness: float = math.inf  # [N/m]
    loss_factor: float = 0.0  # η of bearing, nut, bracket and coupling [-]
    motor_damping: float = 0.0  # c_m [N·m·s/rad]
    table_damping: float = 0.0  # c_t [N·s/m]


def equivalent_stiffness(
    parameters: HybridParameters, conditions: DriveConditions, *, loss_factor: float = 0.0, coupling: bool = True
) -> complex:
    r"""Return the stiffness between motor end and table, seen at the table, in newtons per metre.

    .. math::

        \hat k (1 + j\eta_e) = \left[ \frac{1}{k_b (1 + j\eta)} + \frac{x_c}{E_s A_s} + \frac{2}{k_n (1 + j\eta)}
        + r_g^2 \left( \frac{1}{k_c (1 + j\eta)} + \frac{x_c}{G_s J_s} \right) \right]^{-1}

    Eq. (14) of Sun et al. (2022), which is Eq. (5) without loss factor; a bracket is one more joint in the chain.
    The parameters' own loss factor is not taken; without ``coupling`` where the torque at the screw's own end is given.
    ``OutsideValidityError`` if x_c is not on the screw, or preload and dynamic load rating do not go together.
    """
    p, x = parameters, require_position(conditions.position, parameters.screw_length)
    nut = nut_rigidity(p.nut_stiffness, conditions.preload, p.dynamic_load_rating)
    seen_at_table = p.transmission_ratio**-2
    coupling_stiffness = p.coupling_stiffness * seen_at_table if coupling else math.inf
    joints = (p.bearing_stiffness, nut, p.bracket_stiffness, coupling_stiffness)
    return series_stiffness(
        p.axial_rigidity / x,
        p.torsional_rigidity * seen_at_table / x,
        *(complex_stiffness(k, loss_factor) for k in joints),
    )


@dataclass(frozen=True, slots=True)
class ScrewInertia:
    """What the screw adds to the mass matrix of Eq. (2)."""

    m_s: float  # equivalent mass, Eq. (6) [kg]
    J_11: float  # Eq. (8) [kg·m²]
    J_12: float  # Eq. (10), corrected [kg·m²]
    J_22: float  # Eq. (11) [kg·m²]


def screw_inertia(parameters: HybridParameters, conditions: DriveConditions, *, coupling: bool = True) -> ScrewInertia:
    r"""Return the inertia of the screw in the two coordinates of the model.

    With :math:`a = r_g^2 k/k_2` and :math:`b = r_g^2 k/k_c`, the shares of the relative displacement that the torsion
    of screw and coupling, and of the coupling alone, take up, and :math:`\xi = x_c/l_s`:

    .. math::

        m_s &= \frac{\rho_s A_s x_c}{3} \left[ \left( \frac{k}{k_1} \right)^2 + \frac{k^2}{k_1 k_b}
               + \left( \frac{k}{k_b} \right)^2 \right] + \rho_s A_s (l_s - x_c) \left( \frac{k}{k_1} \right)^2 \\
        J_{11} &= \rho_s J_s l_s \left\{ \frac{\xi}{3} \left[ (1-a)^2 + (1-a)(1-b) + (1-b)^2 \right]
               + (1 - \xi) (1-a)^2 \right\} \\
        J_{12} &= \rho_s J_s l_s \, a \left\{ \xi \left[ \frac16 + \frac{k_2}{k_c} \left( \frac12 - \frac b3 \right)
               - \frac b3 \right] + \left( 1 - \frac{2\xi}{3} \right) (1-a) \right\} \\
        J_{22} &= \rho_s J_s l_s \, a^2 \left[ \frac{\xi}{3} \left( 1 + \frac{k_2}{k_c} + \frac{k_2^2}{k_c^2} \right)
               + (1 - \xi) \right]

    Eqs. (6)–(11) of Sun et al. (2022), the third corrected.

    Arguments and errors are those of :func:`equivalent_stiffness`.

    Notes
    -----
    Eq. (10) prints −2x_c/(3l_s) where −b/3 is right, and k/k_c where it must be k/k_2 in the last bracket: J_12 would
    be 7.7 % too low on the paper's axis. The kinetic energy of the statically deformed screw gives what stands here.
    """
    p, x = parameters, conditions.position
    k = equivalent_stiffness(p, conditions, coupling=coupling).real
    bearing = k / p.bearing_stiffness
    axial = bearing + k * x / p.axial_rigidity  # k/k_1, Eq. (7)
    b = p.transmission_ratio**2 * k / p.coupling_stiffness if coupling else 0.0
    a = b + p.transmission_ratio**2 * k * x / p.torsional_rigidity  # of Eq. (9)
    xi, ratio = x / p.screw_length, b / a
    whole = p.inertia_per_length * p.screw_length
    near = axial**2 + axial * bearing + bearing**2
    m_s = p.mass_per_length * (x / 3.0 * near + (p.screw_length - x) * axial**2)
    J_11 = xi / 3.0 * ((1.0 - a) ** 2 + (1.0 - a) * (1.0 - b) + (1.0 - b) ** 2) + (1.0 - xi) * (1.0 - a) ** 2
    J_12 = xi * (1.0 / 6.0 + ratio * (0.5 - b / 3.0) - b / 3.0) + (1.0 - 2.0 * xi / 3.0) * (1.0 - a)
    J_22 = xi / 3.0 * (1.0 + ratio + ratio**2) + (1.0 - xi)
    return ScrewInertia(m_s, whole * J_11, whole * a * J_12, whole * a**2 * J_22)


@dataclass(frozen=True, slots=True)
class HybridModel(SmallDrive):
    r"""The drive of Sun et al. (2022) in the coordinates :math:`q = (x_m, x_t)`, :math:`x_m = r_g \theta_m`.

    .. math::

        \mathbf M &= \begin{bmatrix} (J_m + J_c + J_{11})/r_g^2 + m_s & J_{12}/r_g^2 - m_s \\
                     J_{12}/r_g^2 - m_s & J_{22}/r_g^2 + m_s + m_t + m_w \end{bmatrix} \\
        \mathbf C &= \begin{bmatrix} c_m/r_g^2 & 0 \\ 0 & c_t \end{bmatrix}, \qquad
        \mathbf K = \hat k (1 + j\eta_e) \begin{bmatrix} 1 & -1 \\ -1 & 1 \end{bmatrix}

    Eqs. (1)–(4) and (14). The motor end is *free* in the paper. *Clamped* leaves the table's row and column.
    *Prescribed* torque at the screw: x_m is the screw's own end, there is no J_m, J_c, c_m and no coupling.

    Notes
    -----
    Eq. (2) prints J_21 for J_22 in m_22. The paper's 1726.8 and 1782.4 rad/s follow from no reading of its Table 1;
    with corrected equations it gives 1863.6 rad/s without and 1865.2 rad/s with η = 0.053, see
    docs/reference/errata.md.

    Neglected: all but the static shape of the screw, the mass of the nut unless it is counted with the table, the far
    bearing, bending. Against the continuous screw the elastic mode is too high by 0.4 to 0.65 % with a free motor end,
    by 0.1 % with a clamped one, and by 3 % with a prescribed torque, where nothing but the screw's own inertia holds
    its end. The mass matrix is that of the undamped static shape.
    """

    paper_motor_end = MotorEnd.FREE
    parameters: HybridParameters

    def equations(self, conditions: DriveConditions, motor_end: MotorEnd = MotorEnd.FREE) -> DriveEquations:
        """Return the matrices: q = (x_m, x_t), or (x_t) with a clamped motor end [m]."""
        p, r_g = self.parameters, self.parameters.transmission_ratio
        prescribed = motor_end is MotorEnd.PRESCRIBED
        k = equivalent_stiffness(p, conditions, loss_factor=p.loss_factor, coupling=not prescribed)
        screw = screw_inertia(p, conditions, coupling=not prescribed)
        motor_inertia, motor_damping = (
            (0.0, 0.0) if prescribed else (p.motor_inertia + p.coupling_inertia, p.motor_damping)
        )
        m_12 = screw.J_12 / r_g**2 - screw.m_s
        mass = np.array(
            [
                [(motor_inertia + screw.J_11) / r_g**2 + screw.m_s, m_12],
                [m_12, screw.J_22 / r_g**2 + screw.m_s + p.table_mass + conditions.payload_mass],
            ]
        )
        damping = np.diag([motor_damping / r_g**2, p.table_damping])
        stiffness = k * np.array([[1.0, -1.0], [-1.0, 1.0]])
        moving = slice(1, 2) if motor_end is MotorEnd.CLAMPED else slice(0, 2)
        angle = np.array([0.0 if motor_end is MotorEnd.CLAMPED else 1.0 / r_g, 0.0])
        system = SecondOrderSystem(mass[moving, moving], damping[moving, moving], stiffness[moving, moving])
        return DriveEquations(system, angle[moving], np.array([0.0, 1.0])[moving])

    def transfer_matrix(self, s: ComplexArray, conditions: DriveConditions) -> ComplexArray:
        """Return G(s) of Eq. (13), from (τ_m/r_g, f_c) [N] to (x_m, x_t) [m], shape (n_frequencies, 2, 2).

        For a frequency response s is jω [rad/s], shape (n_frequencies,). ``OutsideValidityError`` if there is a loss
        factor and an s is not in the upper half plane.
        """
        return transfer_matrix(self.equations(conditions).system, s)

    def time_domain_equations(self, conditions: DriveConditions, motor_end: MotorEnd = MotorEnd.FREE) -> DriveEquations:
        """Return equations that may be integrated in time: real matrices, viscous damping for the loss factor.

        Stiffness of Eq. (5), and the damping that Eq. (14) amounts to at its resonance, c = η_e k̂/ω. The pole differs
        from that of the complex stiffness in the order of η², by 0.08 % of the frequency on the paper's axis.
        """
        equations = self.equations(conditions, motor_end)
        undamped = HybridModel(replace(self.parameters, loss_factor=0.0)).equations(conditions, motor_end).system
        omega, _ = undamped_modes(undamped)
        viscous = equivalent_viscous_damping(equations.system.stiffness, float(omega[-1]))
        system = SecondOrderSystem(undamped.mass, undamped.damping + viscous, undamped.stiffness)
        return DriveEquations(system, equations.angle_at_motor, equations.displacement_at_table)

    def beyond_contacts(self, s: ComplexArray, conditions: DriveConditions) -> BeyondContacts:
        """Return what the contacts of the nut carry: the table alone, behind the bracket."""
        p = self.parameters
        return beyond_contacts(
            s,
            table_mass=p.table_mass + conditions.payload_mass,
            table_damping=p.table_damping,
            bracket_stiffness=p.bracket_stiffness,
            loss_factor=p.loss_factor,
        )
