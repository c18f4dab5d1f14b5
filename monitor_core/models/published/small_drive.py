"""Answer for a drive of few degrees of freedom, M q̈ + C q̇ + K q = f: responses, natural frequencies and normal modes.

Its springs may lose energy by a loss factor, which belongs to the frequency domain. With a complex stiffness the
equations of motion have, besides the decaying solution that oscillates with ω > 0, one with ω < 0 that grows: they must
not be integrated in time.
"""

import cmath
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray, read_only, read_only_complex
from monitor_core.errors import OutsideValidityError
from monitor_core.models.bracket import BeyondContacts, nut_from_table
from monitor_core.models.protocol import (
    DriveConditions,
    ExcitationPoint,
    MotorEnd,
    NaturalFrequency,
    NormalModes,
    ResponsePoint,
    motor_end_of,
    quantity_of,
    require_frequencies,
)
from monitor_core.response import FrequencyResponse


def complex_stiffness(stiffness: float, loss_factor: float) -> complex:
    r"""Return the stiffness of a spring with hysteretic damping.

    .. math:: \hat k = k (1 + j \eta)

    Section 3 of Sun et al. (2022), for positive frequencies; k in N/m or N·m/rad. A joint that does not give, of
    infinite k, does not lose energy either.
    """
    return complex(math.inf, 0.0) if math.isinf(stiffness) else stiffness * complex(1.0, loss_factor)


def series_stiffness(*stiffnesses: complex) -> complex:
    r"""Return the stiffness of springs in series.

    .. math:: \hat k = \left[ \sum_i \frac{1}{\hat k_i} \right]^{-1} = k (1 + j \eta_e)

    Eqs. (5) and (14) of Sun et al. (2022). Infinite ones do not count; ``OutsideValidityError`` if one of them is zero,
    or none is finite: the chain would be open, or rigid.

    Examples
    --------
    Half of each of two equal springs, and a rigid bracket:

    >>> series_stiffness(complex_stiffness(2.0, 0.1), complex_stiffness(2.0, 0.1), complex_stiffness(math.inf, 0.1))
    (1+0.1j)
    """
    finite = [k for k in map(complex, stiffnesses) if cmath.isfinite(k)]
    if not finite or 0.0 in finite:
        raise OutsideValidityError(f"springs in series must not be zero, nor all of them infinite; got {stiffnesses}")
    return 1.0 / sum(1.0 / k for k in finite)


def effective_loss_factor(stiffness: complex) -> float:
    """Return η_e of k(1 + jη_e), Eq. (14) of Sun et al. (2022), without unit."""
    return stiffness.imag / stiffness.real


def equivalent_viscous_damping(stiffness: npt.ArrayLike, omega: float) -> FloatArray:
    r"""Return the viscous damping that loses as much energy in a cycle at one frequency.

    .. math:: c = \frac{\eta_e k}{\omega}

    from :math:`j \omega c = j \eta_e k`; for the time domain, in which a complex stiffness must not be used. The
    stiffness k(1 + jη_e) [N/m or N·m/rad] is one spring's or a matrix, and the result [N·s/m or N·m·s/rad] has its
    shape. Both lose the same at omega [rad/s], the resonance; ``OutsideValidityError`` if it is not positive.

    Examples
    --------
    >>> float(equivalent_viscous_damping(100.0 + 4.0j, 2.0))
    2.0
    """
    if not (math.isfinite(omega) and omega > 0.0):
        raise OutsideValidityError(f"omega must be positive; got {omega} rad/s")
    return np.asarray(np.imag(np.asarray(stiffness, dtype=np.complex128)) / omega)


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
    s_matrix = s[:, None, None]
    return np.asarray(np.linalg.inv(system.mass * s_matrix**2 + system.damping * s_matrix + system.stiffness))


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
    _, _, values = modes_and_poles(system)
    return values[np.argsort(np.abs(values), kind="stable")]


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


@dataclass(frozen=True, slots=True, eq=False)
class DriveEquations:
    """A drive as a small system, and the two points at which it is driven and watched.

    The row that picks a displacement is also the column by which a force on it acts (virtual work); so reciprocity
    is built in.
    """

    system: SecondOrderSystem
    angle_at_motor: FloatArray  # shape (n,): angle = row · q [rad per coordinate]; zeros where it is clamped
    displacement_at_table: FloatArray  # shape (n,): displacement = row · q [m per coordinate]

    def __post_init__(self) -> None:
        for name in ("angle_at_motor", "displacement_at_table"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            if getattr(self, name).shape != self.system.mass.shape[:1]:
                raise OutsideValidityError(f"{name} must have one number for each of the coordinates")


def drive_response(
    equations: DriveEquations,
    frequency: FloatArray,
    excitation: ExcitationPoint,
    response: ResponsePoint,
    beyond: Callable[[ComplexArray], BeyondContacts] | None = None,
) -> FrequencyResponse:
    """Return a frequency response of a drive at frequencies above zero [Hz], shape (n_frequencies,).

    ``beyond`` tells from jω what the contacts of the nut carry; without it the nut is one with the table. The angle of
    a clamped motor end raises ``OutsideValidityError``.
    """
    frequency = require_frequencies(frequency)
    if response is ResponsePoint.ANGLE_AT_MOTOR and not np.any(equations.angle_at_motor):
        raise OutsideValidityError("the motor end is clamped for this excitation and has no angle; excite by a torque")
    omega = 2.0 * np.pi * frequency
    s = np.asarray(1j * omega, dtype=np.complex128)
    of_table = response is not ResponsePoint.ANGLE_AT_MOTOR
    row = equations.displacement_at_table if of_table else equations.angle_at_motor
    to_row = row @ transfer_matrix(equations.system, s)
    per_force: NumberArray = to_row @ equations.displacement_at_table
    per_torque: NumberArray = to_row @ equations.angle_at_motor
    if response is ResponsePoint.ACCELERATION_AT_NUT and beyond is not None:
        per_force, per_torque = nut_from_table(per_force, per_torque, beyond(s))
    chosen = per_force if excitation is ExcitationPoint.FORCE_AT_TABLE else per_torque
    receptance = np.asarray(chosen, dtype=np.complex128)
    if response.is_acceleration:
        receptance = -(omega**2) * receptance
    return FrequencyResponse(frequency, receptance, quantity_of(excitation, response))


def drive_natural_frequencies(equations: DriveEquations) -> tuple[NaturalFrequency, ...]:
    """Return the poles of a drive as natural frequencies and damping ratios, rigid-body mode first."""
    return tuple(_natural_frequency(complex(s)) for s in poles(equations.system))


def drive_normal_modes(equations: DriveEquations) -> NormalModes:
    """Return the undamped modes of a drive, each with the damping ratio of its pole."""
    omega, shapes, own = modes_and_poles(equations.system)
    return NormalModes(
        omega / (2.0 * np.pi),
        np.array([_natural_frequency(complex(s)).damping_ratio for s in own]),
        equations.angle_at_motor @ shapes,
        equations.displacement_at_table @ shapes,
    )


def _natural_frequency(pole: complex) -> NaturalFrequency:
    magnitude = abs(pole)
    return NaturalFrequency(magnitude / (2.0 * np.pi), (0.0 - pole.real) / magnitude if pole else 0.0)


class SmallDrive(ABC):
    """A drive model whose equations of motion are a small system; the lumped and the hybrid model are such drives."""

    __slots__ = ()
    paper_motor_end: ClassVar[MotorEnd]  #: where no torque is given and nothing else is stated

    @abstractmethod
    def equations(self, conditions: DriveConditions, motor_end: MotorEnd) -> DriveEquations:
        """Return the matrices under the conditions, with a motor end."""

    @abstractmethod
    def beyond_contacts(self, s: ComplexArray, conditions: DriveConditions) -> BeyondContacts:
        """Return what the contacts of the nut carry at s = jω, for an accelerometer on the nut."""

    def frequency_response(
        self,
        frequency: FloatArray,
        conditions: DriveConditions,
        *,
        excitation: ExcitationPoint,
        response: ResponsePoint,
    ) -> FrequencyResponse:
        """Return the response per unit excitation; a force at the table finds the motor end as in the paper."""
        equations = self.equations(conditions, motor_end_of(excitation, otherwise=self.paper_motor_end))
        return drive_response(equations, frequency, excitation, response, lambda s: self.beyond_contacts(s, conditions))

    def natural_frequencies(
        self, conditions: DriveConditions, motor_end: MotorEnd | None = None
    ) -> tuple[NaturalFrequency, ...]:
        """Return the poles in order of frequency, rigid-body mode first."""
        return drive_natural_frequencies(self.equations(conditions, motor_end or self.paper_motor_end))

    def normal_modes(self, conditions: DriveConditions, motor_end: MotorEnd | None = None) -> NormalModes:
        """Return the undamped modes, each with the damping ratio of its pole."""
        return drive_normal_modes(self.equations(conditions, motor_end or self.paper_motor_end))
