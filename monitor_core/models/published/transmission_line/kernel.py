"""Step waves through the lines, kept in rings: nothing is shifted, so the cost does not grow with the sections.

With m sections the wave that arrives at node j at step k is slot (j − k) mod m of the right-going ring and slot
(j + k) mod m of the left-going one. What leaves one end takes the slot of what has arrived at the other; the nut edits
two slots of each ring where they are, and moving it is only another index.

The same source runs as Python or, where numba is installed (extra ``compiled``), as machine code, and gives the same
numbers to the last bit.
"""

import functools
import importlib.util
from collections.abc import MutableSequence, Sequence
from typing import NamedTuple, Protocol, cast

from monitor_core.models.published.transmission_line.junctions import (
    Bearing,
    BearingState,
    Friction,
    LoopState,
    Motor,
    MotorState,
    Nut,
    NutState,
    SpeedLoop,
    Table,
    TableState,
    bearing_force,
    dry_friction,
    motor_torque,
    nut_against_a_held_table,
    nut_step,
    share_of_coupling,
    speed_loop,
    table_step,
)


class Lines(NamedTuple):
    """Both lines and what couples them."""

    axial_sections: int
    torsional_sections: int
    axial_impedance: float  # [N·s/m]
    torsional_impedance: float  # [N·m·s/rad]
    transmission: float  # [m/rad]


class LineDrive(NamedTuple):
    """The discretised drive: what does not change from step to step."""

    lines: Lines
    axial_substeps: int
    moving_mass: float  # of table and payload [kg]
    bracket_compliance: float  # [m/N]
    axial_cell_compliance: float  # of one axial section, as the table sees it [m/N]
    torsional_cell_compliance: float  # of one torsional section, as the table sees it [m/N]
    bearing: Bearing
    far_bearing: Bearing
    nut: Nut
    table: Table
    motor: Motor
    loop: SpeedLoop
    nut_friction: Friction
    far_bearing_friction: Friction


class LineState(NamedTuple):
    """State of everything that is not in the rings, and how far these have turned."""

    axial_turn: int = 0  # steps taken, modulo the number of sections
    torsional_turn: int = 0
    bearing: BearingState = BearingState()
    far_bearing: BearingState = BearingState()
    nut: NutState = NutState()
    table: TableState = TableState()
    motor: MotorState = MotorState()
    loop: LoopState = LoopState()
    load: float = 0.0  # torque of the nut's force on the screw [N·m]


class Rings(NamedTuple):
    """Waves in both lines, each of as many slots as its line has sections."""

    axial_right: MutableSequence[float]  # [N]
    axial_left: MutableSequence[float]  # [N]
    torsional_right: MutableSequence[float]  # [N·m]
    torsional_left: MutableSequence[float]  # [N·m]


class Inputs(NamedTuple):
    """What acts on the drive, one value for each step."""

    torque: Sequence[float]  # on the rotor, besides that of the loop [N·m]
    speed: Sequence[float]  # of the motor, as commanded [rad/s]
    force_at_table: Sequence[float]  # [N]
    axial_place: Sequence[float]  # of the nut, counted in axial sections [-]
    torsional_place: Sequence[float]  # of the nut, counted in torsional sections [-]


class Outputs(NamedTuple):
    """What is recorded, one value for each step."""

    acceleration: MutableSequence[float]  # of the table [m/s²]
    displacement: MutableSequence[float]  # of the table [m]
    angle: MutableSequence[float]  # of the motor [rad]
    motor_torque: MutableSequence[float]  # on the rotor [N·m]
    screw_torque: MutableSequence[float]  # of the coupling on the screw [N·m]
    nut_torque: MutableSequence[float]  # of the screw on the nut, its friction included [N·m]
    bearing_force: MutableSequence[float]  # of the screw on the mounting at x = 0, positive as the position [N]
    far_bearing_force: MutableSequence[float]  # at the far end [N]


class NutPlace(NamedTuple):
    """Where a nut between nodes j and j + 1 meets the waves of a line, and its weights on the two nodes."""

    right: int  # slot of the right-going wave that arrives at node j
    right_next: int  # at node j + 1
    left: int
    left_next: int
    near: float  # 1 − a, weight of node j [-]
    far: float  # a [-]


class Stepper(Protocol):
    """Advances rings and state over all inputs, writes the outputs and returns the last state."""

    def __call__(
        self, drive: LineDrive, state: LineState, rings: Rings, inputs: Inputs, outputs: Outputs, /
    ) -> LineState:
        """Return the last state."""
        ...


@functools.cache  # compiling takes seconds
def compiled_stepper() -> Stepper:
    """Return the stepper as machine code; it takes arrays of float64 instead of lists."""
    import numba  # noqa: PLC0415  an optional extra
    from numba.extending import register_jitable  # noqa: PLC0415

    for called in (
        bearing_force, dry_friction, motor_torque, nut_against_a_held_table, nut_step, share_of_coupling, speed_loop,
        table_step, _draw, _free_velocity, _place, _slot,
    ):  # fmt: skip
        register_jitable(called)
    return cast(Stepper, numba.njit(advance, nogil=True))


def compiler_installed() -> bool:
    """Tell whether the stepper can be compiled."""
    return importlib.util.find_spec("numba") is not None


def advance(drive: LineDrive, state: LineState, rings: Rings, inputs: Inputs, outputs: Outputs) -> LineState:
    """Advance rings and state over all inputs, write the outputs, return the last state; fastest with lists."""
    ar, al, tr, tl = rings
    ta, tt, bearing, far_bearing, nut, table, motor, loop, load = state
    ma, mt, za, zt, i = drive.lines
    for k in range(len(inputs.torque)):
        at = _place(inputs.torsional_place[k], tt, mt)
        mobility = (at.near * at.near + at.far * at.far) / (2.0 * zt)
        rate = _free_velocity(tr, tl, at, zt)
        nut_friction = 0.0
        if drive.nut_friction.static > 0.0:  # its load is known from the last step
            nut_friction = dry_friction(drive.nut_friction, rate / mobility - load, 1.0 / mobility)
        turning = i * (rate - mobility * nut_friction)
        torsional = i * i * mobility
        twist = drive.bracket_compliance + at.near * at.far * drive.torsional_cell_compliance

        mean_force, on_bearing, on_far_bearing = 0.0, 0.0, 0.0
        for _ in range(drive.axial_substeps):  # torsional values are held
            aa = _place(inputs.axial_place[k], ta, ma)
            approach = turning + _free_velocity(ar, al, aa, za)
            admittance = torsional + (aa.near * aa.near + aa.far * aa.far) / (2.0 * za)
            compliance = twist + aa.near * aa.far * drive.axial_cell_compliance
            held, resistance = nut_against_a_held_table(drive.nut, nut, approach, (admittance, compliance))
            force, table = table_step(drive.table, table, held, resistance, inputs.force_at_table[k])
            nut = nut_step(drive.nut, nut, approach - admittance * force - table.velocity, force, compliance)
            _draw(ar, al, aa, force)
            mean_force += force / drive.axial_substeps

            first, last = _slot(0, ta, ma), _slot(0, -ta, ma)  # what arrives at x = 0 and at the far end
            outward, far_outward = -al[first], ar[last]
            on_bearing, bearing = bearing_force(drive.bearing, bearing, outward)
            on_far_bearing, far_bearing = bearing_force(drive.far_bearing, far_bearing, far_outward)
            ar[last] = outward - on_bearing
            al[first] = on_far_bearing - far_outward
            ta = ta + 1 if ta + 1 < ma else 0

        load = i * mean_force
        _draw(tr, tl, at, load + nut_friction)
        loop = speed_loop(drive.loop, loop, inputs.speed[k], motor.angle)
        motor_torque_now = inputs.torque[k] + loop.torque
        first, last = _slot(0, tt, mt), _slot(0, -tt, mt)
        incident, far_incident = tl[first], tr[last]
        torque, friction, motor = motor_torque(drive.motor, motor, incident, motor_torque_now)
        tr[last] = torque - friction - incident
        # Table 1: the far end is free but for the friction of its bearing
        tl[first] = dry_friction(drive.far_bearing_friction, 2.0 * far_incident, zt) - far_incident
        tt = tt + 1 if tt + 1 < mt else 0

        outputs.acceleration[k] = table.force / drive.moving_mass
        outputs.displacement[k] = table.displacement
        outputs.angle[k] = motor.angle
        outputs.motor_torque[k] = motor_torque_now
        outputs.screw_torque[k] = torque
        outputs.nut_torque[k] = load + nut_friction
        outputs.bearing_force[k] = on_bearing
        outputs.far_bearing_force[k] = on_far_bearing
    return LineState(ta, tt, bearing, far_bearing, nut, table, motor, loop, load)


def _place(position: float, turn: int, sections: int) -> NutPlace:
    j = int(position)
    far = position - j
    return NutPlace(
        _slot(j, -turn, sections), _slot(j + 1, -turn, sections), _slot(j, turn, sections),
        _slot(j + 1, turn, sections), 1.0 - far, far,
    )  # fmt: skip


def _slot(node: int, turn: int, sections: int) -> int:
    """Return (node + turn) mod sections for −sections ≤ node + turn < 2 sections, without dividing."""
    slot = node + turn
    if slot < 0:
        return slot + sections
    return slot if slot < sections else slot - sections


def _free_velocity(right: Sequence[float], left: Sequence[float], at: NutPlace, impedance: float) -> float:
    """Return the velocity (B − A)/Z that the line would have under the nut without the nut."""
    near, next_ = right[at.right] - left[at.left], right[at.right_next] - left[at.left_next]
    return (at.near * near + at.far * next_) / impedance


def _draw(right: MutableSequence[float], left: MutableSequence[float], at: NutPlace, force: float) -> None:
    """Take a force from the line: each wave that passes a node loses half of that node's share, Eq. (37)."""
    near, far = 0.5 * at.near * force, 0.5 * at.far * force
    right[at.right] -= near
    right[at.right_next] -= far
    left[at.left] += near
    left[at.left_next] += far
