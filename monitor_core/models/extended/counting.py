r"""Count the natural frequencies of the undamped drive below a frequency, without seeking any.

A structure that is held at a point has, once it is let go there, one natural frequency more below ω where the dynamic
stiffness at that point is negative (Sturm; for continuous rods Wittrick & Williams, Q. J. Mech. Appl. Math. 24 (1971)
263). The drive is put together point by point, from rods held at both ends: these have one for each half wave. The
stiffness at a point, all before it let go and all behind it held, is a quotient of functions without poles, so that
what is added up are signs of products. At last the four parts (screw in tension, its bending, screw in torsion, what
the contacts carry) are joined in the nut, where the sum R of their compliances takes one away while it is negative.

Counted is what lies below ω² on the whole axis: a rigid body, and what a spring that pushes instead of pulling makes
of one, are among it.
"""

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray, NumberArray, acts
from monitor_core.models.extended.bending import stiffnesses
from monitor_core.models.extended.carried import absorber
from monitor_core.models.extended.closed_form import EntireParts, axial_part, path_of
from monitor_core.models.extended.conditions import AxisStates, EndMasks
from monitor_core.models.extended.physics import AxisPhysics

Counts = npt.NDArray[np.intp]


def count_below(
    physics: AxisPhysics, omega: FloatArray, states: AxisStates, ends: EndMasks, parts: EntireParts
) -> Counts:
    """Return how many natural frequencies of an undamped axis lie below each ω, shape (n_lines,).

    ``states`` and ``ends`` are those of each line, and ``parts`` what :func:`entire_parts` makes of them there.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # at a pole of a part
        return np.asarray(
            _of_axial(physics, omega, states, parts)
            + _of_bending(physics, omega, states)
            + _of_torsion(physics, omega, states, ends, parts)
            + _of_carried(omega, parts)
            - (_compliance(parts) < 0.0)
        )


def _of_axial(physics: AxisPhysics, omega: FloatArray, states: AxisStates, parts: EntireParts) -> Counts:
    """Count those of the screw in tension on its bearings and its base: bearings, then base, then nut."""
    screw, joints, added = physics.screw, physics.joints, physics.added
    compliance = 1.0 / (screw.axial_rigidity * states.softening)
    mass = screw.axial_mass_share * screw.mass_per_length
    near, far = states.position, screw.length - states.position
    d, hung = np.ones_like(omega), np.zeros_like(omega)
    if acts(added.screw_end_absorber_mass):
        d, hung = _absorber(omega, added.screw_end_absorber_mass, added.screw_end_absorber_frequency)
    near_end, near_half_waves = _end(omega, near, compliance, mass, joints.bearing_stiffness * states.softening)
    far_end, far_half_waves = _end(
        omega, far, compliance, mass, joints.far_bearing_stiffness * states.softening + hung / d
    )
    bends = acts(physics.bending.compliance)
    axial, base = axial_part(physics, omega, states, parts.stack) if bends else (parts.axial, parts.axial_yield)
    held, lower = near_end * far_end * d, np.zeros_like(omega, dtype=np.intp)
    stack = parts.stack
    if stack is not None and not stack.second.carried:
        # the lower axis with its table let go, held again where the upper one stands
        on, gives = (np.real(np.asarray(value)) for value in stack.base)
        lower = count_below(stack.second.physics, omega, stack.states, stack.ends, stack.parts) - _differ(on, gives)
        held = held * gives
    return np.asarray(
        lower + near_half_waves + far_half_waves + _differ(d, 1.0)
        + _differ(near_end, _sign_of_sine(near_half_waves)) + _differ(far_end, _sign_of_sine(far_half_waves))
        + _differ(np.real(base), held) + _differ(np.real(axial), np.real(base))
    )  # fmt: skip


def _of_bending(physics: AxisPhysics, omega: FloatArray, states: AxisStates) -> Counts | int:
    """Count those of the screw in bending."""
    if not acts(physics.bending.compliance):
        return 0
    each = [np.real(stiffness) for _, stiffness in stiffnesses(physics.bending, omega, states.softening)]
    return np.asarray(np.sum(_differ(np.stack(each), 1.0), axis=0))


def _of_torsion(
    physics: AxisPhysics, omega: FloatArray, states: AxisStates, ends: EndMasks, parts: EntireParts
) -> Counts:
    """Count those of the screw in torsion with its motor end: rotor, then the end of the screw, then the nut."""
    screw, added = physics.screw, physics.added
    inertia = screw.torsional_inertia_share * screw.inertia_per_length
    compliance = screw.torsion_share / (screw.torsional_rigidity * states.softening)
    near_compliance = compliance * (1.0 - screw.far_end_held_share * states.position / screw.length)
    near_phase = omega * states.position * np.sqrt(near_compliance * inertia)
    far_phase = omega * (screw.length - states.position) * np.sqrt(compliance * inertia)
    near, far = _whole(near_phase / np.pi), _whole(far_phase / np.pi + 0.5)
    at_motor_end = (1.0 - screw.torsional_inertia_share) * screw.inertia_per_length * screw.length
    rotor = added.servo_stiffness - omega * omega * (physics.bodies.rotor_inertia + at_motor_end)
    d = np.ones_like(omega)
    if acts(added.rotor_absorber_inertia):
        d, hung = _absorber(omega, added.rotor_absorber_inertia, added.rotor_absorber_frequency)
        rotor = rotor + hung / d
    coupling = physics.joints.coupling_stiffness * states.softening
    free = ends.free != 0.0
    of_rotor = np.where(free, (coupling + rotor) * d, 1.0)  # what both functions at the end of the screw are times
    torsion, turning = np.real(parts.torsion), np.real(parts.turning)
    return np.asarray(
        near + far + free * _differ(d, 1.0) + _differ(of_rotor, np.where(free, d, 1.0))
        + _differ(turning * _sign_of_cosine(far) * of_rotor, _sign_of_sine(near)) + _differ(torsion, turning)
    )  # fmt: skip


def _of_carried(omega: FloatArray, parts: EntireParts) -> Counts:
    """Count those of what the contacts carry, free of them: what hangs on it, then table, then nut."""
    carried = parts.carried
    before: FloatArray | float = 1.0
    upper = np.zeros_like(omega, dtype=np.intp)
    stack = parts.stack
    if stack is not None and stack.second.carried:  # the upper axis on a base that is held, then its yaw
        before = np.real(np.asarray(stack.table[1]))
        upper = count_below(stack.second.physics, omega, stack.states, stack.ends, stack.parts)
        upper = upper + _differ(before, np.real(stack.d))
    d, e, swing, load = (
        np.real(np.asarray(value)) for value in (carried.table_pole, carried.nut_pole, carried.swing, carried.load)
    )
    return np.asarray(upper + _differ(d, before) + _differ(e, 1.0) + _differ(swing, d) + _differ(load, e * swing))


def _compliance(parts: EntireParts) -> FloatArray:
    """Return R, the compliances of all that meets in the nut. [m/N]."""
    carried = parts.carried
    path = path_of(parts)
    of_carried: NumberArray = carried.nut_pole * carried.swing / carried.load
    return np.asarray(np.real(1.0 / path.nut + path.before_bracket + of_carried))


def _absorber(omega: FloatArray, mass: float, frequency: float) -> tuple[FloatArray, FloatArray]:
    """Return what :func:`absorber` does of one that is not damped."""
    d, load = absorber(omega, mass, frequency, 0.0)
    return np.real(d), np.real(load)


def _end(
    omega: FloatArray, length: FloatArray, compliance: NumberArray, mass: float, spring: NumberArray
) -> tuple[FloatArray, Counts]:
    """Return sin/z times the stiffness at the end of a rod that is held at the nut, and its half waves below ω."""
    phase = omega * length * np.sqrt(compliance * mass)
    return np.cos(phase) + spring * length * compliance * np.sinc(phase / np.pi), _whole(phase / np.pi)


def _whole(half_waves: FloatArray) -> Counts:
    return np.asarray(np.floor(half_waves), dtype=np.intp)


def _differ(values: FloatArray, others: FloatArray | float) -> Counts:
    """Return 1 where two functions differ in sign: their quotient, a stiffness, is negative."""
    return np.asarray((values < 0.0) != (others < 0.0), dtype=np.intp)


def _sign_of_sine(half_waves: Counts) -> FloatArray:
    return np.asarray(1.0 - 2.0 * (half_waves % 2))


_sign_of_cosine = _sign_of_sine  # of half waves counted from a quarter wave on
