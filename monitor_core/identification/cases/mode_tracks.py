"""Modes of an axis followed along the screw by their shapes, with what table and nut have to do with each.

In order of frequency two modes change places where the table passes from one side of a veering to the other. Followed
from position to position in small steps, each by the shape that is most like it, a mode keeps its number.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.residuals.peak_search import IndexArray
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance.chain import DiscreteDrive, discretise, undamped_modes
from monitor_core.models.published.receptance.parameters import ReceptanceParameters

#: Elastic modes that are followed; the highest may lose their partners at the edge and are not returned.
N_FOLLOWED = 10
#: Longest step along the screw, and the part of it that is searched for where a mode moves the table most. [of L]
_STEP, _FIRST, _LAST = 0.025, 0.1, 0.9
#: Points of the screw at which shapes are compared.
_N_POINTS = 24


@dataclass(frozen=True, slots=True, eq=False)
class ModeTracks:
    """Undamped elastic modes at some conditions, numbered from 1 by their frequency at the first position."""

    conditions: tuple[DriveConditions, ...]
    frequency: FloatArray  # shape (n_conditions, n_modes) [Hz]
    table_share: FloatArray  # φ² at the table over its largest along the screw, shape (n_conditions, n_modes) [-]
    nut_sensitivity: FloatArray  # d ln f/d ln k_n, shape (n_conditions, n_modes) [-]

    def __post_init__(self) -> None:
        for name in ("frequency", "table_share", "nut_sensitivity"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def n_modes(self) -> int:
        """How many modes."""
        return int(self.frequency.shape[1])


@dataclass(frozen=True, slots=True, eq=False)
class _Modes:
    """Modes at one position, in order of frequency; shapes of unit length."""

    frequency: FloatArray  # shape (n_modes,) [Hz]
    at_table: FloatArray  # φ², shape (n_modes,) [1/kg]
    nut_sensitivity: FloatArray  # shape (n_modes,) [-]
    shape: FloatArray  # √mass × displacement, shape (n_points, n_modes)

    def ordered(self, order: IndexArray) -> "_Modes":
        """Return the modes in another order."""
        return _Modes(self.frequency[order], self.at_table[order], self.nut_sensitivity[order], self.shape[:, order])


def track_modes(
    parameters: ReceptanceParameters,
    conditions: Sequence[DriveConditions],
    *,
    n_modes: int = 6,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> ModeTracks:
    r"""Follow the lowest elastic modes, 1 to 8, from position to position.

    Conditions may differ in preload and payload, which are followed each for itself. The sensitivity to the nut is its
    share of the strain energy, halved: with mass-normalised shapes :math:`\phi` and the deflection :math:`v^T \phi` of
    nut and bracket, of joint stiffness :math:`k_s`,

    .. math::

        \frac{\partial \ln f}{\partial \ln k_n} = \frac{k_s}{k_n} \frac{k_s (v^T \phi)^2}{2 \omega^2}

    (Rayleigh's quotient is stationary, so the shape need not be differentiated.)

    Raises OutsideValidityError if there is no condition, ``n_modes`` is out of range or a position is not on the screw.
    """
    if not conditions or not 1 <= n_modes <= N_FOLLOWED - 2:
        raise OutsideValidityError(
            f"modes must be followed at one position or more, and be 1 to {N_FOLLOWED - 2}; got {len(conditions)} "
            f"positions and {n_modes} modes"
        )
    frequency, share, sensitivity = (np.zeros((len(conditions), n_modes)) for _ in range(3))
    of_others = [replace(stated, position=0.5 * parameters.screw_length) for stated in conditions]
    for group in dict.fromkeys(of_others):
        members = [k for k, stated in enumerate(of_others) if stated == group]
        places = [conditions[k].position for k in members]
        first = min(places)
        followed = _followed(parameters, group, motor_end, _steps(parameters.screw_length, places))
        number = followed[first].frequency.argsort().argsort()  # modes are counted where the list begins
        order = np.argsort(number)[:n_modes]
        largest = np.max([modes.at_table[order] for modes in followed.values()], axis=0)
        for k in members:
            modes = followed[conditions[k].position]
            frequency[k], sensitivity[k] = modes.frequency[order], modes.nut_sensitivity[order]
            share[k] = modes.at_table[order] / largest
    return ModeTracks(tuple(conditions), frequency, share, sensitivity)


def _steps(length: float, places: Sequence[float]) -> tuple[float, ...]:
    """Return positions along the screw, those asked for among them, in steps that a shape can be followed over."""
    n = math.ceil((_LAST - _FIRST) / _STEP) + 1
    return tuple(sorted({*places, *(float(x) for x in np.linspace(_FIRST, _LAST, n) * length)}))


@lru_cache(maxsize=8)  # peaks are given their modes, and modes their bands, on one axis
def _followed(
    parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd, positions: tuple[float, ...]
) -> dict[float, _Modes]:
    modes = [_modes(parameters, replace(conditions, position=position), motor_end) for position in positions]
    followed = [modes[0]]
    for here in modes[1:]:
        alike = (followed[-1].shape.T @ here.shape) ** 2  # modal assurance criterion, shapes weighted by mass
        followed.append(here.ordered(scipy.optimize.linear_sum_assignment(-alike)[1]))
    return dict(zip(positions, followed, strict=True))


def _modes(parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd) -> _Modes:
    drive = discretise(parameters, conditions, motor_end)
    square, shapes = undamped_modes(drive, N_FOLLOWED)
    joints = drive.joints
    series = 1.0 / (1.0 / joints.nut_stiffness + 1.0 / joints.bracket_stiffness)
    deflection = drive.nut_deflection @ shapes
    sensitivity = series / joints.nut_stiffness * series * deflection**2 / (2.0 * square)
    sampled = _sampled(parameters, conditions.position, drive, shapes)
    table = _table(drive)
    return _Modes(np.sqrt(square) / (2.0 * np.pi), shapes[table] ** 2, sensitivity, sampled)


def _table(drive: DiscreteDrive) -> int:
    """Return the table's degree of freedom: the last that deflects the nut."""
    return int(np.flatnonzero(drive.nut_deflection)[-1])


def _sampled(parameters: ReceptanceParameters, position: float, drive: DiscreteDrive, shapes: FloatArray) -> FloatArray:
    """Return shapes at points that do not move with the table, by the root of the mass there, of unit length."""
    table = _table(drive)
    n_screw = table // 2
    points = (np.arange(_N_POINTS) + 0.5) / _N_POINTS * parameters.screw_length
    functions = _shape_functions(points, position, parameters.screw_length, n_screw)
    per_point = parameters.density * parameters.screw_length / _N_POINTS
    polar = parameters.torsional_rigidity / parameters.shear_modulus
    area = parameters.axial_rigidity / parameters.youngs_modulus
    bodies = np.sqrt(np.diag(drive.mass)[table:, None]) * shapes[table:]
    screw = [
        math.sqrt(per_point * section) * functions @ shapes[k * n_screw : (k + 1) * n_screw]
        for k, section in enumerate((area, polar))
    ]
    stacked = np.concatenate([*screw, bodies])
    return np.asarray(stacked / np.linalg.norm(stacked, axis=0))


def _shape_functions(points: FloatArray, position: float, length: float, n_screw: int) -> FloatArray:
    """Return the shape functions of a screw's degrees of freedom (ends and nut, then both pieces' polynomials)."""
    n_bubbles = (n_screw - 3) // 2
    k = np.arange(2, n_bubbles + 2)
    functions, pieces = np.zeros((points.size, n_screw)), np.arange(n_bubbles)
    for end, first, local, inside in (
        (0, 3, 2.0 * points / position - 1.0, points <= position),
        (2, 3 + n_bubbles, 2.0 * (length - points) / (length - position) - 1.0, points > position),
    ):
        legendre = np.polynomial.legendre.legvander(local, n_bubbles + 1)
        bubbles = (legendre[:, 2:] - legendre[:, :-2]) / np.sqrt(2.0 * (2.0 * k - 1.0))
        columns = np.column_stack([(1.0 - local) / 2.0, (1.0 + local) / 2.0, bubbles])
        functions[np.ix_(inside, np.r_[end, 1, first + pieces])] = columns[inside]
    return functions
