"""Compute one step of the junctions: the bearings, the nut, the table, the motor and its speed loop.

Force and torque are the voltage of the paper, velocity the current; B arrives at a junction with the screw coordinate,
A against it. Springs, masses and inertias are trapezoidal stubs, which store and return energy without loss: with half
a step h, a spring holds ½k(e + h ė)² and a mass ½m(v + h f/m)². Loops without delay are eliminated in closed form.

These functions and tuples are read by the compiler of ``kernel`` as well as by Python.
"""

import math
from typing import NamedTuple

#: Largest slope of 1/(1 + x²), at x = 1/√3.
STEEPEST = 3.0 * math.sqrt(3.0) / 8.0
_BEND = 1.0 / math.sqrt(3.0)
_CLOSE = 1e-9  # Newton's method doubles the digits
_MOST_ITERATIONS = 60  # where the solution is threefold each takes a third of the distance


class Friction(NamedTuple):
    """Dry friction at a place: Coulomb friction, and a static one that fades; N and m/s, or N·m and rad/s."""

    coulomb: float = 0.0
    static: float = 0.0
    stribeck_velocity: float = 0.0


class Bearing(NamedTuple):
    """A spring and a damper between the end of the axial line and ground."""

    half_step: float  # h [s]
    clamping: float  # ρ = (kh + c)/(Z + kh + c): 0 for a free end, 1 for a clamped one [-]
    spring: float  # kZ/(Z + kh + c) [N/m]
    impedance: float  # Z of the line [N·s/m]


class BearingState(NamedTuple):
    """Where the end of the axial line is."""

    displacement: float = 0.0  # [m]
    velocity: float = 0.0  # [m/s]


class Nut(NamedTuple):
    """Nut between both lines and the table, with the bracket in series."""

    half_step: float  # h [s]
    stiffness: float  # [N/m]
    resistance: float  # kh + c [N·s/m]


class NutState(NamedTuple):
    """How far the nut and what is in series with it are pressed together."""

    deflection: float = 0.0  # of the nut [m]
    rate: float = 0.0  # [m/s]
    series_deflection: float = 0.0  # of the bracket [m]
    series_rate: float = 0.0  # [m/s]


class Table(NamedTuple):
    """Table on its guides."""

    half_step: float  # h [s]
    mass_impedance: float  # m/h [N·s/m]
    viscous_friction: float  # [N·s/m]
    friction: Friction  # of the guides


class TableState(NamedTuple):
    """How the table moves."""

    displacement: float = 0.0  # [m]
    velocity: float = 0.0  # [m/s]
    force: float = 0.0  # sum of all forces on it [N]


class Motor(NamedTuple):
    """Rotor, coupling and front bearing at the motor end of the torsional line."""

    half_step: float  # h [s]
    prescribed: bool  # the torque acts on the screw, and nothing else does
    inertia_impedance: float  # J/h; 0 for a clamped rotor [N·m·s/rad]
    admittance: float  # 1/(J/h + c_m); 0 for a clamped rotor [rad/(N·m·s)]
    viscous_friction: float  # c_m [N·m·s/rad]
    coupling_stiffness: float  # k [N·m/rad]
    coupling_resistance: float  # kh + c [N·m·s/rad]
    impedance: float  # Z of the line [N·m·s/rad]
    friction: Friction  # of the bearing


class SpeedLoop(NamedTuple):
    """A sampled PI controller of the motor's speed, and a current that follows what it asks for with a lag."""

    proportional: float  # torque per speed; 0: the motor is driven by the stated torque alone [N·m·s/rad]
    per_sample: float  # sampling time over integral time [-]
    every: int  # steps in a sampling time
    sampling_time: float  # [s]
    followed: float  # of the distance to the torque asked for, in a step: 1 - exp(-step/lag) [-]


class LoopState(NamedTuple):
    """What the controller holds."""

    until: int = 0  # steps until the next sample
    angle: float = 0.0  # of the motor at the last one [rad]
    integral: float = 0.0  # of the error, over the integral time [rad/s]
    asked: float = 0.0  # torque [N·m]
    torque: float = 0.0  # that the current gives [N·m]


class MotorState(NamedTuple):
    """How the rotor turns and how far the coupling is twisted."""

    angle: float = 0.0  # of the rotor, or of the screw's end where the torque is prescribed [rad]
    rate: float = 0.0  # [rad/s]
    torque: float = 0.0  # sum of all torques on the rotor [N·m]
    twist: float = 0.0  # of the coupling [rad]
    twist_rate: float = 0.0  # [rad/s]


def bearing_force(bearing: Bearing, state: BearingState, outward: float) -> tuple[float, BearingState]:
    """Return the force of the line on the bearing, and its next state.

    From v = (2w − F)/Z and F = k u + c v with the displacement u at the end of the step. The wave that arrives, w, is B
    at the far end and −A at x = 0; the one that leaves is w − F in the same sense.
    """
    h = bearing.half_step
    memory = state.displacement + h * state.velocity
    force = bearing.spring * memory + 2.0 * bearing.clamping * outward
    velocity = (2.0 * outward - force) / bearing.impedance
    return force, BearingState(memory + h * velocity, velocity)


def nut_against_a_held_table(
    nut: Nut, state: NutState, approach: float, lines: tuple[float, float]
) -> tuple[float, float]:
    """Return the force on a table that is held, and by how much it falls per velocity of the table.

    ``approach`` is the velocity with which both lines would move the nut without any force, Eqs. (33) and (34) with
    F_a = 0; ``lines`` are their admittance [m/(N·s)] and the compliance in series with the nut [m/N].
    """
    h = nut.half_step
    admittance, compliance = lines
    spring = nut.stiffness * (state.deflection + h * state.rate)
    memory = state.series_deflection + h * state.series_rate
    gain = 1.0 / (1.0 + nut.resistance * (admittance + compliance / h))
    return (spring + nut.resistance * (approach + memory / h)) * gain, nut.resistance * gain


def dry_friction(friction: Friction, driving: float, impedance: float) -> float:
    """Return the friction against what drives a body: all of it where the body sticks.

    From Z v = driving − friction, implicit in v. Coulomb friction rises to the static one towards rest,
    F_c + (F_s − F_c)/(1 + (v/v_s)²) (Stribeck, in the form of Hess and Soom, 1990): with x = v/v_s that is
    x + ρ/(1 + x²) = (driving − F_c)/(Z v_s), ρ = (F_s − F_c)/(Z v_s), which has one solution where ρ ``STEEPEST`` ≤ 1.
    Its left side changes its curvature at x = 1/√3 alone, so that Newton's method comes to the solution from one side:
    from beyond it, or from rest.
    """
    if friction.static == 0.0:
        return 0.0
    size = abs(driving)
    if size <= friction.static:
        return driving
    against = friction.static
    if friction.static > friction.coulomb:
        fades, scale = friction.static - friction.coulomb, 1.0 / (impedance * friction.stribeck_velocity)
        reached, rho = (size - friction.coulomb) * scale, fades * scale
        ratio = reached if reached > _BEND + 0.75 * rho else 0.0
        for _ in range(_MOST_ITERATIONS):
            all_of_it = 1.0 + ratio * ratio
            change = (reached - ratio - rho / all_of_it) / (1.0 - 2.0 * rho * ratio / all_of_it / all_of_it)
            ratio += change
            if abs(change) <= _CLOSE * ratio:
                break
        against = friction.coulomb + fades / (1.0 + ratio * ratio)
    return against if driving > 0.0 else -against


def table_step(
    table: Table, state: TableState, held: float, resistance: float, force_at_table: float
) -> tuple[float, TableState]:
    """Return the force of the nut on the table, held − (resistance) v, and the next state of the table.

    From (m/h + c) v = F + external force + (m/h) v_old + F_old − friction.

    A table that sticks has no acceleration. Without that the trapezoidal rule would go on alternating between the last
    one and its opposite; forgetting it takes energy away and never adds any.
    """
    driving = held + force_at_table + table.mass_impedance * state.velocity + state.force
    impedance = table.mass_impedance + table.viscous_friction + resistance
    friction = dry_friction(table.friction, driving, impedance)
    memory = state.displacement + table.half_step * state.velocity
    if table.friction.static > 0.0 and friction == driving:
        return held, TableState(memory, 0.0, 0.0)
    velocity = (driving - friction) / impedance
    force = held - resistance * velocity
    rest = force + force_at_table - table.viscous_friction * velocity - friction
    return force, TableState(memory + table.half_step * velocity, velocity, rest)


def nut_step(nut: Nut, state: NutState, rate: float, force: float, compliance: float) -> NutState:
    """Return the next state; ``rate`` is that of the nut and the compliance in series together."""
    h = nut.half_step
    memory = state.series_deflection + h * state.series_rate
    series_rate = (compliance * force - memory) / h
    nut_rate = rate - series_rate
    return NutState(state.deflection + h * (state.rate + nut_rate), nut_rate, compliance * force, series_rate)


def share_of_coupling(motor: Motor) -> float:
    """Return how much of a torque on the end of the screw the coupling takes within a step, 0 to 1."""
    if motor.prescribed:
        return 0.0
    gain = 1.0 / (1.0 + motor.coupling_resistance * (motor.admittance + 1.0 / motor.impedance))
    return motor.coupling_resistance * gain / motor.impedance


def motor_torque(motor: Motor, state: MotorState, incident: float, torque: float) -> tuple[float, float, MotorState]:
    """Return the torques of the coupling and of the bearing's friction on the screw, and the next state.

    From ω = (T − T_f − 2A)/Z at the end of the line, (J/h + c) Ω = torque − T + … at the rotor, and the coupling
    between.
    """
    h = motor.half_step
    if motor.prescribed:
        friction = dry_friction(motor.friction, torque - 2.0 * incident, motor.impedance)
        rate = (torque - friction - 2.0 * incident) / motor.impedance
        return torque, friction, MotorState(state.angle + h * (state.rate + rate), rate, 0.0, 0.0, 0.0)
    spring = motor.coupling_stiffness * (state.twist + h * state.twist_rate)
    drive = torque + motor.inertia_impedance * state.rate + state.torque
    relative = drive * motor.admittance + 2.0 * incident / motor.impedance
    gain = 1.0 / (1.0 + motor.coupling_resistance * (motor.admittance + 1.0 / motor.impedance))
    coupling = (spring + motor.coupling_resistance * relative) * gain
    friction = 0.0
    if motor.friction.static > 0.0:  # it twists the coupling, which takes a share of it
        share = share_of_coupling(motor)
        left = 1.0 - share
        friction = dry_friction(motor.friction, (coupling - 2.0 * incident) / left, motor.impedance / left)
        coupling += share * friction
        relative += friction / motor.impedance
    rate = (drive - coupling) * motor.admittance
    twist_rate = relative - coupling * (motor.admittance + 1.0 / motor.impedance)
    # a clamped rotor is held by whatever torque it takes
    rest = torque - coupling - motor.viscous_friction * rate if motor.admittance > 0.0 else 0.0
    return (
        coupling,
        friction,
        MotorState(
            state.angle + h * (state.rate + rate),
            rate,
            rest,
            state.twist + h * (state.twist_rate + twist_rate),
            twist_rate,
        ),
    )


def speed_loop(loop: SpeedLoop, state: LoopState, speed: float, angle: float) -> LoopState:
    """Return the next state of a controller that compares a commanded speed [rad/s] with that of an encoder.

    At each sample T = K_p (e + ∑ e T_s/T_i) with e = speed − (θ − θ_before)/T_s, held until the next.
    """
    if loop.proportional == 0.0:
        return state
    until, before, integral, asked, torque = state
    if until == 0:
        error = speed - (angle - before) / loop.sampling_time
        integral += loop.per_sample * error
        asked = loop.proportional * (error + integral)
        until, before = loop.every, angle
    return LoopState(until - 1, before, integral, asked, torque + loop.followed * (asked - torque))
