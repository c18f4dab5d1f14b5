"""Compute what the closed form of Tian's drive needs of one position: trigonometry and inertia, no joint in it."""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.protocol import DriveConditions, MotorEnd, require_position
from monitor_core.models.published.receptance.parameters import ReceptanceParameters
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
