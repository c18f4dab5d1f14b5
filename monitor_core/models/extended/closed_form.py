r"""Evaluate the extended drive in closed form, each line by itself, without solving a matrix.

The search for effects, and every model that states some, evaluate this; Tian's drive as published has a form of its
own in :mod:`monitor_core.models.published.receptance.closed_form`.

The force F in the nut meets, one after the other, nut, bracket, screw in tension, and screw in torsion behind the lead.
With the compliance C of all of them and the dynamic stiffness Z of the table,

.. math::

    C = \frac{1}{\kappa_n} + c_s + \frac{B}{A} + \frac{i^2 U}{T}, \qquad
    H_{table,force} = \frac{C}{1 + C Z}, \qquad H_{table,torque} = \frac{u}{1 + C Z}

where u is the travel of the unloaded nut per unit of torque. Eqs. (1)–(24) of Tian et al. written out, with a base
under the bearings, and springs at the guides and at the rotor. A, B, T, U and Z have no poles: multiplied out, the
drive has a characteristic function without poles, whose zeros are the poles of the drive. As mass or torsional
compliance of the screw go to zero nothing in it becomes singular, so that a lumped drive is a distributed one with
other numbers.

Where the nut has a mass of its own before the bracket, or something hangs on nut or table, the contacts carry more than
a table; :mod:`monitor_core.models.extended.carried` says what. What hangs on the rotor or on the far end of the screw
has a dynamic stiffness Z/d in parallel with theirs, and all of its part is multiplied out with d. A screw that bends
under the force in the nut is one more compliance in series with B/A (:mod:`monitor_core.models.extended.bending`). A
second axis is one more substructure, which the table carries, or which the bearings stand on.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from monitor_core.arrays import FloatArray, NumberArray, acts, reciprocal
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.bending import yielding
from monitor_core.models.extended.carried import Carried, SlidingBody, absorber, carried_by_contacts, sliding_body
from monitor_core.models.extended.conditions import AxisStates, EndMasks, axis_states, condition_arrays, end_masks
from monitor_core.models.extended.memory import Memory, recall
from monitor_core.models.extended.physics import AddedPhysics, AxisPhysics, JointPhysics, SecondAxis
from monitor_core.models.extended.traced import Traced, cosine_of_square, sinc_of_square
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.rod import RodWaves

#: Where springs with a causal loss factor have their stated stiffness: near a drive's first axial mode. [rad/s]
_LOSS_REFERENCE = 2.0 * np.pi * 200.0
_ONE = np.array(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class EntireParts:
    """The letters of the module's docstring, functions of ω without poles; shape (n_lines,) or ()."""

    axial: NumberArray  # A: A/B is the stiffness of the screw at the nut, with bearings, base and nut segment
    axial_yield: NumberArray  # B
    torsion: NumberArray  # T: T/U is the torsional stiffness at the nut, motor end included
    turning: NumberArray  # U, with i²
    torque_lever: NumberArray  # u T: travel of the unloaded nut per torque at the motor end
    held_torsion: NumberArray  # T times the angle there per torque
    nut: NumberArray  # κ_n [N/m]
    carried: Carried  # bracket and table, and what hangs on them
    stack: "Stack | None" = None  # where it meets a second axis that moves it


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """What force and torque meet; shape (n_lines,)."""

    nut: NumberArray  # κ_n [N/m]
    before_bracket: NumberArray  # C − 1/κ_n − c_s [m/N]
    carried: Carried  # bracket and table, and what hangs on them
    unloaded_travel: NumberArray  # u [m/(N·m)]
    unloaded_angle: NumberArray  # of the motor end per torque while no force acts in the nut [rad/(N·m)]

    @property
    def beside_nut(self) -> NumberArray:
        """C − 1/κ_n. [m/N]."""
        return self.carried.bracket + self.before_bracket

    @property
    def compliance(self) -> NumberArray:
        """C of the whole path. [m/N]."""
        return reciprocal(self.nut) + self.beside_nut


@dataclass(frozen=True, slots=True, eq=False)
class Receptances:
    """Responses of the drive; shape (n_lines,)."""

    table_per_force: NumberArray  # [m/N]
    table_per_torque: NumberArray  # and, by reciprocity, angle of the motor end per force [m/(N·m)]
    angle_per_torque: NumberArray  # [rad/(N·m)]


@dataclass(frozen=True, slots=True, eq=False)
class _FarRod:
    """The rod beyond the nut with what hangs on its end, all of it times d; shape (n_lines,)."""

    at_nut: NumberArray  # d c
    at_end: NumberArray  # d c + Z s
    sine_over_z: NumberArray  # d s
    z_sine: NumberArray  # d z − Z c [N/m]
    scale: NumberArray | float  # d


@dataclass(frozen=True, slots=True, eq=False)
class _Drive:
    """What the screw depends on."""

    physics: AxisPhysics
    states: AxisStates  # of each line


#: What bearings stand on has the stiffness held/gives: the ground, or nothing at all.
_Base = tuple[NumberArray | float, NumberArray | float]
_GROUND: _Base = (1.0, 0.0)
_NOTHING: _Base = (0.0, 1.0)


def entire_parts(
    physics: AxisPhysics, omega: NumberArray, states: AxisStates, ends: EndMasks, memory: Memory | None = None
) -> EntireParts:
    """Return all parts of the drive on lines ω, not zero, complex where poles are sought; states, ends of each line.

    A ``memory`` is one of these lines, with these ends; what it gives back is the same to the last bit.
    """
    joints, added = physics.joints, physics.added
    elastic = _elastic(joints, omega) * states.softening
    bracket = (1.0 / joints.bracket_stiffness + added.series_compliance) / elastic
    table = _table(physics, omega, states)
    table_pole: NumberArray | float = 1.0
    base, stack = _GROUND, None
    if physics.second is not None:
        stack = stack_of(physics.second, physics, omega, states)
        if physics.second.carried:
            table, table_pole = stack.table
        else:
            base = stack.base
        stack = None if physics.second.is_alone else stack
    here = _Drive(physics, states)
    return EntireParts(
        *_screw(here, omega, base, memory),
        *recall(memory, _torsion, here, omega, ends, memory),
        nut=states.nut_stiffness * elastic + _damper(omega, joints.nut_damping),
        carried=carried_by_contacts(added, omega, bracket, table, table_pole),
        stack=stack,
    )


def _table(physics: AxisPhysics, omega: NumberArray, states: AxisStates) -> NumberArray:
    """Return the dynamic stiffness of the table alone."""
    table: NumberArray = physics.added.guide_stiffness - omega * omega * states.moving_mass
    return table + _damper(omega, physics.bodies.table_damping)


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Where the second of two stacked axes meets the table that slides under the upper one; shape (n_lines,)."""

    second: SecondAxis
    states: AxisStates  # of the second
    ends: EndMasks
    parts: EntireParts  # of the second, its base held; the lower one carries that table
    body: SlidingBody
    n: NumberArray  # n/d: stiffness of the second where it meets that table
    d: NumberArray

    @property
    def table(self) -> tuple[NumberArray, NumberArray | float]:
        """What the nut of the lower axis meets: numerator and denominator."""
        return (self.body.determinant, 1.0) if self.second.is_alone else self.body.met_by_nut(self.n, self.d)

    @property
    def base(self) -> _Base:
        """What the upper axis stands on, likewise."""
        return _GROUND if self.second.is_alone else self.body.met_by_base(self.n, self.d)


def stack_of(second: SecondAxis, physics: AxisPhysics, omega: NumberArray, states: AxisStates) -> Stack:
    """Return how an axis meets its second one; arguments as :func:`entire_parts`."""
    axis, line = second.physics, np.zeros(np.shape(omega), dtype=np.intp)
    there = axis_states(axis, condition_arrays([DriveConditions(second.position)])).at(line)
    ends = end_masks([MotorEnd.FREE]).at(line)
    if second.carried:
        there = replace(there, moving_mass=there.moving_mass + states.payload_mass)
        parts = entire_parts(axis, omega, there, ends)
        body = sliding_body(second, omega, _table(physics, omega, states), _moments(second, axis, there))
        axial, axial_yield = _screw(_Drive(axis, there), omega, _NOTHING, None)
        free = replace(parts, axial=axial, axial_yield=axial_yield)
        return Stack(second, there, ends, parts, body, characteristic(free), characteristic(parts))
    parts = entire_parts(axis, omega, there, ends)
    body = sliding_body(second, omega, parts.carried.table, _moments(second, physics, states))
    drive = parts.nut * parts.axial * parts.torsion
    yields = parts.axial_yield * parts.torsion + parts.turning * parts.axial
    series = parts.axial * parts.torsion + parts.nut * yields + parts.carried.bracket * drive
    parts = replace(parts, carried=Carried(parts.carried.bracket, body.determinant, body.at_nut))
    return Stack(second, there, ends, parts, body, drive, series)


def _moments(
    second: SecondAxis, upper: AxisPhysics, states: AxisStates
) -> tuple[NumberArray, NumberArray, NumberArray]:
    """Return mass, first and second moment of what the lower table carries along the upper screw [kg, kg·m, kg·m²]."""
    screw = upper.screw
    at = states.position - second.upper_centre
    middle = 0.5 * screw.length - second.upper_centre
    table, rod = (
        states.moving_mass + screw.nut_segment_mass,
        screw.axial_mass_share * screw.mass_per_length * screw.length,
    )
    return (
        table + rod,
        table * at + rod * middle,
        table * at * at + rod * (middle * middle + screw.length * screw.length / 12.0),
    )


def second_table_per_force(physics: AxisPhysics, omega: NumberArray, states: AxisStates, ends: EndMasks) -> NumberArray:
    """Return how far the table of a second axis that this one carries goes per force at this table [m/N]."""
    if physics.second is None or not physics.second.carried:
        raise OutsideValidityError("a cross receptance is that of an axis that carries a second one; this one has none")
    stack = stack_of(physics.second, physics, omega, states)
    here = receptances_of(path_of(entire_parts(physics, omega, states, ends)))
    rods = _rods(_Drive(stack.second.physics, stack.states), omega, None)
    through = rods.near_bearing * rods.far_end + rods.far_bearing * rods.far.scale * rods.near_end  # base to nut
    # what yields or hangs on the upper axis without passing motion on: the poles by which its parts are multiplied out
    upper, carried = stack.second.physics, stack.parts.carried
    poles = _base_stiffness(upper.added, omega) * carried.table_pole * carried.nut_pole
    if acts(upper.bending.compliance):
        poles = poles * _bending(_Drive(upper, stack.states), omega)[0]
    follows: NumberArray = stack.body.across * through * stack.parts.nut * stack.parts.torsion * poles / stack.table[1]
    return here.table_per_force * follows


def _screw(drive: _Drive, omega: NumberArray, base: _Base, memory: Memory | None) -> tuple[NumberArray, NumberArray]:
    """Return A and B of the screw on a base."""
    axial, axial_yield = recall(memory, _axial, drive, omega, base, memory)
    if acts(drive.physics.bending.compliance):  # one more in series: B/A + y/d
        d, y = recall(memory, _bending, drive, omega)
        axial, axial_yield = axial * d, axial_yield * d + axial * y
    return axial, axial_yield


def _bending(drive: _Drive, omega: NumberArray) -> tuple[NumberArray, NumberArray]:
    """Return d and y of a screw that bends."""
    along = drive.states.position / drive.physics.screw.length
    return yielding(drive.physics.bending, omega, along, drive.states.softening)


def axial_part(
    physics: AxisPhysics, omega: NumberArray, states: AxisStates, stack: Stack | None
) -> tuple[NumberArray, NumberArray]:
    """Return A and B of a screw that does not bend."""
    base = _GROUND if stack is None or stack.second.carried else stack.base
    return _axial(_Drive(physics, states), omega, base, None)


@dataclass(frozen=True, slots=True, eq=False)
class _Rods:
    """Both rods with their bearings; shape (n_lines,)."""

    near: RodWaves[Any]
    far: _FarRod
    near_bearing: NumberArray  # [N/m]
    far_bearing: NumberArray
    near_end: NumberArray  # e
    far_end: NumberArray


def _rods(drive: _Drive, omega: NumberArray, memory: Memory | None) -> _Rods:
    physics, states = drive.physics, drive.states
    screw, joints, added, position = physics.screw, physics.joints, physics.added, states.position
    elastic = _elastic(joints, omega) * states.softening
    near_bearing = joints.bearing_stiffness * elastic + _damper(omega, joints.bearing_damping)
    far_bearing = joints.far_bearing_stiffness * elastic + _damper(omega, joints.far_bearing_damping)
    mass = screw.axial_mass_share * screw.mass_per_length
    compliance = 1.0 / (screw.axial_rigidity * states.softening * _steel(physics, omega))
    rods = position, screw.length, (compliance, compliance), mass
    near, unloaded = recall(memory, _waves_of_both, omega, *rods)
    far = _with_load_at_end(added, unloaded, omega)
    near_end = near.cosine + near_bearing * near.sine_over_z
    return _Rods(near, far, near_bearing, far_bearing, near_end, far.at_end + far_bearing * far.sine_over_z)


def _axial(drive: _Drive, omega: NumberArray, under: _Base, memory: Memory | None) -> tuple[NumberArray, NumberArray]:
    r"""Return A and B: both rods in parallel at the nut, each held by its bearing, the bearings held by the base.

    Of a rod and its bearing κ, the dynamic stiffness between nut (n) and base (b), all over :math:`e = c + \kappa s`:
    :math:`k_{nn} = (\kappa c - z)/e,\; k_{nb} = \kappa/e,\; k_{bb} = \kappa c/e`. What hangs on its end, of stiffness
    Z, makes that :math:`e = c + (\kappa + Z) s`, :math:`k_{nn} = ((\kappa + Z) c - z)/e` and
    :math:`k_{bb} = \kappa (c + Z s)/e`. On a base of stiffness :math:`g/c_b` the sums over both rods leave
    :math:`k_{nn} - k_{nb}^2/(g/c_b + k_{bb})` at the nut.
    """
    added, rods = drive.physics.added, _rods(drive, omega, memory)
    near, far, near_bearing, far_bearing = rods.near, rods.far, rods.near_bearing, rods.far_bearing
    near_end, far_end = rods.near_end, rods.far_end
    segment = omega * omega * drive.physics.screw.nut_segment_mass
    near_base, far_base = near_bearing * near.cosine, far_bearing * far.at_end
    near_nut, far_nut = near_base - near.z_sine, far_bearing * far.at_nut - far.z_sine
    stiffness = near_nut * far_end + near_end * (far_nut - segment * far_end)
    held, gives = under
    if acts(added.base_compliance):
        own = _base_stiffness(added, omega)
        held, gives = own * held, own * gives + added.base_compliance * held
    if not acts(gives):
        return stiffness, near_end * far_end
    on_base = near_base * far_end + near_end * far_base
    # (Σk_nn Σk_bb − (Σk_nb)²) e e', in which c² + s z = 1 has cancelled one e e'
    both = near_nut * far_base + far_nut * near_base - 2.0 * near_bearing * far_bearing * far.scale - segment * on_base
    both = both - near_bearing * near.z_sine * far_end - far_bearing * far.z_sine * near_end
    return stiffness * held + gives * both, near_end * far_end * held + gives * on_base


def _base_stiffness(added: AddedPhysics, omega: NumberArray) -> NumberArray | float:
    """Return the dynamic stiffness of the base over the static one, 1 where it does not yield."""
    if not acts(added.base_compliance):
        return 1.0
    ratio = omega / (2.0 * np.pi * added.base_frequency)
    own: NumberArray = 1.0 - ratio * ratio + 2j * added.base_damping_ratio * ratio
    return own


def _with_load_at_end(added: AddedPhysics, far: RodWaves[Any], omega: NumberArray) -> _FarRod:
    """Return the rod beyond the nut with what hangs on the far end of the screw."""
    if not acts(added.screw_end_absorber_mass):
        return _FarRod(far.cosine, far.cosine, far.sine_over_z, far.z_sine, 1.0)
    d, load = absorber(
        omega,
        added.screw_end_absorber_mass,
        added.screw_end_absorber_frequency,
        added.screw_end_absorber_damping_ratio,
    )
    at_nut = d * far.cosine
    return _FarRod(at_nut, at_nut + load * far.sine_over_z, d * far.sine_over_z, d * far.z_sine - load * far.cosine, d)


def _torsion(
    drive: _Drive, omega: NumberArray, ends: EndMasks, memory: Memory | None
) -> tuple[NumberArray, NumberArray, NumberArray, NumberArray]:
    """Return T, U with i², the lever of a torque, and the numerator of the angle where it acts."""
    physics, states = drive.physics, drive.states
    screw, joints, bodies, i = physics.screw, physics.joints, physics.bodies, physics.screw.transmission_ratio
    position, elastic = states.position, _elastic(joints, omega) * states.softening
    squared = omega * omega
    inertia = screw.torsional_inertia_share * screw.inertia_per_length
    at_motor_end = (1.0 - screw.torsional_inertia_share) * screw.inertia_per_length * screw.length
    compliance = screw.torsion_share / (screw.torsional_rigidity * states.softening * _steel(physics, omega))
    near_compliance = compliance * (1.0 - screw.far_end_held_share * position / screw.length)
    rods = position, screw.length, (near_compliance, compliance), inertia
    near, far = recall(memory, _waves_of_both, omega, *rods)

    # with the motor end of the screw free (0) and held there (1)
    segment = -squared * (screw.motor_segment_inertia + ends.prescribed * at_motor_end)
    beyond = -far.z_sine - squared * screw.nut_segment_inertia * far.cosine
    end_0 = near.cosine + segment * near.sine_over_z
    torsion_0 = (segment * near.cosine - near.z_sine) * far.cosine + end_0 * beyond
    torsion_1 = near.cosine * far.cosine + near.sine_over_z * beyond

    coupling = joints.coupling_stiffness * elastic + _damper(omega, joints.coupling_damping)
    rotor = physics.added.servo_stiffness - squared * (bodies.rotor_inertia + at_motor_end)
    rotor = rotor + _damper(omega, bodies.motor_damping)
    free: NumberArray | FloatArray = ends.free
    turns = free * rotor
    if acts(physics.added.rotor_absorber_inertia):
        added = physics.added
        d, load = absorber(
            omega, added.rotor_absorber_inertia, added.rotor_absorber_frequency, added.rotor_absorber_damping_ratio
        )
        free, turns = free * d, turns * d + free * load
    # held behind the coupling; a free rotor is in series with it, κ Z/(κ + Z), multiplied through with κ + Z
    held = torsion_0 + coupling * torsion_1
    loose = ends.prescribed + free * coupling
    fixed = ends.clamped + turns
    turning = far.cosine * (loose * end_0 + fixed * (end_0 + coupling * near.sine_over_z))
    return (
        loose * torsion_0 + fixed * held,
        i**2 * turning,
        i * loose * far.cosine,
        ends.prescribed * torsion_1 + free * held,
    )


def _elastic(joints: JointPhysics, omega: NumberArray) -> NumberArray:
    r"""Return the dynamic stiffness of the joints' springs over what is stated.

    .. math::

        1 + j \eta + \left[ (1 + j \eta_c) \left( \frac{\omega}{\omega_0} \right)^\gamma - 1 \right], \qquad
        \gamma = \frac{2}{\pi} \arctan \eta_c

    A loss that is the same at all frequencies stiffens a spring with frequency, or it would answer before it is pushed
    (Kjartansson, J. Geophys. Res. 84 (1979) 4737); the papers' η leaves that out.
    """
    causal = joints.causal_loss_factor
    if not acts(causal):
        # a real number where nothing is lost: the undamped drive is then computed in real numbers throughout
        return 1.0 + 1j * joints.loss_factor * _ONE if acts(joints.loss_factor) else _ONE
    dynamic: NumberArray = 1.0 + 1j * joints.loss_factor + (_causal(causal, omega) - 1.0)
    return dynamic


def _causal(loss_factor: float, omega: NumberArray) -> NumberArray:
    """Return the second term of :func:`_elastic` with its 1: of a spring that loses causally, over what is stated."""
    stiffening: NumberArray = (omega / _LOSS_REFERENCE) ** (2.0 / np.pi * np.arctan(loss_factor))
    return (1.0 + 1j * loss_factor) * stiffening


def _steel(physics: AxisPhysics, omega: NumberArray) -> NumberArray | float:
    """Return the moduli of the screw's steel over what is stated, a plain number where it loses nothing."""
    return _causal(physics.screw.causal_loss_factor, omega) if acts(physics.screw.causal_loss_factor) else 1.0


def _damper(omega: NumberArray, damping: float) -> NumberArray | float:
    """Return jωc, a plain number where nothing damps."""
    return (1j * damping) * omega if acts(damping) else 0.0


#: Added to a phase, so that none is zero: what it is divided into is then 1, and no other phase differs.
_NO_PHASE: Final = 1e-200


def _waves_of_both(
    omega: NumberArray,
    position: FloatArray,
    screw_length: float,
    compliances: tuple[float | NumberArray, float | NumberArray],
    inertia: float,
) -> tuple[RodWaves[Any], RodWaves[Any]]:
    """Return the trigonometry of two rods from compliance and inertia per length, either of which may be zero.

    Side by side: there are few lines, so that most of the time goes into calling numpy.
    """
    lengths = position, screw_length - position
    if any(isinstance(value, Traced) for value in (*lengths, *compliances, inertia)):
        near, far = (_waves(omega, *rod, inertia) for rod in zip(lengths, compliances, strict=True))
        return near, far
    length = np.empty((2, *position.shape))
    compliance = np.empty(length.shape, dtype=np.result_type(*compliances))
    length[0], length[1] = lengths
    compliance[0], compliance[1] = compliances
    phase = omega * (length * np.sqrt(compliance * inertia))
    cosine = np.cos(phase)
    phase += _NO_PHASE
    sinc = np.sin(phase)
    sinc /= phase
    sine_over_z = length * compliance * sinc
    z_sine = omega * omega * (inertia * length) * sinc
    return RodWaves(cosine[0], sine_over_z[0], z_sine[0]), RodWaves(cosine[1], sine_over_z[1], z_sine[1])


def _waves(omega: NumberArray, length: Any, compliance: Any, inertia: Any) -> RodWaves[Any]:  # noqa: ANN401 traced
    """Return the same of one rod as functions of the square of its phase, which has no root at zero."""
    square = omega * omega * (length * length * (compliance * inertia))
    square = square if isinstance(square, Traced) else Traced(square)
    sinc = sinc_of_square(square)
    return RodWaves(cosine_of_square(square), length * compliance * sinc, omega * omega * (inertia * length) * sinc)


def path_of(parts: EntireParts) -> Path:
    """Return what force and torque meet: the divisions of the closed form, once."""
    per_torsion = reciprocal(parts.torsion)
    return Path(
        parts.nut,
        parts.axial_yield * reciprocal(parts.axial) + parts.turning * per_torsion,
        parts.carried,
        parts.torque_lever * per_torsion,
        parts.held_torsion * per_torsion,
    )


def receptances_of(path: Path) -> Receptances:
    """Return all receptances between table and motor end."""
    travel, carried = path.unloaded_travel, path.carried
    if carried.is_table:
        compliance = path.compliance
        closed = reciprocal(1.0 + compliance * carried.table)
        per_torque = travel * closed
        return Receptances(compliance * closed, per_torque, path.unloaded_angle - travel * carried.table * per_torque)
    reached = carried.reached_through(reciprocal(path.nut) + path.before_bracket)
    return Receptances(
        reached.table_per_force, travel * reached.table_per_travel, path.unloaded_angle - travel**2 * reached.stiffness
    )


def characteristic(parts: EntireParts) -> NumberArray:
    r"""Return the characteristic function, whose zeros are the poles of the drive, shape (n_lines,).

    .. math::

        \Delta = \kappa_n A T + Z \left[ (1 + \kappa_n c_s) A T + \kappa_n (B T + i^2 U A) \right]

    or, with what is carried in place of the table, :math:`e S \kappa_n A T + L [A T + \kappa_n (B T + i^2 U A)]`. Its
    scale is without meaning.
    """
    axial_torsion = parts.axial * parts.torsion
    yields = parts.axial_yield * parts.torsion + parts.turning * parts.axial
    carried = parts.carried
    if carried.is_table:
        series = (1.0 + parts.nut * carried.bracket) * axial_torsion + parts.nut * yields
        return np.asarray(parts.nut * axial_torsion + carried.table * series)
    held = carried.nut_pole * carried.swing * parts.nut * axial_torsion
    return np.asarray(held + carried.load * (axial_torsion + parts.nut * yields))
