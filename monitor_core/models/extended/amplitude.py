r"""Friction and hardening at a given excitation: the linear drive that comes closest, by Gaussian linearisation.

For a Gaussian motion the force :math:`F_c\,\mathrm{sign}(v)` is best replaced by a damper and :math:`k(1 + \beta
\delta^2)\delta` by a spring (least mean square error),

.. math::

    c_e = F_c \sqrt{\frac{2}{\pi}} \frac{1}{\sigma_v}, \qquad k_e = k (1 + 3 \beta \sigma_\delta^2)

(Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5). The rms values follow from the response
of the linear drive that contains both, to an excitation of the stated rms value that is flat over the lines of the
response and nothing outside them. An excitation level of 0 stands for small signals that friction does not see.
"""

from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.closed_form import Path, Values
from monitor_core.models.extended.conditions import AxisStates
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics

_GAUSSIAN = np.sqrt(2.0 / np.pi)
#: Relative change at which the motion is settled; a change of the result is of the same order.
_SETTLED = 1e-9
_ITERATIONS = 200


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """What the drive does at one guess of damper and spring; of shape (n_cases,)."""

    velocity: FloatArray  # σ_v of the table [m/s]
    velocity_slope: FloatArray  # d ln σ_v / d ln c_e [-]
    deflection_square: FloatArray  # σ_δ² of the nut [m²]


def linearise(path: Path, physics: AxisPhysics, lines: PreparedLines, states: AxisStates) -> Path:
    """Return the path with the damper that stands for friction and the spring that stands for a hardening nut.

    Parameters
    ----------
    path : Path
        Of the linear drive.
    physics : AxisPhysics
    lines : PreparedLines
    states : AxisStates
        Of the lines.

    Returns
    -------
    Path
        The same path where both effects are absent.

    Raises
    ------
    OutsideValidityError
        If friction holds the table at the stated excitation, a softening nut has no stiffness left, or no motion agrees
        with its own linearisation.
    """
    friction, cubic = physics.added.guide_friction, physics.added.cubic_nut_stiffness
    moving = lines.conditions.excitation_level > 0.0
    if not (np.any(moving) and (friction or cubic)):
        return path
    if friction:
        _require_sliding(path, lines, friction, moving)
    first = _motion(path, lines, np.zeros_like(lines.omega))
    damping = np.where(moving, friction * _GAUSSIAN / np.where(moving, first.velocity, 1.0), 0.0)
    square = np.zeros(lines.n_cases)
    for _ in range(_ITERATIONS):
        changed = _hardened(path, physics, states, cubic * square[lines.case])
        motion = _motion(changed, lines, damping[lines.case])
        # Newton on ln(c σ_v) = ln(F √(2/π)), whose left side rises ever more slowly; the spring by substitution
        missing = np.where(moving, friction * _GAUSSIAN - damping * motion.velocity, 0.0)
        step = np.log1p(missing / np.where(damping > 0.0, damping * motion.velocity, 1.0))
        step = np.where(damping > 0.0, step / (1.0 + motion.velocity_slope), 0.0)
        new_square = np.where(moving, motion.deflection_square, 0.0)
        settled = np.abs(step) < _SETTLED, np.abs(cubic * (new_square - square)) < _SETTLED
        damping, square = damping * np.exp(step), new_square
        if np.all(settled):
            changed = _hardened(path, physics, states, cubic * square[lines.case])
            return replace(changed, table=changed.table + 1j * lines.omega * damping[lines.case])
    raise OutsideValidityError(
        f"no motion of the axis agrees with its own linearisation (guide_friction {friction:g} N, cubic_nut_stiffness "
        f"{cubic:g} 1/m²); lower one of them or the excitation level"
    )


def _hardened(path: Path, physics: AxisPhysics, states: AxisStates, relative: FloatArray) -> Path:
    """Return the path with a nut that is stiffer by 3β σ_δ²."""
    if np.any(1.0 + 3.0 * relative <= 0.0):
        raise OutsideValidityError("the nut softens to nothing at the stated excitation; raise cubic_nut_stiffness")
    if not np.any(relative):
        return path
    spring = states.nut_stiffness * (1.0 + 1j * physics.joints.loss_factor)
    return replace(path, nut=path.nut + 3.0 * relative * spring)


def _motion(path: Path, lines: PreparedLines, damping: FloatArray) -> _Motion:
    """Return the rms motion of table and nut with a damper at the table, shape (n_lines,)."""
    compliance = path.compliance
    damper = 1j * lines.omega * damping
    table = path.table + damper
    reciprocal = 1.0 / (1.0 + compliance * table)
    displacement = np.where(lines.by_torque, path.unloaded_travel, compliance) * reciprocal
    force = np.where(lines.by_torque, path.unloaded_travel * table, 1.0) * reciprocal
    power = lines.weight * _square(lines.omega * displacement)
    velocity_square = _per_case(lines, power)
    falling = _per_case(lines, power * (compliance * damper * reciprocal).real)
    level = lines.conditions.excitation_level
    safe = np.where(velocity_square > 0.0, velocity_square, 1.0)
    return _Motion(
        level * np.sqrt(velocity_square),
        -falling / safe,
        level**2 * _per_case(lines, lines.weight * _square(force / path.nut)),
    )


def _require_sliding(path: Path, lines: PreparedLines, friction: float, moving: BoolArray) -> None:
    """Refuse friction that the excitation cannot overcome: c σ_v never exceeds the rms force on a table held still."""
    per_excitation = np.where(lines.by_torque, _square(path.unloaded_travel / path.compliance), 1.0)
    force = lines.conditions.excitation_level * np.sqrt(_per_case(lines, lines.weight * per_excitation))
    if np.any(moving & (friction * _GAUSSIAN >= force)):
        weakest = float(np.min(force[moving])) / _GAUSSIAN
        raise OutsideValidityError(
            f"guide_friction must lie below {weakest:g} N, beyond which it holds the table at the stated excitation; "
            f"got {friction:g} N"
        )


def _square(values: Values) -> FloatArray:
    return np.asarray(values.real**2 + values.imag**2)


def _per_case(lines: PreparedLines, values: FloatArray) -> FloatArray:
    """Return the sum over the lines of each case, shape (n_cases,)."""
    return np.asarray(np.bincount(lines.case, weights=values, minlength=lines.n_cases), dtype=np.float64)
