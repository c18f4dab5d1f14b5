"""The axis in time: modes of the screw side, coupling, motor and servo, with friction fed back at every step.

The linear part is reduced to the modes of the screw side below 5 kHz and propagated exactly (zero-order hold); friction
is taken at the middle of the step, by extrapolation. All windows of all measurements advance together.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tests.plant.chain import Axis, Condition, assemble_chain
from tests.plant.friction import Friction, advance_bristles
from tests.plant.motion import Encoder, Reference, Ripple, Servo

FloatArray = NDArray[np.float64]

#: Modes of the screw side above this are left out. [Hz]
HIGHEST_MODE = 5000.0


@dataclass(frozen=True, slots=True)
class Plant:
    """The whole machine."""

    axis: Axis = field(default_factory=Axis)
    friction: Friction | None = field(default_factory=Friction)  # None: without any
    servo: Servo = field(default_factory=Servo)
    ripple: Ripple = field(default_factory=Ripple)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What the sensors will see, at the internal rate; arrays of shape (n_steps, n_measurements, n_windows)."""

    sensor_torque: FloatArray  # between coupling and screw [N·m]
    motor_torque: FloatArray  # [N·m]
    nut_acceleration: FloatArray  # [m/s²]
    motor_travel: FloatArray  # lead/2π times the motor's angle [m]


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """dx/dt = A x + B u, with outputs C x + D u.

    u: motor torque, force on the table, torque on the screw under the nut, torque on the screw behind the sensor.
    Outputs: sensor torque, nut acceleration, motor angle, then the speeds of motor, table, screw under the nut and
    driven screw end.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray


def state_space(axis: Axis, condition: Condition) -> StateSpace:
    """Join the modes of the screw side (x: modal displacements, motor angle, and their rates) to coupling and motor."""
    chain = assemble_chain(axis, condition)
    frequencies, shapes, damping = chain.modes()
    kept = frequencies < HIGHEST_MODE
    shapes, omega, damping = shapes[:, kept], 2.0 * np.pi * frequencies[kept], damping[kept]
    m = omega.size
    n = m + 1
    inverse_mass = np.diag([*np.ones(m), 1.0 / axis.motor_inertia])
    twist = np.append(-shapes[chain.drive_rotation], 1.0)
    stiffness = np.diag([*omega**2, 0.0]) + axis.coupling_stiffness * np.outer(twist, twist)
    dashpots = np.diag([*2.0 * damping * omega, 0.0]) + axis.coupling_damping * np.outer(twist, twist)
    inputs = np.zeros((n, 4))
    inputs[m, 0] = 1.0
    for column, dof in enumerate((chain.table, chain.nut_rotation, chain.drive_rotation), start=1):
        inputs[:m, column] = shapes[dof]

    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse_mass @ stiffness, -inverse_mass @ dashpots]])
    b = np.vstack([np.zeros((n, 4)), inverse_mass @ inputs])
    rows = np.eye(2 * n)

    def rate(dof: int) -> FloatArray:
        return np.concatenate([np.zeros(n), shapes[dof], [0.0]])

    nut = np.append(shapes[chain.nut], 0.0)
    c = np.vstack(
        [
            np.concatenate([axis.coupling_stiffness * twist, axis.coupling_damping * twist]),
            nut @ a[n:],
            rows[m],
            rows[n + m],
            rate(chain.table),
            rate(chain.nut_rotation),
            rate(chain.drive_rotation),
        ]
    )
    d = np.zeros((7, 4))
    d[1] = nut @ b[n:]
    return StateSpace(a, b, c, d)


def propagators(axis: Axis, conditions: list[Condition], step: float) -> FloatArray:
    """Return per condition the matrix that takes [x, u] to [x after the step, outputs at its beginning]."""
    spaces = [state_space(axis, c) for c in conditions]
    # Conditions may differ in the number of modes below the limit: the others carry rows of zeros.
    n_states = max(s.a.shape[0] for s in spaces)
    combined = np.zeros((len(spaces), n_states + 7, n_states + 4))
    for matrix, s in zip(combined, spaces, strict=True):
        n = s.a.shape[0]
        block = np.zeros((n + 4, n + 4))
        block[:n, :n], block[:n, n:] = s.a, s.b
        exact = linalg.expm(block * step)
        matrix[:n, :n], matrix[:n, n_states:] = exact[:n, :n], exact[:n, n:]
        matrix[n_states:, :n], matrix[n_states:, n_states:] = s.c, s.d
    return combined


def simulate(
    plant: Plant,
    conditions: list[Condition],
    reference: Reference,
    step: float,
    table_force: FloatArray | None = None,
) -> Motion:
    """Run the axis along references of shape (n_steps, n_conditions, n_windows), from rest.

    ``table_force`` of the same shape is an outside disturbance on the table. [N]
    """
    axis, servo = plant.axis, plant.servo
    combined = propagators(axis, conditions, step)
    n_states = combined.shape[2] - 4
    n_steps, n_conditions, n_windows = reference.travel.shape
    load = np.zeros((n_conditions, n_states + 4, n_windows))  # the states, then the inputs
    state, inputs = load[:, :n_states], load[:, n_states:]
    seen = np.empty((4, n_steps, n_conditions, n_windows))
    angle, speed, acceleration = (
        r / axis.transmission for r in (reference.travel, reference.speed, reference.acceleration)
    )
    # The table has been standing at the first point of the reference.
    start = angle[0].copy()
    moving = np.array([axis.table_mass + axis.nut_mass + c.payload for c in conditions])[:, None]
    turning = axis.motor_inertia + axis.screw_inertia + axis.coupling_inertia
    inertia = turning + moving * axis.transmission**2  # what the servo's feed-forward expects
    speed_gain = inertia * servo.speed_bandwidth
    feed_forward = inertia * acceleration
    to_go = angle - start
    integral = np.zeros((n_conditions, n_windows))
    levels, presliding, viscosity = _friction_levels(plant, conditions)
    bristles = np.zeros((n_conditions, 3, n_windows))
    old_rates, rates = np.zeros_like(bristles), np.empty_like(bristles)
    outputs = np.empty((n_conditions, 7, n_windows))
    encoder = Encoder(servo, (n_conditions, n_windows))
    advanced = np.empty((n_conditions, n_states + 2, n_windows))
    of_states, of_load = combined[:, n_states:, :n_states], combined[:, : n_states + 2]

    for k in range(n_steps):
        # Speeds and angle depend on the states alone: the outputs with feed-through follow when the inputs are known.
        np.matmul(of_states, state, out=outputs)
        seen_angle, seen_speed = encoder.read(outputs[:, 2], outputs[:, 3], step)
        error = speed[k] - seen_speed + servo.position_gain * (to_go[k] - seen_angle)
        torque = feed_forward[k] + speed_gain * (error + integral / servo.reset_time)
        np.minimum(np.maximum(torque, -servo.torque_limit, out=torque), servo.torque_limit, out=torque)
        integral += step * error
        inputs[:, 0] = torque + plant.ripple.at(outputs[:, 2] + start)

        rates[:] = outputs[:, 4:]
        middle = 1.5 * rates
        old_rates *= 0.5
        middle -= old_rates
        rates, old_rates = old_rates, rates
        new_bristles = advance_bristles(bristles, middle, presliding, step)
        bristles += new_bristles
        bristles *= 0.5
        bristles /= presliding
        bristles *= -levels
        middle *= viscosity
        np.subtract(bristles, middle, out=inputs[:, 1:])
        bristles = new_bristles
        if table_force is not None:
            inputs[:, 1] += table_force[k]

        np.matmul(of_load, load, out=advanced)
        seen[0, k], seen[1, k], seen[2, k], seen[3, k] = advanced[:, -2], torque, advanced[:, -1], outputs[:, 2]
        state[:] = advanced[:, :n_states]
    seen[3] += start
    return Motion(seen[0], seen[1], seen[2], seen[3] * axis.transmission)


def _friction_levels(plant: Plant, conditions: list[Condition]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coulomb level per condition, presliding deflection and viscosity of guides, nut and bearing; shape (·, 3, 1)."""
    friction = plant.friction
    if friction is None:
        return np.zeros((len(conditions), 3, 1)), np.ones((1, 3, 1)), np.zeros((1, 3, 1))
    levels = np.array(
        [
            [
                friction.guide_force * c.guide_friction_scale,
                plant.axis.nut_drag_torque(c.preload),
                friction.bearing_torque,
            ]
            for c in conditions
        ]
    ) * np.array([[c.friction_scale] for c in conditions])
    presliding = np.array([friction.guide_presliding, friction.screw_presliding, friction.screw_presliding])
    viscosity = np.array([friction.guide_viscosity, friction.screw_viscosity, friction.screw_viscosity])
    return levels[:, :, None], presliding[None, :, None], viscosity[None, :, None]
