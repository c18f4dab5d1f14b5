"""Integrate the modes in time, all windows of all conditions together: one matrix product a step, friction implicit.

Between two samples the torque is a straight line, without the delay of half a step that a staircase has; the modes are
propagated exactly under it (first-order hold). Friction is constant over a step and found implicitly (backward Euler),
for it may stop the table within one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.generator.moves import Reference
from monitor_core.models.protocol import NormalModes

#: Natural frequency of the position loop: far below any mode, it only brings the table home. [rad/s]
SERVO_OMEGA = 2.0 * np.pi * 5.0


@dataclass(frozen=True, slots=True)
class GuideFriction:
    """Friction between table and guides: a Coulomb slider behind a spring, parallel to a dashpot.

    At rest the spring holds the table, elastically, up to the Coulomb force; the slider gives way there. Rolling guides
    begin to slide after some ten micrometres, which is as far as a ringing table moves: with a rigid grip
    (``presliding`` 0) the table would stand still where a real one rings on.
    """

    coulomb: float = 0.0  # F_C [N]
    viscous: float = 0.0  # c [N·s/m]
    presliding: float = 25e-6  # deflection at which sliding sets in, z_s [m]

    def __post_init__(self) -> None:
        for name, unit in (("coulomb", "N"), ("viscous", "N·s/m"), ("presliding", "m")):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise OutsideValidityError(f"{name} of the guides must not be negative; got {value} {unit}")

    def step(
        self, free_speed: FloatArray, gain: FloatArray, deflection: FloatArray, step: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        r"""Return speed, force and deflection of the spring after a step in which friction acts (backward Euler).

        .. math:: v = v_{free} + g F, \qquad F = -c v - \mathrm{clip}\left(\frac{F_C}{z_s}(z + h v), \pm F_C\right)

        has one solution, in closed form, since the force never rises with the speed. The spring's new deflection is
        what its force says; where it slides it keeps :math:`z_s`. Speed and deflection z before are in m/s and m, the
        gain g, positive, in m/(N·s), the step h in s; shape (...), and so are speed, force and deflection returned.
        """
        if self.coulomb == 0.0:
            speed = free_speed / (1.0 + gain * self.viscous)
            return speed, (speed - free_speed) / gain, deflection
        damped_speed, damped_gain = free_speed / (1.0 + gain * self.viscous), gain / (1.0 + gain * self.viscous)
        compliance = self.presliding / self.coulomb
        holding = (deflection + step * damped_speed) / (compliance + step * damped_gain)
        grip = np.minimum(np.maximum(holding, -self.coulomb), self.coulomb)
        speed = damped_speed - damped_gain * grip
        return speed, (speed - free_speed) / gain, compliance * grip


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What happened at each sample; shape (n_samples, n_conditions, n_windows)."""

    torque: FloatArray  # at the motor end, below half the sampling rate [N·m]
    acceleration: FloatArray  # of the table [m/s²]
    travel: FloatArray  # of the table from the start of the window [m]
    table_speed: FloatArray  # at the end of the step that begins at the sample [m/s]
    friction_force: FloatArray  # on the table, during that step [N]


@dataclass(frozen=True, slots=True, eq=False)
class _Propagator:
    """One step of the modes of all conditions; states are the modal displacements, then their rates."""

    #: Takes [states, torque now, torque after] to [states after, table speed after, acceleration now, travel now], all
    #: without friction; the next three say what a unit of friction adds to states, speed and acceleration.

    matrix: FloatArray  # shape (n_conditions, n_states + 3, n_states + 2)
    states_per_friction: FloatArray  # shape (n_conditions, n_states, 1)
    speed_per_friction: FloatArray  # shape (n_conditions, 1)
    acceleration_per_friction: FloatArray  # shape (n_conditions, 1)
    rigid_angle: FloatArray  # rigid-body mode at the motor end, shape (n_conditions, 1) [rad/(m·√kg)]
    rigid_displacement: FloatArray  # rigid-body mode at the table, shape (n_conditions, 1) [1/√kg]


def advance_modes(modes: Sequence[NormalModes], reference: Reference, friction: GuideFriction, step: float) -> Motion:
    """Drive the table along references, from rest.

    The torque is what moves the rigid drive along the reference against the friction, plus a weak position loop. The
    loop sees the rigid-body motion only: fed back from the flexible modes, with the delay of a sample, it could
    excite what it drives.

    References are of shape (n_samples + 1, n_conditions, n_windows), ``step`` apart [s]. ``OutsideValidityError`` if
    modes do not contain the motion of the rigid drive.
    """
    propagator = _propagator(modes, step)
    n_states = propagator.states_per_friction.shape[1]
    rigid_rate = n_states // 2
    wanted, wanted_rate = (
        reference.travel / propagator.rigid_displacement,
        reference.speed / propagator.rigid_displacement,
    )
    forward = _feed_forward(reference, friction, propagator)
    n_samples, n_conditions, n_windows = (forward.shape[0] - 1, *forward.shape[1:])
    motion = Motion(*(np.empty((n_samples, n_conditions, n_windows)) for _ in range(5)))
    corners = np.zeros((n_samples + 2, n_conditions, n_windows))  # of the torque, from one step before the window
    load = np.zeros((n_conditions, n_states + 2, n_windows))
    states, now, after = load[:, :n_states], load[:, n_states], load[:, n_states + 1]
    free = np.empty((n_conditions, n_states + 3, n_windows))
    speed_gain, acceleration_gain = propagator.speed_per_friction, propagator.acceleration_per_friction
    force, deflection = np.zeros((n_conditions, n_windows)), np.zeros((n_conditions, n_windows))
    for k in range(n_samples):
        lag, rate_lag = wanted[k] - states[:, 0], wanted_rate[k] - states[:, rigid_rate]
        after[...] = forward[k + 1] + (SERVO_OMEGA**2 * lag + 2.0 * SERVO_OMEGA * rate_lag) / propagator.rigid_angle
        np.matmul(propagator.matrix, load, out=free)
        free_speed = free[:, n_states]
        before = force
        speed, force, deflection = friction.step(free_speed, speed_gain, deflection, step)
        # the force jumps at the sample: the mean of both sides has no delay
        motion.acceleration[k] = free[:, n_states + 1] + acceleration_gain * (0.5 * (before + force))
        motion.travel[k] = free[:, n_states + 2]
        motion.table_speed[k] = speed
        motion.friction_force[k] = force
        np.multiply(propagator.states_per_friction, force[:, None, :], out=states)
        states += free[:, :n_states]
        now[...] = corners[k + 2] = after
    # A polygon with these corners has sinc²(f/f_s) of their spectrum; what it has above half the rate is its images,
    # which an anti-aliasing filter keeps from the record. This mean has the same to (2πf/f_s)⁴/240, and no delay.
    motion.torque[...] = (corners[:-2] + 10.0 * corners[1:-1] + corners[2:]) / 12.0
    return motion


def _feed_forward(reference: Reference, friction: GuideFriction, propagator: _Propagator) -> FloatArray:
    """Return the torque that moves the rigid drive; shape (n_samples + 1, n_conditions, n_windows)."""
    resistance = friction.coulomb * np.sign(reference.speed) + friction.viscous * reference.speed
    modal_force = reference.acceleration / propagator.rigid_displacement + propagator.rigid_displacement * resistance
    torque: FloatArray = modal_force / propagator.rigid_angle
    return torque


def _propagator(modes: Sequence[NormalModes], step: float) -> _Propagator:
    # Below half the sampling rate a force never moves the table against itself within a step, as the implicit
    # friction needs; what lies above it could not be recorded.
    kept = [modes_below(each, 0.5 / step) for each in modes]
    n = max(each.frequency.size for each in kept)
    omega, damping, angle, displacement = (
        np.array([np.pad(values, (0, n - values.size)) for values in columns])
        for columns in zip(
            *((2.0 * np.pi * m.frequency, m.damping_ratio, m.angle_at_motor, m.displacement_at_table) for m in kept),
            strict=True,
        )
    )
    # per mode: d/dt of [displacement, rate, force, slope of the force over a step]
    block = np.zeros((len(kept), n, 4, 4))
    block[..., 0, 1] = block[..., 1, 2] = step
    block[..., 1, 0] = -step * omega**2
    block[..., 1, 1] = -2.0 * step * damping * omega
    block[..., 2, 3] = 1.0
    exact = scipy.linalg.expm(block)
    constant, slope = exact[..., :2, 2], exact[..., :2, 3]

    matrix = np.zeros((len(kept), 2 * n + 3, 2 * n + 2))
    number = np.arange(n)
    for row in range(2):
        for column in range(2):
            matrix[:, row * n + number, column * n + number] = exact[..., row, column]
        matrix[:, row * n + number, 2 * n] = angle * (constant - slope)[..., row]
        matrix[:, row * n + number, 2 * n + 1] = angle * slope[..., row]
    matrix[:, 2 * n] = np.einsum("cm,cmj->cj", displacement, matrix[:, n : 2 * n])
    matrix[:, 2 * n + 1, :n] = -displacement * omega**2
    matrix[:, 2 * n + 1, n : 2 * n] = -2.0 * displacement * damping * omega
    matrix[:, 2 * n + 1, 2 * n] = np.sum(displacement * angle, axis=1)
    matrix[:, 2 * n + 2, :n] = displacement
    return _Propagator(
        matrix=matrix,
        states_per_friction=np.concatenate([displacement * constant[..., row] for row in range(2)], axis=1)[..., None],
        speed_per_friction=np.sum(displacement**2 * constant[..., 1], axis=1)[:, None],
        acceleration_per_friction=np.sum(displacement**2, axis=1)[:, None],
        rigid_angle=angle[:, :1],
        rigid_displacement=displacement[:, :1],
    )


def modes_below(modes: NormalModes, highest: float) -> NormalModes:
    """Keep the modes below a frequency, and refuse a drive that cannot move."""
    if modes.frequency.size == 0 or modes.frequency[0] != 0.0 or not modes.angle_at_motor[0]:
        raise OutsideValidityError("a session needs a drive that can move; this model has no rigid-body mode")
    kept = modes.frequency < highest
    if kept.size > 1 and not kept[1]:
        raise OutsideValidityError(
            f"the sampling rate must be above twice the first natural frequency, {modes.frequency[1]:g} Hz; "
            f"got {2.0 * highest:g} Hz"
        )
    return NormalModes(
        *(v[kept] for v in (modes.frequency, modes.damping_ratio, modes.angle_at_motor, modes.displacement_at_table))
    )
