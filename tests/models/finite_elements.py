"""A ball-screw axis in linear finite elements, the authority for models with a distributed screw.

Written from the masses, springs and dampers of the axis alone; it shares nothing with ``monitor_core.models``. The
screw has two-node elements with consistent mass in tension and torsion; a nut that turns rotation into travel pulls,
through its bracket, at the table. The error falls with the square of the element's length.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Everything in SI units; a spring is (stiffness, damping)."""

    length: float
    diameter: float
    lead: float
    youngs_modulus: float
    shear_modulus: float
    density: float
    table_mass: float
    near_bearing: tuple[float, float]
    far_bearing: tuple[float, float]
    nut: tuple[float, float]
    bracket_stiffness: float | None = None
    coupling: tuple[float, float] | None = None  # None: nothing holds the motor end
    rotor_inertia: float | None = None  # None: the rotor stands still
    rotor_damping: float = 0.0
    table_damping: float = 0.0
    nut_segment_mass: float = 0.0
    nut_segment_inertia: float = 0.0
    motor_segment_inertia: float = 0.0
    loss_factor: float = 0.0


class Assembly:
    """Matrices of an axis, filled part by part, and its response."""

    def __init__(self, axis: Axis, n_near: int, n_far: int, position: float) -> None:
        n_nodes = n_near + n_far + 1
        self.size = 2 * n_nodes + 3
        self.loss_factor = axis.loss_factor
        self.mass, self.damping = (scipy.sparse.lil_matrix((self.size, self.size)) for _ in range(2))
        self.screw, self.springs = (scipy.sparse.lil_matrix((self.size, self.size)) for _ in range(2))
        self.turn = n_nodes  # first torsional degree of freedom
        self.table, self.rotor, self.nut = 2 * n_nodes, 2 * n_nodes + 1, 2 * n_nodes + 2
        self.motor_end = self.turn if axis.rotor_inertia is None else self.rotor
        lengths = [position / n_near] * n_near + [(axis.length - position) / n_far] * n_far
        area, polar = np.pi * axis.diameter**2 / 4, np.pi * axis.diameter**4 / 32
        for k, h in enumerate(lengths):
            for first, stiffness, inertia in (
                (0, axis.youngs_modulus * area, axis.density * area),
                (self.turn, axis.shear_modulus * polar, axis.density * polar),
            ):
                nodes = np.ix_([first + k, first + k + 1], [first + k, first + k + 1])
                self.screw[nodes] += stiffness / h * np.array([[1, -1], [-1, 1]])
                self.mass[nodes] += inertia * h / 6 * np.array([[2, 1], [1, 2]])
        self._joints(axis, n_near, n_nodes - 1)

    def _joints(self, axis: Axis, at: int, end: int) -> None:
        ratio = axis.lead / (2 * np.pi)
        self.mass[self.table, self.table] += axis.table_mass
        self.mass[at, at] += axis.nut_segment_mass
        self.mass[self.turn + at, self.turn + at] += axis.nut_segment_inertia
        self.mass[self.turn, self.turn] += axis.motor_segment_inertia
        self.spring({0: 1.0}, *axis.near_bearing)
        self.spring({end: 1.0}, *axis.far_bearing)
        self.spring({self.table: 1.0}, 0.0, axis.table_damping)
        if axis.bracket_stiffness is None:
            self.spring({self.table: 1.0, at: -1.0, self.turn + at: -ratio}, *axis.nut)
            self.spring({self.nut: 1.0}, 1.0, 0.0)  # nobody is at this point
        else:
            self.spring({self.nut: 1.0, at: -1.0, self.turn + at: -ratio}, *axis.nut)
            self.spring({self.table: 1.0, self.nut: -1.0}, axis.bracket_stiffness, 0.0)
        if axis.rotor_inertia is None:
            self.spring({self.rotor: 1.0}, 1.0, 0.0)
            if axis.coupling is not None:
                self.spring({self.turn: 1.0}, *axis.coupling)
        else:
            self.mass[self.rotor, self.rotor] += axis.rotor_inertia
            self.spring({self.rotor: 1.0}, 0.0, axis.rotor_damping)
            if axis.coupling is not None:
                self.spring({self.turn: 1.0, self.rotor: -1.0}, *axis.coupling)

    def spring(self, deflection: dict[int, float], stiffness: float, damping: float) -> None:
        for i, a in deflection.items():
            for j, b in deflection.items():
                self.springs[i, j] += a * b * stiffness
                self.damping[i, j] += a * b * damping

    def body(self, mass: float, on: int, stiffness: float, damping: float) -> int:
        """Hang a body on another one by a spring and a damper."""
        self.size += 1
        for matrix in (self.mass, self.damping, self.screw, self.springs):
            matrix.resize((self.size, self.size))
        self.mass[self.size - 1, self.size - 1] = mass
        self.spring({self.size - 1: 1.0, on: -1.0}, stiffness, damping)
        return self.size - 1

    def response(self, omega: np.ndarray, point: int) -> np.ndarray:
        """Displacement of table and turn of the motor end per unit load at a point, shape (n_frequencies, 2)."""
        load = np.zeros(self.size, dtype=complex)
        load[point] = 1.0
        stiffness = scipy.sparse.csc_matrix(self.screw + (1 + 1j * self.loss_factor) * self.springs)
        mass, damping = scipy.sparse.csc_matrix(self.mass), scipy.sparse.csc_matrix(self.damping)
        motion = [scipy.sparse.linalg.spsolve(stiffness + 1j * w * damping - w**2 * mass, load) for w in omega]
        return np.array(motion)[:, [self.table, self.motor_end]]

    def modes(self, n_modes: int) -> tuple[np.ndarray, np.ndarray]:
        """Lowest undamped natural frequencies [Hz], and mass-normalised shapes at table and motor end, (n_modes, 2)."""
        used = np.flatnonzero(self.mass.diagonal() > 0)  # not the points that nobody is at
        square, vectors = scipy.linalg.eigh(
            (self.screw + self.springs).toarray()[np.ix_(used, used)],
            self.mass.toarray()[np.ix_(used, used)],
            subset_by_index=(0, n_modes - 1),
        )
        shapes = np.zeros((self.size, n_modes))
        shapes[used] = vectors
        return np.sqrt(np.maximum(square, 0.0)) / (2 * np.pi), shapes[[self.table, self.motor_end]].T
