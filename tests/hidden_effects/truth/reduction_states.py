"""A structure in first order: few coordinates, the memory of its joints and its nut, and the sensor at the table."""

import math

import numpy as np

from tests.hidden_effects.truth.axis import Hidden
from tests.hidden_effects.truth.maxwell import MaxwellChain, maxwell_chain
from tests.hidden_effects.truth.oscillators import StateSpace
from tests.hidden_effects.truth.reduction import Structure, reduced_basis

#: Up to about 10 kHz; what the others yield is in the attachment modes.
N_MODES = 16
#: Outputs. The last two are what the accelerometer stands on.
_ACCELERATION, _ANGLE, _VELOCITY, _DEFLECTION, _SEEN, _SEEN_VELOCITY = range(6)


def state_space(structure: Structure, hidden: Hidden, travel_per_angle: float) -> StateSpace:
    """Return the plant: inputs torque on the rotor, force on the table, excess force in the nut.

    Outputs are the accelerometer at the table, the angle of the rotor, the velocity of the table and the deflection of
    the nut.
    """
    system = _drive(structure, maxwell_chain(hidden.loss_factor), maxwell_chain(hidden.screw_loss_factor))
    if hidden.structure_residue:
        system = _riding(system, hidden, travel_per_angle)
    if math.isfinite(hidden.mounting_frequency):
        system = _mounted(system, hidden)
    return StateSpace(system.a, system.b, system.c[:_SEEN], system.d[:_SEEN])


def _drive(structure: Structure, chain: MaxwellChain, steel: MaxwellChain) -> StateSpace:
    """Return the drive.

    Its states are displacements and velocities of the reduced coordinates, the deflection of the nut, and the dashpots
    of every joint, of the bracket and of the nut, and of each coordinate as the steel of the screw remembers it.
    """
    path, joints = structure.path, structure.joints
    loaded = [path.direction, structure.table, structure.rotor, *(joint.direction for joint in joints)]
    basis = reduced_basis(structure.mass, structure.whole_stiffness, np.array(loaded).T, N_MODES)
    n = basis.shape[1]
    moved, moving, nut = slice(0, n), slice(n, 2 * n), 2 * n
    of_joints = nut + 1 + chain.share.size * (len(joints) + 2)
    size = of_joints + n * steel.share.size
    a, b, c = np.zeros((size, size)), np.zeros((size, 3)), np.zeros((6, size))
    a[moved, moving] = np.eye(n)
    screw = basis.T @ structure.screw @ basis
    a[moving, moved] = -basis.T @ structure.stiffness @ basis - (steel.constant + steel.share.sum()) * screw
    for index, (share, time) in enumerate(zip(steel.share, steel.time, strict=True)):
        remembered = slice(of_joints + n * index, of_joints + n * (index + 1))
        a[moving, remembered] = share * screw
        a[remembered, moved], a[remembered, remembered] = np.eye(n) / time, -np.eye(n) / time
    a[moving, moving] = -basis.T @ structure.damping @ basis
    b[moving, 0], b[moving, 1] = basis.T @ structure.rotor, basis.T @ structure.table

    first = nut + 1
    for joint in joints:
        elongation = np.zeros(size)
        elongation[moved] = basis.T @ joint.direction
        force = joint.stiffness * _remembered(a, elongation, chain, first)
        a[moving] -= np.outer(elongation[moved], force)
        first += chain.share.size
    contact, alone = basis.T @ path.direction, np.zeros(size)
    if math.isinf(path.bracket):  # what the nut carries has a mass of its own
        alone[moved] = contact
        a[moving] -= np.outer(contact, path.nut * _remembered(a, alone, chain, first))
        a[moving, moving] -= path.damping * np.outer(contact, contact)
        a[nut, nut] = -1.0  # nothing stands for it
        b[moving, 2] = -contact
        c[_DEFLECTION, moved] = contact
    else:
        bracket = np.zeros(size)
        bracket[moved], bracket[nut], alone[nut] = contact, -1.0, 1.0
        force = path.bracket * _remembered(a, bracket, chain, first)
        a[moving] -= np.outer(bracket[moved], force)
        a[nut] = (force - path.nut * _remembered(a, alone, chain, first + chain.share.size)) / path.damping
        b[nut, 2] = -1.0 / path.damping
        c[_DEFLECTION, nut] = 1.0

    table = basis.T @ structure.table
    c[_ACCELERATION], c[_ANGLE, moved] = table @ a[moving], basis.T @ structure.rotor
    c[_SEEN, moved] = c[_VELOCITY, moving] = c[_SEEN_VELOCITY, moving] = table
    d = np.zeros((6, 3))
    d[_ACCELERATION] = table @ b[moving]
    return StateSpace(a, b, c, d)


def _remembered(a: np.ndarray, elongation: np.ndarray, chain: MaxwellChain, first: int) -> np.ndarray:
    """Let dashpots follow an elongation and return the force per stiffness as a row over the states."""
    force = elongation * (chain.constant + chain.share.sum())
    for index, (share, time) in enumerate(zip(chain.share, chain.time, strict=True), start=first):
        a[index] = elongation / time
        a[index, index] -= 1.0 / time
        force[index] -= share
    return force


def _riding(system: StateSpace, hidden: Hidden, travel_per_angle: float) -> StateSpace:
    """Let the table ride on a structure that the force of the drive, torque over travel per angle, moves."""
    larger, row = _with_oscillator(system, hidden.structure_frequency, hidden.structure_damping_ratio)
    larger.b[row, 0] = hidden.structure_residue / travel_per_angle
    larger.c[_ACCELERATION] += larger.a[row]
    larger.d[_ACCELERATION] += larger.b[row]
    larger.c[_SEEN, row - 1] = larger.c[_SEEN_VELOCITY, row] = 1.0
    return larger


def _mounted(system: StateSpace, hidden: Hidden) -> StateSpace:
    """Let the accelerometer be a mass on the spring and damper of its mounting."""
    larger, row = _with_oscillator(system, hidden.mounting_frequency, hidden.mounting_damping_ratio)
    omega = 2.0 * math.pi * hidden.mounting_frequency
    larger.a[row] += omega**2 * larger.c[_SEEN] + 2.0 * hidden.mounting_damping_ratio * omega * larger.c[_SEEN_VELOCITY]
    larger.c[_ACCELERATION], larger.d[_ACCELERATION] = larger.a[row], 0.0
    return larger


def _with_oscillator(system: StateSpace, frequency: float, damping_ratio: float) -> tuple[StateSpace, int]:
    """Return the plant with an oscillator that nothing drives yet, and the row of its velocity."""
    omega, row = 2.0 * math.pi * frequency, len(system.a) + 1
    a, b, c = np.pad(system.a, (0, 2)), np.pad(system.b, ((0, 2), (0, 0))), np.pad(system.c, ((0, 0), (0, 2)))
    a[row - 1, row] = 1.0
    a[row, row - 1 :] = -(omega**2), -2.0 * damping_ratio * omega
    return StateSpace(a, b, c, system.d.copy()), row
