"""Build Tian's drive as the paper does: couple the receptances of three substructures, Eqs. (1)-(24).

It is what the closed form of the product is compared with, a fiftieth as fast, and says what the screw does inside the
nut. Array level; any leading axes (frequency, position, draw) are carried along. Points are indices into the last two
axes of a receptance, which holds the response at the row's point to a force (or torque) at the column's point.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, MotorEnd, require_position
from monitor_core.models.published.receptance.parameters import JointParameters, ReceptanceParameters
from monitor_core.models.rod import rod_receptance, wave_number


def joint_receptance(omega: FloatArray, stiffness: complex, damping: float) -> ComplexArray:
    r"""Return the receptance of a spring and a damper side by side.

    .. math:: h_J = \frac{1}{k + j \omega c}

    Eqs. (6) and (8) of Tian et al.; ω [rad/s] and the result [m/N or rad/(N·m)] have the shape (n_frequencies,). The
    stiffness k [N/m or N·m/rad] is complex if the spring has a loss factor; the damping c is in N·s/m or N·m·s/rad.
    ``OutsideValidityError`` if there is neither stiffness nor damping: what does not hold must be left out. As printed,
    Eqs. (6) and (8) are the reciprocal of a receptance, see docs/reference/errata.md.
    """
    if stiffness == 0.0 and damping == 0.0:
        raise OutsideValidityError("a joint must have stiffness or damping; got 0 N/m and 0 N·s/m, leave it out")
    return np.asarray(1.0 / (stiffness + 1j * omega * damping), dtype=np.complex128)


def couple_receptances(
    receptance_a: npt.ArrayLike,
    receptance_b: npt.ArrayLike,
    points: tuple[int, int],
    *,
    joint: npt.ArrayLike = 0.0,
    keep: Sequence[int] | None = None,
) -> ComplexArray:
    r"""Couple a point of substructure A with a point of substructure B.

    .. math::

        \mathbf H = \begin{bmatrix} \mathbf H_A & 0 \\ 0 & \mathbf H_B \end{bmatrix}
        - \mathbf v \left[ h_{A,aa} + h_{B,bb} + h_J \right]^{-1} \mathbf w^T

    with v and w the columns and rows of a and, negative, b. Eqs. (4), (13), (17), (23) and (24) of Tian et al. with h_J
    = 0, rigid coupling. What holds in the joint is the force that closes the gap between both points.

    The receptances of A and B, shapes (..., n_a, n_a) and (..., n_b, n_b), are in m/N or any other response per unit of
    its own excitation, and so is h_J of the joint, shape (...). The points are a of A and b of B; those of the assembly
    to keep are counted with A first (0 … n_a − 1), then B (n_a …), and all are kept if none are given. The result has
    the shape (..., n_keep, n_keep). ``OutsideValidityError`` if a receptance is not square, a point does not exist, or
    the leading axes do not match.

    Examples
    --------
    Two masses of 1 kg, rigidly coupled, at 1 rad/s: −1/(ω² 2 kg)

    >>> couple_receptances([[-1.0]], [[-1.0]], (0, 0), keep=[0]).item()
    (-0.5+0j)
    """
    h_a, h_b = _receptance(receptance_a, "A"), _receptance(receptance_b, "B")
    n_a, n_b = h_a.shape[-1], h_b.shape[-1]
    a, b = _point(points[0], n_a, "A"), _point(points[1], n_b, "B")
    kept = _kept(keep, n_a + n_b)
    leading = _leading_axes(h_a.shape[:-2], h_b.shape[:-2], np.shape(joint))

    side_by_side = np.zeros((*leading, n_a + n_b, n_a + n_b), dtype=np.complex128)
    side_by_side[..., :n_a, :n_a] = h_a
    side_by_side[..., n_a:, n_a:] = h_b
    moved = side_by_side[..., :, a] - side_by_side[..., :, n_a + b]  # by a unit force in the joint
    opened = side_by_side[..., a, :] - side_by_side[..., n_a + b, :]  # gap per unit excitation of each point
    gap = h_a[..., a, a] + h_b[..., b, b] + np.asarray(joint)
    return _closed(side_by_side[..., kept[:, None], kept], moved[..., kept], opened[..., kept], gap)


def ground_receptance(
    receptance: npt.ArrayLike, point: int, *, joint: npt.ArrayLike = 0.0, keep: Sequence[int] | None = None
) -> ComplexArray:
    r"""Hold a point of a substructure against the ground: coupling with a bed of no receptance, h = 0.

    .. math:: \mathbf H = \mathbf H_A - \mathbf h_{\cdot a} \left[ h_{aa} + h_J \right]^{-1} \mathbf h_{a \cdot}

    Eqs. (5), (7) and (9) of Tian et al. The receptance has the shape (..., n, n); joint, kept points, units, errors and
    what is returned are as for :func:`couple_receptances`.
    """
    h = _receptance(receptance, "A")
    a, kept = _point(point, h.shape[-1], "A"), _kept(keep, h.shape[-1])
    _leading_axes(h.shape[:-2], np.shape(joint))
    gap = h[..., a, a] + np.asarray(joint)
    return _closed(h[..., kept[:, None], kept], h[..., kept, a], h[..., a, kept], gap)


def _closed(
    receptance: ComplexArray, column: ComplexArray, row: ComplexArray, gap: npt.NDArray[np.complex128]
) -> ComplexArray:
    return np.asarray(receptance - column[..., :, None] * (row / gap[..., None])[..., None, :])


def _receptance(values: npt.ArrayLike, name: str) -> ComplexArray:
    array = np.asarray(values, dtype=np.complex128)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        raise OutsideValidityError(f"the receptance of {name} must be square in its last two axes; got {array.shape}")
    return array


def _point(point: int, n_points: int, name: str) -> int:
    if not 0 <= point < n_points:
        raise OutsideValidityError(f"{name} has points 0 to {n_points - 1}; got {point}")
    return point


def _kept(keep: Sequence[int] | None, n_points: int) -> npt.NDArray[np.intp]:
    kept = range(n_points) if keep is None else keep
    return np.array([_point(point, n_points, "the assembly") for point in kept], dtype=np.intp)


def _leading_axes(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise OutsideValidityError(
            f"substructures and joint must have matching leading axes; got {', '.join(map(str, shapes))}"
        ) from None


def drive_receptance(
    parameters: ReceptanceParameters,
    omega: FloatArray,
    conditions: DriveConditions,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> ComplexArray:
    """Couple the axial, the torsional and the worktable substructure, Eqs. (23) and (24) of Tian et al.

    The result, shape (n_frequencies, 3, 3), is between table (6a), screw inside the nut axially (5a) and in torsion
    (5t), in m/N, rad/N and rad/(N·m), at ω above zero in rad/s. ``OutsideValidityError`` if the position is not on the
    screw, or the piece inside the nut has no mass or no inertia.
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

    The result [m/N], shape (n_frequencies, 3, 3), is between fixed bearing (1), nut (2) and far bearing (4).
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

    The result [rad/(N·m)], shape (n_frequencies, 3, 3), is between motor end (1), nut (2) and far end (4) of the screw.
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

    The result, shape (n_frequencies, 3, 3), is between table (6a), segment F axially (5a) and in torsion (5t), in m/N,
    rad/N and rad/(N·m). ``OutsideValidityError`` if segment F has no mass or no inertia: alone, it then has no
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

    .. math:: \mathbf K_W = k_n \, \mathbf v \mathbf v^T, \qquad \mathbf v = (1, -1, -i_b)

    from the energy ½ k_n (x_b − x_s − i_b θ)²: Eqs. (19) and (20) of Tian et al. without their misprint. The ratio i_b,
    Eq. (21), is in m/rad; the pattern has the shape (3, 3). The paper prints −i_b k_n between table and axial screw,
    where −k_n is right, see docs/reference/errata.md.
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
