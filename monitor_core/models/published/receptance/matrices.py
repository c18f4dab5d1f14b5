"""Build Tian's drive as the paper does: couple the receptances of three substructures, Eqs. (1)-(24).

The closed form of ``closed_form`` says the same in a fiftieth of the time; this is
what it is compared with, and where the responses of the screw inside the nut are.
"""

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, MotorEnd, require_position
from monitor_core.models.published.receptance.coupling import couple_receptances, ground_receptance, joint_receptance
from monitor_core.models.published.receptance.parameters import JointParameters, ReceptanceParameters
from monitor_core.models.rod import rod_receptance, wave_number


def drive_receptance(
    parameters: ReceptanceParameters,
    omega: FloatArray,
    conditions: DriveConditions,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> ComplexArray:
    """Couple the axial, the torsional and the worktable substructure, Eqs. (23) and (24) of Tian et al.

    ``omega``: above zero [rad/s], shape (n_frequencies,). Returned: between table (6a), screw inside the nut axially
    (5a) and in torsion (5t). [m/N], [rad/N], [rad/(N·m)], shape (n_frequencies, 3, 3). ``OutsideValidityError`` if the
    position is not on the screw, or the piece inside the nut has no mass or no inertia.
    """
    joints = parameters.joints(conditions)
    worktable = worktable_receptance(parameters, joints, omega, conditions.payload_mass)
    axial = axial_receptance(parameters, joints, omega, conditions.position)
    torsional = torsional_receptance(parameters, joints, omega, conditions.position, motor_end=motor_end)
    with_axial = couple_receptances(worktable, axial, (1, 1), keep=(0, 1, 2))
    return couple_receptances(with_axial, torsional, (2, 1), keep=(0, 1, 2))


def axial_receptance(
    parameters: ReceptanceParameters, joints: JointParameters, omega: FloatArray, position: float
) -> ComplexArray:
    """Couple segments A and B and hold them in their bearings, Eqs. (1)-(9).

    Returned: between fixed bearing (1), nut (2) and far bearing (4) [m/N], shape (n_frequencies, 3, 3).
    """
    wave = wave_number(omega, parameters.youngs_modulus, parameters.density)
    screw = _segments_a_and_b(parameters.axial_rigidity, wave, position, parameters.screw_length)
    for point, stiffness, damping in (
        (0, joints.bearing_stiffness, joints.bearing_damping),
        (2, joints.far_bearing_stiffness, joints.far_bearing_damping),
    ):
        if stiffness or damping:
            joint = joint_receptance(omega, _elastic(stiffness, joints), damping)
            screw = ground_receptance(screw, point, joint=joint)
    return screw


def torsional_receptance(
    parameters: ReceptanceParameters,
    joints: JointParameters,
    omega: FloatArray,
    position: float,
    *,
    motor_end: MotorEnd,
) -> ComplexArray:
    """Couple segments A and B with segment H and the rotor, Eqs. (10)-(17).

    Returned: between motor end (1), nut (2) and far end (4) of the screw [rad/(N·m)], shape (n_frequencies, 3, 3).
    """
    wave = wave_number(omega, parameters.shear_modulus, parameters.density)
    screw = _segments_a_and_b(parameters.torsional_rigidity, wave, position, parameters.screw_length)
    segment_h = -(omega**2) * parameters.screw_motor_segment_inertia
    coupling = _elastic(joints.coupling_stiffness, joints) + 1j * omega * joints.coupling_damping
    if motor_end is MotorEnd.PRESCRIBED:
        if parameters.screw_motor_segment_inertia == 0.0:
            return screw
        end = 1.0 / segment_h[:, None, None]
    elif motor_end is MotorEnd.CLAMPED:
        end = 1.0 / (segment_h + coupling)[:, None, None]
    else:
        # Eqs. (14)-(16): rotor and segment H on either side of the coupling; h_H-t00 is that of segment H
        rotor = -(omega**2) * parameters.rotor_inertia + 1j * omega * parameters.motor_damping
        stiffness = coupling[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        stiffness[:, 0, 0] += rotor
        stiffness[:, 1, 1] += segment_h
        end = np.linalg.inv(stiffness)[:, 1:, 1:]
    return couple_receptances(screw, end, (0, 0), keep=(0, 1, 2))


def worktable_receptance(
    parameters: ReceptanceParameters, joints: JointParameters, omega: FloatArray, payload_mass: float
) -> ComplexArray:
    """Invert the dynamic stiffness of table, segment F and nut, Eqs. (18)-(22).

    Returned: between table (6a), segment F axially (5a) and in torsion (5t). [m/N], [rad/N], [rad/(N·m)], shape
    (n_frequencies, 3, 3). ``OutsideValidityError`` if segment F has no mass or no inertia: alone, it then has no
    receptance.
    """
    mass, inertia = parameters.screw_nut_segment_mass, parameters.screw_nut_segment_inertia
    if mass == 0.0 or inertia == 0.0:
        raise OutsideValidityError(
            "the worktable substructure needs screw_nut_segment_mass_kg and screw_nut_segment_inertia_kg_m2 above zero;"
            f" got {mass} kg and {inertia} kg·m². The closed form does not need them"
        )
    nut = _elastic(joints.nut_stiffness, joints) + 1j * omega * joints.nut_damping
    if np.isfinite(joints.bracket_stiffness):
        nut = 1.0 / (1.0 / nut + 1.0 / _elastic(joints.bracket_stiffness, joints))
    masses = np.diag([parameters.moving_mass(payload_mass), mass, inertia])
    stiffness = nut[:, None, None] * nut_pattern(parameters.transmission_ratio) - omega[:, None, None] ** 2 * masses
    stiffness[:, 0, 0] += 1j * omega * parameters.table_damping
    return np.asarray(np.linalg.inv(stiffness))


def nut_pattern(transmission_ratio: float) -> FloatArray:
    r"""Return what the nut's stiffness and damping are multiplied with in K_W and C_W.

    .. math::

        \mathbf K_W = k_n \, \mathbf v \mathbf v^T, \qquad \mathbf v = (1, -1, -i_b)

    from the energy ½ k_n (x_b − x_s − i_b θ)²: Eqs. (19) and (20) of Tian et al. without their misprint.

    ``transmission_ratio``: i_b, Eq. (21) [m/rad]. Returned: , shape (3, 3).

    Notes
    -----
    The paper prints −i_b k_n between table and axial screw, where −k_n is right, see docs/reference/errata.md.
    """
    deflection = np.array([1.0, -1.0, -transmission_ratio])
    return np.outer(deflection, deflection)


def _segments_a_and_b(rigidity: float, wave: FloatArray, position: float, screw_length: float) -> ComplexArray:
    """Couple two free rods rigidly, Eqs. (4) and (13); points 1, 2 and 4."""
    segment_a = rod_receptance(rigidity, wave, require_position(position, screw_length))
    segment_b = rod_receptance(rigidity, wave, screw_length - position)
    return couple_receptances(segment_a, segment_b, (1, 0), keep=(0, 1, 3))


def _elastic(stiffness: float, joints: JointParameters) -> complex:
    return stiffness * (1.0 + 1j * joints.loss_factor)
