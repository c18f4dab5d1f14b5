"""Give a drive to whoever designs its controller: real matrices A, B, C, D of few modes, and the error they make."""

from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, DriveModel
from monitor_core.models.published.hybrid import HybridModel
from monitor_core.models.published.small_drive import SecondOrderSystem, undamped_modes


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """Motor and table of a drive whose motor end is free: by (τ_m/r_g, f_c) [N] to (r_g θ_m, x_t) [m]."""

    drive: HybridModel
    conditions: DriveConditions

    @classmethod
    def of(cls, drive: DriveModel, conditions: DriveConditions) -> "Plant":
        """Return the plant that a drive of the family hybrid is; raises OutsideValidityError for any other."""
        if not isinstance(drive, HybridModel):
            raise OutsideValidityError(
                "the transfer matrix of motor and table is that of the family hybrid, without effects"
            )
        return cls(drive, conditions)

    @property
    def transmission_ratio(self) -> float:
        """r_g [m/rad]."""
        return self.drive.parameters.transmission_ratio

    @property
    def lossless(self) -> "Plant":
        """The same without a loss factor."""
        return replace(self, drive=HybridModel(replace(self.drive.parameters, loss_factor=0.0)))

    def matrix(self, frequency: FloatArray) -> ComplexArray:
        """Return G(jω) at frequencies [Hz], shape (n_frequencies, 2, 2) [m/N]."""
        return self.drive.transfer_matrix(np.asarray(2j * np.pi * frequency, dtype=np.complex128), self.conditions)

    def state_space(self, n_modes: int) -> "StateSpace":
        """Return its lowest modes as :func:`state_space` does."""
        return state_space(self.drive.equations(self.conditions).system, n_modes)


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """ẋ = A x + B u, y = C x + D u, as ``scipy.signal.StateSpace`` and ``control.ss`` take them."""

    A: FloatArray  # shape (2 n_modes, 2 n_modes): modal displacements, then their rates
    B: FloatArray  # shape (2 n_modes, n): by a force on each coordinate
    C: FloatArray  # shape (n, 2 n_modes): each coordinate
    D: FloatArray  # shape (n, n): static share of the modes that are left out

    def __post_init__(self) -> None:
        for name in ("A", "B", "C", "D"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def transfer_matrix(self, s: ComplexArray) -> ComplexArray:
        """Return C (s − A)⁻¹ B + D, shape (n_frequencies, n, n); s in rad/s."""
        s_matrix = np.asarray(s, dtype=np.complex128)[:, None, None]
        states = np.linalg.solve(s_matrix * np.eye(len(self.A)) - self.A, self.B)
        return np.asarray(self.C @ states + self.D, dtype=np.complex128)


def state_space(system: SecondOrderSystem, n_modes: int) -> StateSpace:
    r"""Return the lowest modes of a system, those of the rigid body among them, as a state space.

    .. math::

        \mathbf A &= \begin{bmatrix} 0 & 1 \\ -\boldsymbol\Omega^2 & -\mathbf\Phi^T \mathbf C \mathbf\Phi
        - \operatorname{diag}(\eta_r \omega_r) \end{bmatrix}, \quad
        \mathbf B = \begin{bmatrix} 0 \\ \mathbf\Phi^T \end{bmatrix}, \quad
        \mathbf C = \begin{bmatrix} \mathbf\Phi & 0 \end{bmatrix}, \quad
        \mathbf D = \sum_{r > n} \frac{\boldsymbol\phi_r \boldsymbol\phi_r^T}{\omega_r^2}

    with mass-normalised modes, :math:`\eta_r = \boldsymbol\phi_r^T \operatorname{Im} \mathbf K \boldsymbol\phi_r /
    \omega_r^2`. Ewins, Modal Testing (2000), 2.4 to 2.7 and 5.3.

    A loss factor has no real state space: each mode is given the viscous damping that loses as much at its frequency,
    :math:`2 \zeta_r = \eta_r`. What that and the modes that are left out cost says :func:`relative_error`.
    ``OutsideValidityError`` if the system has not so many modes, or one of the rigid body would be left out.
    """
    omega, shapes = undamped_modes(system)
    n_rigid = int(np.count_nonzero(omega == 0.0))
    if not max(1, n_rigid) <= n_modes <= omega.size:
        raise OutsideValidityError(f"modes must be {max(1, n_rigid)} to {omega.size} of this drive; got {n_modes}")
    lost = np.einsum("in,ij,jn->n", shapes, system.stiffness.imag, shapes)
    viscous = np.divide(lost, omega, out=np.zeros_like(omega), where=omega > 0.0)
    taken, left = shapes[:, :n_modes], shapes[:, n_modes:] / omega[n_modes:]
    damping = taken.T @ system.damping @ taken + np.diag(viscous[:n_modes])
    nothing = np.zeros((n_modes, n_modes))
    return StateSpace(
        A=np.block([[nothing, np.eye(n_modes)], [nothing - np.diag(omega[:n_modes] ** 2), -damping]]),
        B=np.vstack([np.zeros_like(taken.T), taken.T]),
        C=np.hstack([taken, np.zeros_like(taken)]),
        D=left @ left.T,
    )


def relative_error(exact: ComplexArray, reduced: ComplexArray) -> float:
    r"""Return the largest :math:`\lVert \mathbf G - \mathbf G_n \rVert_2 / \lVert \mathbf G \rVert_2` of all lines.

    Both have the shape (n_frequencies, n, n), in one unit: the norm is the largest singular value, which no
    antiresonance of a single element takes to zero.
    """
    apart: FloatArray = np.linalg.norm(exact - reduced, 2, axis=(1, 2)) / np.linalg.norm(exact, 2, axis=(1, 2))
    return float(apart.max())
