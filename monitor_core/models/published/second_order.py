"""Solve systems of few degrees of freedom, M q̈ + C q̇ + K q = f: response, undamped modes and poles."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from monitor_core.arrays import ComplexArray, FloatArray, read_only, read_only_complex
from monitor_core.errors import OutsideValidityError

#: A mode whose springs cancel to this share of what each of them stores is one of the rigid body.
_RIGID = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class SecondOrderSystem:
    """Matrices of a linear system with n degrees of freedom, in the units of its coordinates."""

    mass: FloatArray  # M, shape (n, n), symmetric and positive definite
    damping: FloatArray  # C, shape (n, n): viscous
    stiffness: ComplexArray  # K, shape (n, n); complex if springs have a loss factor

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", read_only(self.mass))
        object.__setattr__(self, "damping", read_only(self.damping))
        object.__setattr__(self, "stiffness", read_only_complex(self.stiffness))
        shapes = (self.mass.shape, self.damping.shape, self.stiffness.shape)
        if len(set(shapes)) != 1 or self.mass.ndim != 2 or self.mass.shape[0] != self.mass.shape[1]:
            raise OutsideValidityError(f"M, C and K must be square and of one size; got {shapes}")


def transfer_matrix(system: SecondOrderSystem, s: ComplexArray) -> ComplexArray:
    r"""Return all responses of a system to all excitations, row per unit of column, shape (n_frequencies, n, n).

    .. math:: \mathbf G(s) = (\mathbf M s^2 + \mathbf C s + \mathbf K)^{-1}

    Eq. (13) of Sun et al. (2022), at s = jω for a frequency response, shape (n_frequencies,) [rad/s]. With a complex
    stiffness, which stands for ω > 0 only, an s beyond the upper half plane raises ``OutsideValidityError``.
    """
    s = np.asarray(s, dtype=np.complex128)
    if np.any(system.stiffness.imag) and not np.all(s.imag > 0.0):
        raise OutsideValidityError("with a loss factor s must have a positive imaginary part")
    at = s[:, None, None]
    return np.asarray(np.linalg.inv(system.mass * at**2 + system.damping * at + system.stiffness))


def undamped_modes(system: SecondOrderSystem) -> tuple[FloatArray, FloatArray]:
    """Return the modes that the system would have without damping, mass-normalised.

    They are ω, rising, 0 for a rigid-body mode, shape (n_modes,) [rad/s], and Φ with Φᵀ M Φ = 1 and Φᵀ Re(K) Φ =
    diag(ω²), shape (n, n_modes).
    """
    omega_squared, shapes = scipy.linalg.eigh(system.stiffness.real, system.mass)
    # not by comparison with the highest mode, which may be far away: φᵀKφ against |φ|ᵀ|K||φ|
    stored = np.einsum("in,ij,jn->n", np.abs(shapes), np.abs(system.stiffness.real), np.abs(shapes))
    return np.sqrt(np.where(omega_squared > _RIGID * stored, omega_squared, 0.0)), shapes


def poles(system: SecondOrderSystem) -> ComplexArray:
    """Return the pole of each mode that oscillates with ω > 0, in order of magnitude, in rad/s.

    Eigenvalues of the state space; 0 for a rigid-body mode, damped or not. With a complex stiffness they are no
    conjugate pairs, and those with ω < 0 grow; the root with a positive imaginary part is the one that the complex
    stiffness is made for. An elastic mode that is damped beyond critical raises ``OutsideValidityError``.
    """
    _, _, found = modes_and_poles(system)
    return found[np.argsort(np.abs(found), kind="stable")]


def modes_and_poles(system: SecondOrderSystem) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Return ω and shapes of :func:`undamped_modes`, and of each mode its pole; see :func:`poles`.

    Neither magnitude nor frequency tells whose a pole is, as damping shifts close modes past each other. Its own
    motion does: poles go to modes, one to one, so that together they consist of them as far as possible.
    """
    omega, shapes = undamped_modes(system)
    if not (np.any(system.damping) or np.any(system.stiffness.imag)):
        return omega, shapes, np.asarray(1j * omega, dtype=np.complex128)  # without the rounding of eigenvalues
    n_modes, n_rigid = omega.size, int(np.count_nonzero(omega == 0.0))
    state_space = np.zeros((2 * n_modes, 2 * n_modes), dtype=np.complex128)
    state_space[:n_modes, n_modes:] = np.eye(n_modes)
    state_space[n_modes:, :n_modes] = -shapes.T @ system.stiffness @ shapes
    state_space[n_modes:, n_modes:] = -shapes.T @ system.damping @ shapes
    roots, motions = np.linalg.eig(state_space)
    # the two real roots of a damped rigid-body mode may stray off the axis by rounding: take the highest only
    elastic = np.argsort(roots.imag)[n_modes + n_rigid :]
    if np.any(roots[elastic].imag <= 1e-6 * np.abs(roots[elastic])):
        raise OutsideValidityError("an elastic mode is damped beyond critical; it has no natural frequency")
    consists_of = np.abs(motions[:n_modes, elastic]) ** 2
    consists_of /= np.sum(consists_of, axis=0)
    _, pole_of_mode = scipy.optimize.linear_sum_assignment(consists_of[n_rigid:], maximize=True)
    return omega, shapes, np.concatenate([np.zeros(n_rigid), roots[elastic[pole_of_mode]]])
