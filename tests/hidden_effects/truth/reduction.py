"""The matrices of a structure, and few coordinates for many: modes, and what modes left out yield where forces act."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

#: A little stiffness everywhere, so that a structure that is free to move yields a finite amount. [rad/s]
_SHIFT = 2.0 * np.pi * 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A spring between the ends of a deflection, with the loss of joints."""

    direction: np.ndarray  # deflection per degree of freedom, shape (n_dof,)
    stiffness: float  # [N/m or N·m/rad]


@dataclass(frozen=True, slots=True, eq=False)
class NutPath:
    """The nut, spring and damper side by side, in series with the bracket; an infinite one leaves the nut alone."""

    direction: np.ndarray  # deflection of both per degree of freedom, shape (n_dof,)
    bracket: float  # [N/m]
    nut: float  # [N/m]
    damping: float  # [N·s/m]


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Matrices of shape (n_dof, n_dof) without joints and nut, which stand beside them."""

    mass: np.ndarray
    screw: np.ndarray  # stiffness of its steel
    stiffness: np.ndarray  # of all else that loses nothing
    damping: np.ndarray
    joints: tuple[Joint, ...]
    path: NutPath
    table: np.ndarray  # direction of its displacement, shape (n_dof,)
    rotor: np.ndarray

    @property
    def whole_stiffness(self) -> np.ndarray:
        """Everything that is elastic, nut and bracket in series. [N/m]."""
        path = self.path
        in_series = Joint(path.direction, 1.0 / (1.0 / path.bracket + 1.0 / path.nut))
        joints = (*self.joints, in_series)
        return (
            self.screw
            + self.stiffness
            + sum(joint.stiffness * np.outer(joint.direction, joint.direction) for joint in joints)
        )


def reduced_basis(mass: np.ndarray, stiffness: np.ndarray, loaded: np.ndarray, n_modes: int) -> np.ndarray:
    """Return a mass-normal basis of the lowest modes and of attachment modes, shape (n, n_modes + n_loads).

    Parameters
    ----------
    mass, stiffness : ndarray, shape (n, n)
    loaded : ndarray, shape (n, n_loads)
        Directions in which forces act: joints, dampers, bodies.
    n_modes : int
        Normal modes, rigid-body modes included.
    """
    _, modes = scipy.linalg.eigh(stiffness, mass, subset_by_index=[0, n_modes - 1])
    yielded = scipy.linalg.solve(stiffness + _SHIFT**2 * mass, loaded, assume_a="pos")
    yielded -= modes @ (modes.T @ mass @ yielded)
    yielded /= np.sqrt(np.einsum("ij,ij->j", yielded, mass @ yielded))
    upper = scipy.linalg.cholesky(yielded.T @ mass @ yielded)
    return np.hstack([modes, scipy.linalg.solve_triangular(upper.T, yielded.T, lower=True).T])
