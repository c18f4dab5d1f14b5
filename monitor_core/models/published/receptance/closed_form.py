r"""Evaluate Tian's drive as published in closed form: the coupled receptances, with the trigonometry taken out.

The model ``receptance``, and identification, evaluate this; a drive with effects beyond the paper's is evaluated by
:mod:`monitor_core.models.extended.closed_form`.

Two rods, nut and table in series make the table receptance

.. math::

    H = \frac{1}{1/C + Z_b}, \qquad
    C = \frac{1}{K_n} + \frac{1}{D_a - \omega^2 m_s} + \frac{i_b^2}{D_t - \omega^2 J_s}

with the stiffnesses D of the screw felt at the nut. Each part is a quotient of two functions without poles; multiplied
out, one division is left and no frequency is a special one:

.. math::

    H = \frac{y A T + K (B T + U A)}{\Delta}, \qquad \Delta = K A T + Z_b \left[ y A T + K (B T + U A) \right]

A/B is the axial and T/U the torsional stiffness (U with i_b²), K/y the nut with its bracket. A and B are bilinear in
the stiffnesses of the two bearings, T and U linear in that of the coupling. All else is known once frequencies and
position are, and is kept in a :class:`PositionTerms`. Everything is an entire function of ω, so the same code serves on
the frequency axis and for complex poles.
"""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.bracket import BeyondContacts, nut_from_table
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint, require_position
from monitor_core.models.published.receptance.parameters import JointParameters, ReceptanceParameters
from monitor_core.models.rod import RodWaves, rod_waves, wave_number


@dataclass(frozen=True, slots=True, eq=False)
class LinearTerm:
    """A function that is linear in the dynamic stiffness κ of the coupling: constant + κ × slope."""

    constant: ComplexArray
    slope: ComplexArray

    def at(self, coupling: ComplexArray) -> ComplexArray:
        """Return its value for κ(ω), shape (n_frequencies,). [N·m/rad]."""
        return self.slope * coupling + self.constant


@dataclass(frozen=True, slots=True, eq=False)
class PositionTerms:
    """What the closed form needs of one position on one grid of frequencies; no joint parameter is in it.

    Made once by :func:`position_terms`; each set of joint parameters then costs a few products. All arrays are complex,
    shape (n_frequencies,): a product of a complex and a real array takes twice as long.
    """

    j_omega: ComplexArray  # jω [rad/s]
    near: RodWaves[ComplexArray]  # axial, from the fixed bearing to the nut
    far: RodWaves[ComplexArray]  # axial, from the far bearing to the nut …
    far_loaded_cosine: ComplexArray  # … with the mass of the piece inside the nut: cos λl − ω² m_s sin λl/z
    far_loaded_z_sine: ComplexArray  # z sin λl + ω² m_s cos λl [N/m]
    table_stiffness: ComplexArray  # Z_b = −ω² m_b + jω c_b [N/m]
    torsion: LinearTerm  # T
    turning: LinearTerm  # U, with i_b²
    coupling_lever: ComplexArray  # i_b × turn in the coupling per turn of the nut, for the gradient
    torque_lever: LinearTerm  # i_b × what a torque at the motor end does at the nut
    held_torsion: LinearTerm  # T and U/i_b² of the drive held where that torque acts
    held_turning: LinearTerm
    transmission_ratio: float  # i_b [m/rad]
    nut_mass: float  # a part of m_b [kg]


def position_terms(
    parameters: ReceptanceParameters,
    omega: FloatArray | ComplexArray,
    conditions: DriveConditions,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> PositionTerms:
    """Compute what does not depend on the joints: trigonometry and inertia at ω, not zero, in rad/s.

    ω is complex where poles are sought. Of the conditions position and payload count; ``OutsideValidityError`` if the
    position is not on the screw.
    """
    position = require_position(conditions.position, parameters.screw_length)
    rest = parameters.screw_length - position
    complex_omega = np.asarray(omega, dtype=np.complex128)
    rigidity, inertia = parameters.axial_rigidity, -(complex_omega**2)
    axial_wave = wave_number(complex_omega, parameters.youngs_modulus, parameters.density)
    far = rod_waves(rigidity, axial_wave, rest)
    segment = inertia * parameters.screw_nut_segment_mass
    torsion = _torsion(parameters, complex_omega, position, motor_end)
    return PositionTerms(
        1j * complex_omega,
        rod_waves(rigidity, axial_wave, position),
        far,
        far.cosine + segment * far.sine_over_z,
        far.z_sine - segment * far.cosine,
        inertia * parameters.moving_mass(conditions.payload_mass) + 1j * complex_omega * parameters.table_damping,
        *torsion,
        parameters.transmission_ratio,
        parameters.nut_mass,
    )


def _torsion(
    parameters: ReceptanceParameters, omega: ComplexArray, position: float, motor_end: MotorEnd
) -> tuple[LinearTerm, LinearTerm, ComplexArray, LinearTerm, LinearTerm, LinearTerm]:
    """Return the torsional terms of a :class:`PositionTerms` in their order."""
    wave = wave_number(omega, parameters.shear_modulus, parameters.density)
    near = rod_waves(parameters.torsional_rigidity, wave, position)
    far = rod_waves(parameters.torsional_rigidity, wave, parameters.screw_length - position)
    i, zero = parameters.transmission_ratio, np.zeros_like(omega)
    segment_h = -(omega**2) * parameters.screw_motor_segment_inertia
    rotor = -(omega**2) * parameters.rotor_inertia + 1j * omega * parameters.motor_damping
    beyond = -far.z_sine - omega**2 * parameters.screw_nut_segment_inertia * far.cosine

    # stiffness T/U at the nut with the screw's motor end free (0), and held there (1)
    end = near.cosine + segment_h * near.sine_over_z
    torsion_0 = (segment_h * near.cosine - near.z_sine) * far.cosine + end * beyond
    torsion_1 = near.cosine * far.cosine + near.sine_over_z * beyond
    turning_0, turning_1 = end * far.cosine, near.sine_over_z * far.cosine
    lever = i * far.cosine
    match motor_end:
        case MotorEnd.PRESCRIBED:
            torsion, turning = LinearTerm(torsion_0, zero), LinearTerm(turning_0, zero)
            torque_lever, coupling_lever = LinearTerm(lever, zero), zero
            held = LinearTerm(torsion_1, zero), LinearTerm(turning_1, zero)
        case MotorEnd.CLAMPED:
            torsion, turning = LinearTerm(torsion_0, torsion_1), LinearTerm(turning_0, turning_1)
            torque_lever, coupling_lever = LinearTerm(zero, zero), lever
            held = LinearTerm(zero, zero), LinearTerm(zero, zero)
        case MotorEnd.FREE:
            # the coupling and the rotor in series, κ Z/(κ + Z), multiplied through with κ + Z
            torsion = LinearTerm(rotor * torsion_0, torsion_0 + rotor * torsion_1)
            turning = LinearTerm(rotor * turning_0, turning_0 + rotor * turning_1)
            torque_lever, coupling_lever = LinearTerm(zero, lever), rotor * lever
            held = LinearTerm(torsion_0, torsion_1), LinearTerm(turning_0, turning_1)
    turning = LinearTerm(i**2 * turning.constant, i**2 * turning.slope)
    return torsion, turning, coupling_lever, torque_lever, *held


@dataclass(frozen=True, slots=True, eq=False)
class EntireResponses:
    """Numerators and common denominator of all receptances, functions of ω without poles; shape (n_frequencies,) each.

    The zeros of the denominator are the poles of the drive; none is lost where table or motor rest in a mode. The scale
    is common to all four and without meaning. With a clamped motor end the numerators of the motor are zero.
    """

    denominator: ComplexArray  # Δ
    table_per_force: ComplexArray
    table_per_torque: ComplexArray  # and, by reciprocity, the angle at the motor end per force
    angle_per_torque: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """The letters of the module's docstring for one set of joints."""

    near_end: ComplexArray  # cos λl + k_l sin λl/z; A/B = near + far parts, B = near_end × far_end
    far_end: ComplexArray
    axial: ComplexArray  # A
    torsion: ComplexArray  # T
    axial_torsion: ComplexArray  # A T
    coupling: ComplexArray  # κ
    nut: ComplexArray  # K
    nut_yield: complex | ComplexArray  # y
    table_per_force: ComplexArray
    denominator: ComplexArray


def table_receptance(terms: PositionTerms, joints: JointParameters) -> ComplexArray:
    """Return the receptance of the table, h_all-6a6a of Eq. (24) of Tian et al., shape (n_frequencies,), in m/N."""
    parts = _parts(terms, joints)
    return parts.table_per_force / parts.denominator


def table_fraction(terms: PositionTerms, joints: JointParameters) -> tuple[ComplexArray, ComplexArray]:
    """Return numerator and denominator of the receptance of the table, functions of ω without poles."""
    parts = _parts(terms, joints)
    return parts.table_per_force, parts.denominator


def table_receptance_gradient(terms: PositionTerms, joints: JointParameters) -> tuple[ComplexArray, ComplexArray]:
    r"""Return the receptance of the table in m/N, and its derivatives with respect to the eight joint parameters.

    A joint of dynamic stiffness κ that is deformed by t per unit force at the table changes the receptance by

    .. math::

        \frac{\partial H}{\partial \kappa} = -t^2, \qquad \kappa = k (1 + j \eta) + j \omega c

    (reciprocity); t follows from the closed form. The derivatives are per unit of each parameter, in the order of
    ``JOINT_NAMES``, shape (8, n_frequencies).
    """
    parts = _parts(terms, joints)
    reciprocal = 1.0 / parts.denominator
    per_nut = parts.nut * reciprocal
    bearings = parts.torsion * per_nut
    deformation = np.empty((4, reciprocal.size), dtype=np.complex128)
    np.multiply(bearings, parts.far_end, out=deformation[0])
    np.multiply(bearings, parts.near_end, out=deformation[1])
    np.multiply(parts.axial_torsion, reciprocal, out=deformation[2])
    np.multiply(parts.axial * per_nut, terms.coupling_lever, out=deformation[3])

    gradient = np.empty((8, reciprocal.size), dtype=np.complex128)
    squared = np.multiply(deformation, deformation, out=deformation)
    np.multiply(squared, -1.0 - 1j * joints.loss_factor, out=gradient[:4])
    np.multiply(squared, -terms.j_omega, out=gradient[4:])
    return parts.table_per_force * reciprocal, gradient


def entire_responses(terms: PositionTerms, joints: JointParameters) -> EntireResponses:
    """Return numerators and denominator of the receptances between table and motor end; ω may be complex."""
    parts = _parts(terms, joints)
    nut_axial = parts.nut * parts.axial
    # nut, axial stiffness and table in series, as the torsion feels them behind i_b
    series = nut_axial + terms.table_stiffness * (
        parts.nut_yield * parts.axial + parts.nut * parts.near_end * parts.far_end
    )
    held = series * terms.held_torsion.at(parts.coupling) + (
        terms.transmission_ratio**2 * terms.table_stiffness * nut_axial * terms.held_turning.at(parts.coupling)
    )
    table_per_torque = nut_axial * terms.torque_lever.at(parts.coupling)
    return EntireResponses(parts.denominator, parts.table_per_force, table_per_torque, held)


def receptance_between(
    terms: PositionTerms, joints: JointParameters, excitation: ExcitationPoint, response: ResponsePoint
) -> ComplexArray:
    """Return the displacement or, at the motor, the angle per unit excitation, shape (n_frequencies,).

    The terms are those of a motor end that goes with the excitation.
    """
    responses = entire_responses(terms, joints)
    by_force = excitation is ExcitationPoint.FORCE_AT_TABLE
    if response is ResponsePoint.ANGLE_AT_MOTOR:
        return (responses.table_per_torque if by_force else responses.angle_per_torque) / responses.denominator
    per_force, per_torque = (x / responses.denominator for x in (responses.table_per_force, responses.table_per_torque))
    if response is ResponsePoint.ACCELERATION_AT_NUT:
        nut = terms.nut_mass * terms.j_omega**2
        bracket = 1.0 / joints.bracket_stiffness / (1.0 + 1j * joints.loss_factor)
        beyond = BeyondContacts(nut, bracket, terms.table_stiffness - nut)
        return np.asarray(nut_from_table(per_force, per_torque, beyond)[0 if by_force else 1])
    return per_force if by_force else per_torque


def _parts(terms: PositionTerms, joints: JointParameters) -> _Parts:
    elastic, j_omega = 1.0 + 1j * joints.loss_factor, terms.j_omega
    near_bearing = joints.bearing_damping * j_omega + joints.bearing_stiffness * elastic
    far_bearing = joints.far_bearing_damping * j_omega + joints.far_bearing_stiffness * elastic
    nut = joints.nut_damping * j_omega + joints.nut_stiffness * elastic
    coupling = joints.coupling_damping * j_omega + joints.coupling_stiffness * elastic
    nut_yield = 1.0 if np.isinf(joints.bracket_stiffness) else 1.0 + nut / (joints.bracket_stiffness * elastic)

    near, far = terms.near, terms.far
    near_end = near_bearing * near.sine_over_z + near.cosine
    far_end = far_bearing * far.sine_over_z + far.cosine
    axial = (near_bearing * near.cosine - near.z_sine) * far_end
    axial += near_end * (far_bearing * terms.far_loaded_cosine - terms.far_loaded_z_sine)
    torsion = terms.torsion.at(coupling)
    axial_torsion = axial * torsion
    table_per_force = near_end * far_end * torsion
    table_per_force += terms.turning.at(coupling) * axial
    table_per_force *= nut
    table_per_force += axial_torsion if np.isinf(joints.bracket_stiffness) else nut_yield * axial_torsion
    denominator = nut * axial_torsion + terms.table_stiffness * table_per_force
    return _Parts(
        near_end, far_end, axial, torsion, axial_torsion, coupling, nut, nut_yield, table_per_force, denominator
    )
