"""What the transmission-line model is judged by: the plain loop, the matrix of one step, and the continuous drive.

The plain loop shifts every section at every step, as the paper reads; the continuous drive is the determinant of a
dynamic stiffness matrix with rods as in any textbook, and knows nothing of waves, delays or stubs.
"""

import tomllib

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg

from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.transmission_line import TransmissionLineParameters
from monitor_core.models.published.transmission_line.grid import SMOOTH, discretise
from monitor_core.models.published.transmission_line.junctions import (
    BearingState,
    LoopState,
    MotorState,
    NutState,
    TableState,
    bearing_force,
    dry_friction,
    motor_torque,
    nut_against_a_held_table,
    nut_step,
    speed_loop,
    table_step,
)
from monitor_core.models.published.transmission_line.kernel import Inputs, LineState, Outputs, Rings, advance
from tests.conftest import PROJECT_ROOT


def shaft(**changes) -> TransmissionLineParameters:
    """Return the parameters of the paper's shaft in a plausible axis, some of them changed."""
    file = tomllib.loads((PROJECT_ROOT / "replay_data" / "models" / "transmission-line.toml").read_text("utf-8"))
    stated = TransmissionLineParameters.from_file_names(file["parameters"], file["family"])
    fields = {name: getattr(stated, name) for name in TransmissionLineParameters.__dataclass_fields__}
    return TransmissionLineParameters(**(fields | changes))


#: Dampers that bring every motion to rest within a tenth of a second, so that a transform of the run is complete.
HEAVY = {
    "table_damping": 1e5, "motor_damping": 3.0, "coupling_damping": 5.0, "nut_damping": 5e4, "bearing_damping": 2e4,
    "far_bearing_damping": 1e4,
}  # fmt: skip

UNDAMPED = {name: 0.0 for name in TransmissionLineParameters.__dataclass_fields__ if name.endswith("_damping")}


def drive_on(grid, parameters, position=0.6, motor_end=MotorEnd.FREE, friction=SMOOTH, *, control=None, **conditions):
    """Return the discretised drive and the places of its nut on both lines."""
    share = position / parameters.screw_length
    drive = discretise(parameters, grid, DriveConditions(position, **conditions), motor_end, friction, control=control)
    return drive, share * grid.axial_sections, share * grid.torsional_sections


def inputs_of(torque, axial_place, torsional_place, force=None, speed=None):
    torque = np.asarray(torque, dtype=float)
    full = [torque, *(np.zeros_like(torque) if values is None else values for values in (speed, force))]
    full += [np.broadcast_to(place, torque.shape) for place in (axial_place, torsional_place)]
    return Inputs(*(values.tolist() for values in full))


def empty_rings(drive):
    axial, torsional = drive.lines.axial_sections, drive.lines.torsional_sections
    return Rings(*([0.0] * n for n in (axial, axial, torsional, torsional)))


def empty_outputs(n):
    return Outputs(*([0.0] * n for _ in Outputs._fields))


def as_arrays(sequences):
    return type(sequences)(*(np.array(values, dtype=float) for values in sequences))


# --- the plain loop: every section is shifted at every step --------------------------------------------------------


def plain_loop(drive, inputs, waves=None):
    """Run the paper's loop: B[j] arrives at node j + 1, A[j] at node j; Eqs. (38) and (39) move all of them."""
    ma, mt, za, zt, i = drive.lines
    b, a, tb, ta = waves or (np.zeros(ma), np.zeros(ma), np.zeros(mt), np.zeros(mt))
    bearing, far_bearing, nut, table, motor = BearingState(), BearingState(), NutState(), TableState(), MotorState()
    loop, torque = LoopState(), 0.0
    outputs = empty_outputs(len(inputs.torque))
    for k in range(len(inputs.torque)):
        j, near, far = place(inputs.torsional_place[k])
        mobility = (near * near + far * far) / (2.0 * zt)
        rate = free_velocity(tb, ta, (j, near, far), zt)
        on_nut = dry_friction(drive.nut_friction, rate / mobility - torque, 1.0 / mobility)
        turning, torsional = i * (rate - mobility * on_nut), i * i * mobility
        twist = drive.bracket_compliance + near * far * drive.torsional_cell_compliance
        mean_force = 0.0
        for _ in range(drive.axial_substeps):
            n, p, q = place(inputs.axial_place[k])
            approach = turning + free_velocity(b, a, (n, p, q), za)
            admittance = torsional + (p * p + q * q) / (2.0 * za)
            compliance = twist + p * q * drive.axial_cell_compliance
            held, resistance = nut_against_a_held_table(drive.nut, nut, approach, (admittance, compliance))
            force, table = table_step(drive.table, table, held, resistance, inputs.force_at_table[k])
            rate = approach - admittance * force - table.velocity
            nut = nut_step(drive.nut, nut, rate, force, compliance)
            mean_force += force / drive.axial_substeps
            leave(b, a, n, 0.5 * p * force, 0.5 * q * force)
            outward, far_outward = float(-a[0]), float(b[-1])
            on_bearing, bearing = bearing_force(drive.bearing, bearing, outward)
            on_far_bearing, far_bearing = bearing_force(drive.far_bearing, far_bearing, far_outward)
            shift(b, a, outward - on_bearing, on_far_bearing - far_outward)
        torque = i * mean_force
        nut_torque = torque + on_nut
        leave(tb, ta, j, 0.5 * near * nut_torque, 0.5 * far * nut_torque)
        incident, far_incident = float(ta[0]), float(tb[-1])
        loop = speed_loop(drive.loop, loop, inputs.speed[k], motor.angle)
        on_rotor = inputs.torque[k] + loop.torque
        at_end, held, motor = motor_torque(drive.motor, motor, incident, on_rotor)
        shift(
            tb,
            ta,
            at_end - held - incident,
            dry_friction(drive.far_bearing_friction, 2 * far_incident, zt) - far_incident,
        )
        recorded = (
            table.force / drive.moving_mass, table.displacement, motor.angle, on_rotor, at_end, nut_torque, on_bearing,
            on_far_bearing,
        )  # fmt: skip
        for samples, value in zip(outputs, recorded, strict=True):
            samples[k] = value
    return outputs, (b, a, tb, ta)


def place(position):
    j = int(position)
    return j, 1.0 - (position - j), position - j


def free_velocity(b, a, place, impedance):
    j, near, far = place
    return float((near * (b[j - 1] - a[j]) + far * (b[j] - a[j + 1])) / impedance)


def leave(b, a, j, near, far):
    b[j - 1] -= near
    b[j] -= far
    a[j] += near
    a[j + 1] += far


def shift(b, a, from_left, from_right):
    b[1:] = b[:-1].copy()
    a[:-1] = a[1:].copy()
    b[0], a[-1] = from_left, from_right


# --- the matrix of one step: its eigenvalues are the poles of what the kernel does ----------------------------------

STUBS = (BearingState, BearingState, NutState, TableState, MotorState)


def in_space(rings, state):
    """Return the waves in the order of the sections they are in, whatever the turn of the rings."""
    ta, tt = state.axial_turn, state.torsional_turn
    turns = (ta, -ta, tt, -tt)
    return [np.roll(np.asarray(ring), turn) for ring, turn in zip(rings, turns, strict=True)]


def step_matrix(drive, axial_place, torsional_place):
    """Return the matrix of one torsional step, from a run of one step for each unit state."""
    step, inputs, outputs = advance, inputs_of([0.0], axial_place, torsional_place), empty_outputs(1)
    ma, mt = drive.lines.axial_sections, drive.lines.torsional_sections
    lengths = [ma, ma, mt, mt, *(len(stub._fields) for stub in STUBS)]
    ends = np.cumsum(lengths)
    rows, columns, values = [], [], []
    for column in range(ends[-1]):
        part = int(np.searchsorted(ends, column, side="right"))
        offset = column - (ends[part] - lengths[part])
        rings, stubs = empty_rings(drive), [stub() for stub in STUBS]
        if part < 4:
            rings[part][offset] = 1.0
        else:
            stubs[part - 4] = stubs[part - 4]._replace(**{STUBS[part - 4]._fields[offset]: 1.0})
        state = step(drive, LineState(0, 0, *stubs), rings, inputs, outputs)
        after = np.concatenate([*in_space(rings, state), *(np.array(stub) for stub in state[2:7])])
        (row,) = np.nonzero(after)
        rows.append(row)
        columns.append(np.full(len(row), column))
        values.append(after[row])
    triplets = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return scipy.sparse.csc_matrix(triplets, shape=(ends[-1], ends[-1]))


def pole_of_matrix(matrix, time_step, frequency):
    """Return the pole s of a step matrix next to a frequency, by inverse iteration."""
    target = np.exp(2j * np.pi * frequency * time_step)
    shifted = scipy.sparse.linalg.splu((matrix - target * scipy.sparse.identity(matrix.shape[0])).tocsc())
    vector = np.random.default_rng(0).standard_normal(matrix.shape[0]) + 0j
    for _ in range(20):
        before, vector = vector, shifted.solve(vector)
        distance = np.vdot(before, vector) / np.vdot(before, before)
        vector /= np.linalg.norm(vector)
    return np.log(target + 1.0 / distance) / time_step


# --- energy of the discretised drive -------------------------------------------------------------------------------


def series_compliance(drive, axial_place, torsional_place):
    """Return the compliance of the bracket and of the split junction."""
    a, t = axial_place % 1.0, torsional_place % 1.0
    split = a * (1.0 - a) * drive.axial_cell_compliance + t * (1.0 - t) * drive.torsional_cell_compliance
    return drive.bracket_compliance + split


def stored_energy(drive, parameters, rings, state, compliance):
    """Return what lines and stubs hold: ∑w²Δt/Z, ½k(e + hė)² and ½m(v + hf/m)²."""
    h, ht = drive.table.half_step, drive.motor.half_step
    ar, al, tr, tl = (np.asarray(ring) for ring in rings)
    energy = np.sum(ar**2 + al**2) * 2.0 * h / drive.lines.axial_impedance
    energy += np.sum(tr**2 + tl**2) * 2.0 * ht / drive.lines.torsional_impedance
    for stiffness, end in (
        (parameters.bearing_stiffness, state.bearing), (parameters.far_bearing_stiffness, state.far_bearing),
    ):  # fmt: skip
        energy += 0.5 * stiffness * (end.displacement + h * end.velocity) ** 2
    nut, table, motor = state.nut, state.table, state.motor
    energy += 0.5 * drive.nut.stiffness * (nut.deflection + h * nut.rate) ** 2
    energy += 0.5 / compliance * (nut.series_deflection + h * nut.series_rate) ** 2
    energy += 0.5 * drive.moving_mass * (table.velocity + h * table.force / drive.moving_mass) ** 2
    energy += 0.5 * parameters.coupling_stiffness * (motor.twist + ht * motor.twist_rate) ** 2
    inertia = parameters.rotor_inertia
    return energy + 0.5 * inertia * (motor.rate + ht * motor.torque / inertia) ** 2


# --- the continuous drive ------------------------------------------------------------------------------------------


def dynamic_stiffness(parameters, position, omega, **axial):
    """Return the stiffness matrix of (u_0, u_nut, u_L, rotor, θ_0, θ_nut, θ_L, table) at ω, undamped, rotor free.

    ``axial`` may state another rigidity [N] and speed [m/s] of the axial waves.
    """
    p = parameters
    i = p.transmission_ratio
    k = np.zeros((8, 8))
    lengths = (position, p.screw_length - position)
    for rigidity, speed, nodes in (
        (axial.get("rigidity", p.axial_rigidity), axial.get("speed", p.axial_speed), (0, 1, 2)),
        (p.torsional_rigidity, p.torsional_speed, (4, 5, 6)),
    ):
        kappa = omega / speed
        for first, length in zip((0, 1), lengths, strict=True):
            here = np.ix_(nodes[first : first + 2], nodes[first : first + 2])
            cos, sin = np.cos(kappa * length), np.sin(kappa * length)
            k[here] += rigidity * kappa / sin * np.array([[cos, -1.0], [-1.0, cos]])
    k[0, 0] += p.bearing_stiffness
    k[2, 2] += p.far_bearing_stiffness
    k[3:5, 3:5] += p.coupling_stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    k[3, 3] -= omega**2 * p.rotor_inertia
    k[7, 7] -= omega**2 * p.table_mass
    across = np.zeros(8)
    across[[1, 5, 7]] = 1.0, i, -1.0
    return k + np.outer(across, across) / (1.0 / p.nut_stiffness + 1.0 / p.bracket_stiffness)


def continuous_frequency(parameters, position, near, within=2e-3, **axial):
    """Return the natural frequency of the continuous drive next to one, in hertz."""

    def determinant(frequency):
        sign, logarithm = np.linalg.slogdet(dynamic_stiffness(parameters, position, 2 * np.pi * frequency, **axial))
        return sign * np.exp(logarithm - scale)

    _, scale = np.linalg.slogdet(dynamic_stiffness(parameters, position, 2 * np.pi * near, **axial))
    return scipy.optimize.brentq(determinant, near * (1 - within), near * (1 + within), xtol=1e-13, rtol=1e-14)
