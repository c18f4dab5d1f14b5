r"""Find all natural frequencies and modes of the extended drive under many conditions at once, each exactly once.

Without damping, :math:`R = C + 1/Z` is the sum of what the parts of the drive would answer alone, screw in tension on
its base, screw in torsion, table (or all that the contacts of the nut carry, with its bracket), and each of these rises
with ω² between its poles (Foster's reactance theorem). So
there is exactly one natural frequency between two neighbouring poles of the parts. These are far apart, and a change of
sign on a grid finds them. Damping is then increased step by step, and Newton's method follows each pole.

Friction and hardening of the nut, which depend on the excitation, are left out, and so is the second mode, which is no
part of the drive.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.bending import own_frequencies as own_frequencies_of_bending
from monitor_core.models.extended.carried import own_frequencies
from monitor_core.models.extended.closed_form import (
    EntireParts,
    axial_part,
    characteristic,
    entire_parts,
    path_of,
    torsion_part,
)
from monitor_core.models.extended.conditions import AxisStates, EndMasks, axis_states, condition_arrays, end_masks
from monitor_core.models.extended.physics import AxisPhysics
from monitor_core.models.extended.settings import axis_at
from monitor_core.models.parameters import scaled_damping
from monitor_core.models.poles import zeros_between, zeros_near
from monitor_core.models.protocol import DriveConditions, MotorEnd, NaturalFrequency

Index = npt.NDArray[np.intp]

#: Largest step of the damping, and the smallest before a pole is given up, as shares of the damping.
_LARGEST_DEGREE, _SMALLEST_DEGREE = 0.5, 2.0**-14
#: Steps until the whole damping is there; one percent of loss in each part takes ten, five percent in the steel fifty.
_MOST_STEPS = 1000
#: By how much a pole may miss where it was expected, as a share of its distance to the next one, and of its magnitude.
_FOLLOWED, _LARGEST_MISS = 0.1, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """The undamped or partly damped drive, ready to be asked at any frequency under any of the conditions."""

    physics: AxisPhysics
    states: AxisStates
    ends: EndMasks

    def parts(self, omega: NumberArray, condition: Index) -> EntireParts:
        """Return the parts of the drive at frequencies [rad/s], each under its condition."""
        return entire_parts(self.physics, omega, self.states.at(condition), self.ends.at(condition))


def follow_damping(drives_with: Callable[[float], Drives], omega: ComplexArray, condition: Index) -> ComplexArray:
    """Follow the zeros from the undamped ones while damping grows, in steps so small that none takes another's place.

    ``drives_with`` returns the drives with a share of their damping. Zeros are sought where they would be if they went
    on as in the step before, so that those that move alongside each other, however near, need no small steps.
    """
    share, degree, slope = 0.0, _LARGEST_DEGREE, np.zeros_like(omega)
    for _ in range(_MOST_STEPS):
        degree = min(degree, 1.0 - share)
        expected = omega + degree * slope
        after = _newton(drives_with(share + degree), expected, condition)
        room = np.minimum(_room(expected, condition), _room(after, condition))
        if np.all(np.abs(after - expected) <= room):  # not where it is nan
            slope = (after - omega) / degree
            omega, share, degree = after, share + degree, min(2.0 * degree, _LARGEST_DEGREE)
            if share >= 1.0:
                return omega
        elif degree > _SMALLEST_DEGREE:
            degree *= 0.5
        else:
            break
    lost = float(np.abs(omega[np.argmin(room - np.abs(after - expected))])) / (2.0 * math.pi)
    raise OutsideValidityError(
        f"the mode near {lost:.6g} Hz is damped so strongly that it ceases to oscillate or meets another one, "
        f"at {share:.3%} of its damping; this model needs underdamped modes"
    )


def _room(omega: ComplexArray, condition: Index) -> FloatArray:
    """Return how far each zero may be missed: by a share of the distance to the next zero, or to its mirror image."""
    apart = np.where(condition[:, None] == condition[None, :], np.abs(omega[:, None] - omega[None, :]), np.inf)
    np.fill_diagonal(apart, 2.0 * omega.real)
    return np.asarray(np.minimum(_FOLLOWED * np.min(apart, axis=1), _LARGEST_MISS * np.abs(omega)))


def _newton(drives: Drives, start: ComplexArray, condition: Index) -> ComplexArray:
    """Return the zeros of the characteristic function next to ``start``; nan if one of them is not found."""
    three_times = np.tile(condition, 3)
    return zeros_near(lambda omega: np.asarray(characteristic(drives.parts(omega, three_times))), start)


#: Lines of the grid per half wave of the screw, and at least. Poles of one part must not lie closer than two lines.
_PER_HALF_WAVE, _FEWEST_LINES = 40.0, 400
#: Half waves of the screw that are followed: a screw of 20 m has 50 below 2 kHz.
_MOST_HALF_WAVES = 500
#: Where the search begins, as a share of the highest frequency; slower is the rigid body.
_LOWEST = 1e-6
#: Relative distance from which a natural frequency is distinguished from a pole of a part.
_APART = 1e-9
#: Damping ratios of what is part of the drive.
_RATIOS = (
    "base_damping_ratio", "table_absorber_damping_ratio", "nut_absorber_damping_ratio", "rotor_absorber_damping_ratio",
    "screw_end_absorber_damping_ratio",
)  # fmt: skip
#: What resonates within a part of the drive: the resonance may lie arbitrarily near those that the part has without.
_WITHIN_PARTS = {
    "base_compliance": "base_frequency",
    "screw_end_absorber_mass": "screw_end_absorber_frequency",
    "rotor_absorber_inertia": "rotor_absorber_frequency",
}


@dataclass(frozen=True, slots=True, eq=False)
class DriveModes:
    """Poles of the elastic modes under all conditions, one after the other; shape (n_modes,) each."""

    condition: Index  # which one a mode belongs to; rising, and within it in order of frequency
    undamped_omega: FloatArray  # [rad/s]
    pole: ComplexArray  # s = jω at the zero of the characteristic function [1/s]


def natural_frequencies(
    physics: AxisPhysics,
    conditions: Sequence[DriveConditions],
    motor_ends: Sequence[MotorEnd],
    highest_frequency: float,
) -> tuple[tuple[NaturalFrequency, ...], ...]:
    """Return the poles under each of the conditions in order of frequency, rigid-body mode first.

    There is a motor end for each of the conditions, and poles are given whose undamped natural frequency is below
    ``highest_frequency`` [Hz]. ``OutsideValidityError`` if the physics does not go with a condition, or a mode is
    damped so strongly that it does not oscillate.
    """
    modes = drive_modes(physics, conditions, motor_ends, highest_frequency)
    return tuple(
        _rigid(physics, motor_end) + _sorted(modes.pole[modes.condition == number])
        for number, motor_end in enumerate(motor_ends)
    )


def has_rigid_body_mode(physics: AxisPhysics, motor_end: MotorEnd) -> bool:
    """Tell whether nothing holds the drive as a whole."""
    held_by_servo = motor_end is MotorEnd.FREE and physics.added.servo_stiffness != 0.0
    return motor_end is not MotorEnd.CLAMPED and not held_by_servo and physics.added.guide_stiffness == 0.0


def drive_modes(
    physics: AxisPhysics,
    conditions: Sequence[DriveConditions],
    motor_ends: Sequence[MotorEnd],
    highest_frequency: float,
) -> DriveModes:
    """Return undamped natural frequencies and poles of all elastic modes; arguments as ``natural_frequencies``."""
    if not (math.isfinite(highest_frequency) and highest_frequency > 0.0):
        raise OutsideValidityError(f"highest_frequency must be positive and finite; got {highest_frequency} Hz")
    if physics.by_setting:
        return _modes_by_setting(physics, conditions, motor_ends, highest_frequency)
    states, ends = axis_states(physics, condition_arrays(conditions)), end_masks(motor_ends)
    undamped = Drives(with_damping(physics, 0.0), states, ends)
    omega, condition = _undamped(undamped, 2.0 * math.pi * highest_frequency)
    pole = omega.astype(np.complex128)
    if omega.size and with_damping(physics, 0.0) != physics:
        pole = follow_damping(lambda share: Drives(with_damping(physics, share), states, ends), pole, condition)
    return DriveModes(condition, omega, 1j * pole)


def _modes_by_setting(
    physics: AxisPhysics,
    conditions: Sequence[DriveConditions],
    motor_ends: Sequence[MotorEnd],
    highest_frequency: float,
) -> DriveModes:
    """Return the modes of an axis that is another one at each setting."""
    settings = condition_arrays(conditions)
    parts = [
        drive_modes(axis_at(physics, settings.setting(number)), [stated], [end], highest_frequency)
        for number, (stated, end) in enumerate(zip(conditions, motor_ends, strict=True))
    ]
    return DriveModes(
        np.concatenate([modes.condition + number for number, modes in enumerate(parts)]),
        np.concatenate([modes.undamped_omega for modes in parts]),
        np.concatenate([modes.pole for modes in parts]),
    )


def with_damping(physics: AxisPhysics, share: float) -> AxisPhysics:
    """Return the axis with a share of each of its dampers and loss factors."""
    return replace(
        physics,
        joints=scaled_damping(physics.joints, share),
        bodies=scaled_damping(physics.bodies, share),
        screw=scaled_damping(physics.screw, share),
        bending=replace(physics.bending, damping_ratio=share * physics.bending.damping_ratio),
        added=replace(physics.added, **{name: share * getattr(physics.added, name) for name in _RATIOS}),
    )


def _undamped(drives: Drives, highest: float) -> tuple[FloatArray, Index]:
    """Return the undamped natural frequencies in rad/s and the condition of each, both in order."""
    poles, of_condition = _poles_of_parts(drives, highest)
    numbers = np.arange(drives.states.position.size)
    low_end, high_end = np.full(numbers.size, _LOWEST * highest), np.full(numbers.size, highest)
    edges = np.r_[low_end, poles, high_end]
    owner = np.r_[numbers, of_condition, numbers]
    order = np.lexsort((edges, owner))
    edges, owner = edges[order], owner[order]
    inside = np.flatnonzero(owner[:-1] == owner[1:])  # an interval joins two edges of one condition
    condition, first, last = owner[inside], edges[inside] == low_end[0], edges[inside + 1] == highest
    low = np.where(first, edges[inside], edges[inside] * (1.0 + _APART))
    high = np.maximum(np.where(last, edges[inside + 1], edges[inside + 1] * (1.0 - _APART)), low)

    def undamped(omega: FloatArray, at: Index) -> FloatArray:
        return np.real(characteristic(drives.parts(omega, at)))

    parts_low, parts_high = drives.parts(low, condition), drives.parts(high, condition)
    at_low, at_high = np.real(characteristic(parts_low)), np.real(characteristic(parts_high))
    # no change of sign: the nut lies in a node of a mode of one part, which then is a mode of the drive as it stands
    # (and no rigid body, which makes the function small at the lowest frequency)
    roots = np.where(~first & (np.abs(at_low) < np.abs(at_high)), low, high)
    passes = np.sign(at_low) * np.sign(at_high) < 0.0
    roots[passes] = zeros_between(
        undamped, (low[passes], high[passes]), (at_low[passes], at_high[passes]), condition[passes]
    )
    # between two poles there is one, before the first and behind the last only if R passes zero there
    is_zero = (~first | (_sum_of(parts_low) < 0.0)) & (~last | (_sum_of(parts_high) > 0.0))
    roots, condition = roots[is_zero], condition[is_zero]
    order = np.lexsort((roots, condition))
    return roots[order], condition[order]


def _sum_of(parts: EntireParts) -> FloatArray:
    """Return R of the undamped drive. [m/N]."""
    path, carried = path_of(parts), parts.carried
    if carried.is_table:
        return np.asarray(np.real(path.compliance + 1.0 / carried.table))
    beyond_contacts = carried.nut_pole * carried.swing / carried.load
    return np.asarray(np.real(1.0 / path.nut + path.before_bracket + beyond_contacts))


def _poles_of_parts(drives: Drives, highest: float) -> tuple[FloatArray, Index]:
    """Return where screw or table alone would resonate, in rad/s, and the condition of each."""
    screw, added = drives.physics.screw, drives.physics.added
    slowness = math.sqrt(screw.axial_mass_share * screw.mass_per_length / screw.axial_rigidity) + math.sqrt(
        screw.torsion_share * screw.torsional_inertia_share * screw.inertia_per_length / screw.torsional_rigidity
    )
    half_waves = highest * slowness * screw.length / math.pi
    if not half_waves <= _MOST_HALF_WAVES:
        raise OutsideValidityError(
            f"expected a screw with at most {_MOST_HALF_WAVES} half waves below {highest / (2.0 * math.pi):g} Hz; got "
            f"{half_waves:.3g}: it is too long, too soft or too heavy"
        )
    n_lines = max(_FEWEST_LINES, math.ceil(_PER_HALF_WAVE * half_waves))
    grid = np.linspace(_LOWEST * highest, highest, n_lines)
    within = next((name for name in _WITHIN_PARTS if getattr(added, name)), None)
    if within is not None:  # poles with it lie between those without it and its own, one between each two (Rayleigh)
        held = replace(drives, physics=replace(drives.physics, added=replace(added, **{within: 0.0})))
        its = 2.0 * math.pi * getattr(added, _WITHIN_PARTS[within])
        grid = np.union1d(grid, [*_poles_of_parts(held, highest)[0], min(its, highest)])
        n_lines = grid.size
    n_conditions = drives.states.position.size
    everywhere, under_all = np.tile(grid, n_conditions), np.repeat(np.arange(n_conditions), n_lines)
    poles, owners = [np.zeros(0)], [np.zeros(0, dtype=np.intp)]
    for part in (_real_part(drives, axial_part), _real_part(drives, torsion_part)):
        values = part(everywhere, under_all).reshape(n_conditions, n_lines)
        condition, line = np.nonzero((values[:, :-1] < 0.0) != (values[:, 1:] < 0.0))
        between, at_both = (grid[line], grid[line + 1]), (values[condition, line], values[condition, line + 1])
        poles.append(zeros_between(part, between, at_both, condition))
        owners.append(condition)
    bracket = (1.0 / drives.physics.joints.bracket_stiffness + added.series_compliance) / drives.states.softening
    carried = own_frequencies(
        replace(added, guide_stiffness=max(added.guide_stiffness, 0.0)),
        bracket + np.zeros(n_conditions),
        drives.states.moving_mass,
    )
    bent = own_frequencies_of_bending(drives.physics.bending, drives.states.softening + np.zeros(n_conditions))
    for own in (carried, bent):
        condition, which = np.nonzero((own > _LOWEST * highest) & (own < highest))
        poles.append(own[condition, which])
        owners.append(condition)
    return np.concatenate(poles), np.concatenate(owners)


def _real_part(
    drives: Drives, part: Callable[[AxisPhysics, NumberArray, AxisStates, EndMasks], NumberArray]
) -> Callable[[FloatArray, Index], FloatArray]:
    def at(omega: FloatArray, condition: Index) -> FloatArray:
        return np.real(part(drives.physics, omega, drives.states.at(condition), drives.ends.at(condition)))

    return at


def _rigid(physics: AxisPhysics, motor_end: MotorEnd) -> tuple[NaturalFrequency, ...]:
    return (NaturalFrequency(0.0, 0.0),) if has_rigid_body_mode(physics, motor_end) else ()


def _sorted(poles: ComplexArray) -> tuple[NaturalFrequency, ...]:
    return tuple(
        NaturalFrequency(float(abs(s)) / (2.0 * math.pi), float((0.0 - s.real) / abs(s)))
        for s in poles[np.argsort(np.abs(poles))]
    )
