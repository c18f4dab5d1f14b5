"""Locate all poles of Tian's drive by discretising its rods, closely enough to start the exact search.

Each of the two pieces of screw is one element whose shape functions are the two straight lines of its ends and the
integrals of Legendre polynomials. Their error falls exponentially with the degree, so a small eigenvalue problem finds
every low pole once; a search on the exact characteristic function cannot guarantee that.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.protocol import DriveConditions, MotorEnd, require_position
from monitor_core.models.published.receptance.parameters import JointParameters, ReceptanceParameters

#: Of the polynomials in each piece. The eighth mode has at most seven half waves on the screw; 18 resolve it to 1e-6.
_DEGREE = 18
#: Of the screw in one direction: near end, nut, far end, and the polynomials of both pieces.
_N_SCREW = 3 + 2 * (_DEGREE - 1)
_NEAR, _NUT, _FAR = 0, 1, 2
#: A pole whose imaginary part is a smaller share than this of its magnitude does not oscillate.
_OSCILLATING = 1e-6
#: A pole slower than this share of the first natural frequency is the rest of a rigid body's motion. [-]
_RIGID = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class DiscreteDrive:
    """Matrices of the discretised drive, shape (n, n): M q̈ + C q̇ + (K + (1 + jη) K_joints) q = f.

    With a bracket, K_joints holds nut and bracket in series, and the nut's damper is not in C: it lies parallel to the
    nut alone.
    """

    mass: FloatArray
    screw_stiffness: FloatArray
    joint_stiffness: FloatArray
    damping: FloatArray
    nut_deflection: FloatArray  # v of the deflection v·q of nut and bracket, shape (n,)
    joints: JointParameters
    free: bool  # has a rigid-body mode

    @property
    def nut_relaxes(self) -> bool:
        """Whether the bracket can spring back while the nut's damper holds."""
        return math.isfinite(self.joints.bracket_stiffness) and self.joints.nut_damping > 0.0


def discretise(parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd) -> DiscreteDrive:
    """Assemble the matrices of the drive at a position, with a motor end."""
    joints = parameters.joints(conditions)
    # degrees of freedom: axial screw, torsional screw (each: near end, nut, far end, bubbles), table, rotor
    table, rotor = 2 * _N_SCREW, 2 * _N_SCREW + 1
    size = 2 * _N_SCREW + (2 if motor_end is MotorEnd.FREE else 1)

    def deflection(*points: tuple[int, float]) -> FloatArray:
        vector = np.zeros(size)
        for point, factor in points:
            vector[point] = factor
        return vector

    nut = deflection((table, 1.0), (_NUT, -1.0), (_N_SCREW + _NUT, -parameters.transmission_ratio))
    nut_damping = joints.nut_damping if math.isinf(joints.bracket_stiffness) else 0.0
    springs = [
        (deflection((_NEAR, 1.0)), joints.bearing_stiffness, joints.bearing_damping),
        (deflection((_FAR, 1.0)), joints.far_bearing_stiffness, joints.far_bearing_damping),
        (nut, _nut_and_bracket(joints), nut_damping),
        (deflection((table, 1.0)), 0.0, parameters.table_damping),
    ]
    bodies = [
        (table, parameters.moving_mass(conditions.payload_mass)),
        (_NUT, parameters.screw_nut_segment_mass),
        (_N_SCREW + _NUT, parameters.screw_nut_segment_inertia),
        (_N_SCREW + _NEAR, parameters.screw_motor_segment_inertia),
    ]
    coupling = (joints.coupling_stiffness, joints.coupling_damping)
    match motor_end:
        case MotorEnd.CLAMPED:
            springs.append((deflection((_N_SCREW + _NEAR, 1.0)), *coupling))
        case MotorEnd.FREE:
            springs.append((deflection((_N_SCREW + _NEAR, 1.0), (rotor, -1.0)), *coupling))
            springs.append((deflection((rotor, 1.0)), 0.0, parameters.motor_damping))
            bodies.append((rotor, parameters.rotor_inertia))

    screw_mass, screw_stiffness = _screw(parameters, require_position(conditions.position, parameters.screw_length))
    added = (0, size - 2 * _N_SCREW)
    return DiscreteDrive(
        np.pad(screw_mass, added) + sum(np.diag(body * deflection((point, 1.0))) for point, body in bodies),
        np.pad(screw_stiffness, added),
        np.asarray(sum(stiffness * np.outer(vector, vector) for vector, stiffness, _ in springs)),
        np.asarray(sum(damping * np.outer(vector, vector) for vector, _, damping in springs)),
        nut,
        joints,
        motor_end is not MotorEnd.CLAMPED,
    )


def _screw(parameters: ReceptanceParameters, position: float) -> tuple[FloatArray, FloatArray]:
    """Return mass and stiffness of the free screw, axial and torsional, shape (2 _N_SCREW, 2 _N_SCREW)."""
    mass, stiffness = np.zeros((2 * _N_SCREW, 2 * _N_SCREW)), np.zeros((2 * _N_SCREW, 2 * _N_SCREW))
    for first, rigidity, modulus in (
        (0, parameters.axial_rigidity, parameters.youngs_modulus),
        (_N_SCREW, parameters.torsional_rigidity, parameters.shear_modulus),
    ):
        inertia = rigidity * parameters.density / modulus  # ρS or ρJ
        for end, length, bubbles in (
            (_NEAR, position, 3),
            (_FAR, parameters.screw_length - position, 3 + _DEGREE - 1),
        ):
            points = first + np.r_[end, _NUT, bubbles : bubbles + _DEGREE - 1]
            stiffness[np.ix_(points, points)] += rigidity / length * _ELEMENT_STIFFNESS
            mass[np.ix_(points, points)] += inertia * length * _ELEMENT_MASS
    return mass, stiffness


def undamped_modes(drive: DiscreteDrive, n: int) -> tuple[FloatArray, FloatArray]:
    """Return ω² of the lowest n elastic modes, rising [1/s²], and their shapes by columns, mass-normalised [1/√kg].

    Found from 1/(ω² + σ), the largest of which rounding spares: with the nut near an end of the screw the piece beside
    it is so stiff that ω² itself would drown in it.
    """
    table = drive.nut_deflection.nonzero()[0][-1]
    shift = drive.joint_stiffness[table, table] / drive.mass[table, table]
    stiffness = drive.screw_stiffness + drive.joint_stiffness
    last = drive.mass.shape[0] - 1 - (1 if drive.free else 0)
    inverse, shapes = scipy.linalg.eigh(
        drive.mass, stiffness + shift * drive.mass, subset_by_index=(max(last - n + 1, 0), last)
    )
    return 1.0 / inverse[::-1] - shift, (shapes / np.sqrt(inverse))[:, ::-1]


def undamped_frequencies(drive: DiscreteDrive) -> FloatArray:
    """Return the undamped natural frequencies of the elastic modes in rising order [rad/s]."""
    square, _ = undamped_modes(drive, drive.mass.shape[0])
    return np.asarray(np.sqrt(square))


def oscillating_poles(drive: DiscreteDrive) -> ComplexArray:
    """Return the poles of the elastic modes that oscillate, Im s > 0, in order of |s| [1/s]."""
    square, shapes = scipy.linalg.eigh(drive.screw_stiffness + drive.joint_stiffness, drive.mass)
    elastic = slice(1 if drive.free else 0, None)
    n, n_elastic = square.size, square[elastic].size
    loss_factor = drive.joints.loss_factor
    stiffness = np.diag(square) + 1j * loss_factor * shapes.T @ drive.joint_stiffness @ shapes
    # states: displacement of the elastic modes, velocity of all. The rigid-body displacement acts on nothing; kept, it
    # would be half of a double pole at zero, which rounding scatters.
    state = np.zeros((n_elastic + n, n_elastic + n), dtype=np.complex128)
    state[:n_elastic, n_elastic:][:, elastic] = np.eye(n_elastic)
    state[n_elastic:, :n_elastic] = -stiffness[:, elastic]
    state[n_elastic:, n_elastic:] = -shapes.T @ drive.damping @ shapes
    if drive.nut_relaxes:
        state = _with_nut_deflection(state, drive, drive.nut_deflection @ shapes, n_elastic)
    poles: ComplexArray = scipy.linalg.eigvals(state if loss_factor else state.real)
    # A loss factor turns real poles a little out of the real axis, by less than itself. The speed of a rigid body is a
    # pole at zero, which comes out as rounding: complex rounding, with a loss factor.
    slowest = _RIGID * np.sqrt(np.abs(square[elastic][0]))
    poles = poles[(poles.imag > max(_OSCILLATING, loss_factor) * np.abs(poles)) & (np.abs(poles) > slowest)]
    return poles[np.argsort(np.abs(poles))]


def _with_nut_deflection(
    state: ComplexArray, drive: DiscreteDrive, deflection: FloatArray, n_elastic: int
) -> ComplexArray:
    """Add the deflection e of the nut alone as a state: c ė + k e = k_bracket (v·q − e)."""
    elastic = 1.0 + 1j * drive.joints.loss_factor
    bracket, nut = drive.joints.bracket_stiffness * elastic, drive.joints.nut_stiffness * elastic
    size = len(state)
    larger = np.zeros((size + 1, size + 1), dtype=np.complex128)
    larger[:size, :size] = state
    stretched = deflection[-n_elastic:]
    stiffening = bracket - _nut_and_bracket(drive.joints) * elastic
    larger[n_elastic:size, :n_elastic] -= stiffening * np.outer(deflection, stretched)
    larger[n_elastic:size, size] = bracket * deflection
    larger[size, :n_elastic] = bracket * stretched / drive.joints.nut_damping
    larger[size, size] = -(bracket + nut) / drive.joints.nut_damping
    return larger


def _nut_and_bracket(joints: JointParameters) -> float:
    """Return the stiffness of nut and bracket in series [N/m]."""
    return 1.0 / (1.0 / joints.nut_stiffness + 1.0 / joints.bracket_stiffness)


def _element_matrices(degree: int) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and mass of an element of unit length, rigidity and inertia, shape (degree + 1, degree + 1)."""
    node, weight = np.polynomial.legendre.leggauss(degree + 1)
    legendre = np.polynomial.legendre.legvander(node, degree)
    k = np.arange(2, degree + 1)
    bubbles = (legendre[:, 2:] - legendre[:, :-2]) / np.sqrt(2.0 * (2.0 * k - 1.0))  # ∫ P_{k−1}, of unit stiffness
    shape = np.column_stack([(1.0 - node) / 2.0, (1.0 + node) / 2.0, bubbles])
    stiffness = 2.0 * np.eye(degree + 1)
    stiffness[:2, :2] = [[1.0, -1.0], [-1.0, 1.0]]
    return stiffness, np.asarray(shape.T @ (0.5 * weight[:, None] * shape), dtype=np.float64)


_ELEMENT_STIFFNESS, _ELEMENT_MASS = _element_matrices(_DEGREE)
