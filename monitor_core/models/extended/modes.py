r"""Find all natural frequencies and modes of the extended drive under many conditions at once, each exactly once.

Without damping the natural frequencies below any frequency can be counted
(:mod:`monitor_core.models.extended.counting`). Each is sought by its number, from where it was in a similar axis if
that is known: none is missed, and none found twice. Damping is then increased step by step, and Newton's method follows
each pole.

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
from monitor_core.models.extended.closed_form import EntireParts, characteristic, entire_parts
from monitor_core.models.extended.conditions import AxisStates, EndMasks, axis_states, condition_arrays, end_masks
from monitor_core.models.extended.counting import count_below
from monitor_core.models.extended.physics import AxisPhysics
from monitor_core.models.extended.settings import alike_in_terms, axis_at, side_by_side
from monitor_core.models.parameters import scaled_damping, with_share_of
from monitor_core.models.poles import NumberedZeros, numbered_zeros, zeros_near
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
        return entire_parts(self.physics.at(condition), omega, self.states.at(condition), self.ends.at(condition))

    def count(self, omega: FloatArray, condition: Index) -> Index:
        """Return how many natural frequencies lie below, of a drive without damping."""
        physics, states, ends = self.physics.at(condition), self.states.at(condition), self.ends.at(condition)
        return count_below(physics, omega, states, ends, entire_parts(physics, omega, states, ends))

    def look(self, omega: FloatArray, condition: Index) -> tuple[Index, FloatArray]:
        """Return the same and Newton's step Δ/Δ', the slope from a place next to the axis, where Δ is real."""
        physics, states, ends = self.physics.at(condition), self.states.at(condition), self.ends.at(condition)
        aside = _ASIDE * omega
        parts = entire_parts(physics, omega + 1j * aside, states, ends)
        value = np.asarray(characteristic(parts))
        with np.errstate(divide="ignore", invalid="ignore"):
            step = value.real * aside / value.imag
        return count_below(physics, omega, states, ends, parts), step

    def slope(self, omega: FloatArray, condition: Index) -> FloatArray:
        """Return Δ' of a drive without damping."""
        aside = _ASIDE * omega
        return np.asarray(np.imag(characteristic(self.parts(omega + 1j * aside, condition))) / aside)


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


#: Natural frequencies that are sought under one condition: a screw of 20 m has 50 below 2 kHz.
_MOST_MODES = 500
#: Where the search begins, as a share of the highest frequency; slower is the rigid body.
_LOWEST = 1e-6
#: At which modes are counted before they are sought from nothing.
_LINES = 64
#: How far from the axis the slope is taken, relative: what is left of the function there is it to rounding.
_ASIDE = 1e-20
#: Damping ratios of what is part of the drive.
_RATIOS = (
    "base_damping_ratio", "table_absorber_damping_ratio", "nut_absorber_damping_ratio", "rotor_absorber_damping_ratio",
    "screw_end_absorber_damping_ratio",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class DriveModes:
    """Poles of the elastic modes under all conditions, one after the other; shape (n_modes,) each."""

    condition: Index  # which one a mode belongs to; rising, and within it in order of frequency
    undamped_omega: FloatArray  # [rad/s]
    pole: ComplexArray  # s = jω at the zero of the characteristic function [1/s]

    def of_each(self, n_conditions: int) -> list[FloatArray]:
        """Return the undamped natural frequencies under each of the conditions."""
        return np.split(self.undamped_omega, np.searchsorted(self.condition, np.arange(1, n_conditions)))


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
    near: Sequence[FloatArray] | None = None,
) -> DriveModes:
    """Return undamped natural frequencies and poles of all elastic modes; arguments as ``natural_frequencies``.

    Where those of a similar axis are known under each of the conditions, in rad/s, they are followed from there.
    """
    if not (math.isfinite(highest_frequency) and highest_frequency > 0.0):
        raise OutsideValidityError(f"highest_frequency must be positive and finite; got {highest_frequency} Hz")
    settings = condition_arrays(conditions)
    axes = [physics]
    if physics.by_setting:
        axes = [axis_at(physics, settings.setting(number)) for number in range(len(conditions))]
        if len(alike_in_terms(axes)) > 1:
            return _modes_of_each(axes, conditions, motor_ends, highest_frequency, near)
    states, ends = axis_states(side_by_side(axes), settings), end_masks(motor_ends)
    undamped = [with_damping(axis, 0.0) for axis in axes]
    omega, condition = _undamped(Drives(side_by_side(undamped), states, ends), 2.0 * math.pi * highest_frequency, near)
    pole = omega.astype(np.complex128)
    if omega.size and undamped != axes:

        def with_share(share: float) -> Drives:
            return Drives(side_by_side([with_damping(axis, share) for axis in axes]), states, ends)

        pole = follow_damping(with_share, pole, condition)
    return DriveModes(condition, omega, 1j * pole)


class FollowedModes:
    """Modes of axes that differ little from one to the next: each is followed from the last under as many conditions.

    Whatever was asked last, they are those of :func:`drive_modes`, to rounding.
    """

    def __init__(self) -> None:
        self._last: dict[int, list[FloatArray]] = {}

    def of(
        self,
        physics: AxisPhysics,
        conditions: Sequence[DriveConditions],
        motor_ends: Sequence[MotorEnd],
        highest_frequency: float,
    ) -> DriveModes:
        """Return undamped natural frequencies and poles as :func:`drive_modes` does."""
        modes = drive_modes(physics, conditions, motor_ends, highest_frequency, self._last.get(len(conditions)))
        self._last[len(conditions)] = modes.of_each(len(conditions))
        return modes


def _modes_of_each(
    axes: Sequence[AxisPhysics],
    conditions: Sequence[DriveConditions],
    motor_ends: Sequence[MotorEnd],
    highest_frequency: float,
    near: Sequence[FloatArray] | None,
) -> DriveModes:
    """Return the modes of an axis that has other terms at one setting than at another."""
    parts = [
        drive_modes(
            axis,
            [conditions[number]],
            [motor_ends[number]],
            highest_frequency,
            None if near is None else [near[number]],
        )
        for number, axis in enumerate(axes)
    ]
    return DriveModes(
        np.concatenate([modes.condition + number for number, modes in enumerate(parts)]),
        np.concatenate([modes.undamped_omega for modes in parts]),
        np.concatenate([modes.pole for modes in parts]),
    )


def omega_changes(
    modes: DriveModes, motor_ends: Sequence[MotorEnd], physics: AxisPhysics, conditions: Sequence[DriveConditions]
) -> Callable[[AxisPhysics, Sequence[DriveConditions]], FloatArray]:
    r"""Return how far the undamped modes of an axis move to another one, or to other conditions, to first order.

    .. math:: d\omega = -\frac{\Delta(\omega) - \Delta_0(\omega)}{\Delta_0'(\omega)}

    at the modes themselves; shape (n_modes,) [rad/s]. None of the axes depends on conditions. The answer raises
    ``OutsideValidityError`` where the other axis does not go with its conditions.
    """
    ends = end_masks(motor_ends)

    def drives(axis: AxisPhysics, under: Sequence[DriveConditions]) -> Drives:
        undamped = with_damping(axis, 0.0)
        return Drives(undamped, axis_states(undamped, condition_arrays(under)), ends)

    def value(of: Drives) -> FloatArray:
        return np.asarray(np.real(characteristic(of.parts(modes.undamped_omega, modes.condition))))

    here = drives(physics, conditions)
    value_here, slope = value(here), here.slope(modes.undamped_omega, modes.condition)
    return lambda axis, under: (value_here - value(drives(axis, under))) / slope


def with_damping(physics: AxisPhysics, share: float) -> AxisPhysics:
    """Return the axis with a share of each of its dampers and loss factors, itself where that is the same."""
    joints, bodies = scaled_damping(physics.joints, share), scaled_damping(physics.bodies, share)
    screw, bending = scaled_damping(physics.screw, share), with_share_of(physics.bending, ("damping_ratio",), share)
    added = with_share_of(physics.added, _RATIOS, share)
    before = (physics.joints, physics.bodies, physics.screw, physics.bending, physics.added)
    second = physics.second
    if second is not None:
        yaw = share * second.yaw_damping
        second = replace(second, physics=with_damping(second.physics, share), yaw_damping=yaw)
    elif all(part is same for part, same in zip((joints, bodies, screw, bending, added), before, strict=True)):
        return physics
    return replace(physics, joints=joints, bodies=bodies, screw=screw, bending=bending, added=added, second=second)


def _undamped(drives: Drives, highest: float, near: Sequence[FloatArray] | None) -> tuple[FloatArray, Index]:
    """Return the undamped natural frequencies in rad/s and the condition of each, both in order."""
    n_conditions = drives.states.position.size
    grid = np.linspace(_LOWEST * highest, highest, 2 if near is not None else _LINES)
    counts = drives.count(np.tile(grid, n_conditions), np.repeat(np.arange(n_conditions), grid.size))
    counts = np.maximum.accumulate(counts.reshape(n_conditions, grid.size), axis=1)
    n_modes = counts[:, -1] - counts[:, 0]
    if np.max(n_modes) > _MOST_MODES:
        raise OutsideValidityError(
            f"expected a screw with at most {_MOST_MODES} natural frequencies below {highest / (2.0 * math.pi):g} Hz; "
            f"got {np.max(n_modes)}: it is too long, too soft or too heavy"
        )
    condition = np.repeat(np.arange(n_conditions), n_modes)
    number = np.concatenate([np.arange(first + 1, last + 1) for first, last in counts[:, [0, -1]].tolist()])
    behind = np.sum(counts[condition] < number[:, None], axis=1)
    start = np.full(condition.size, np.nan)
    for here, omega in enumerate(near or ()):
        places = np.flatnonzero(condition == here)[: omega.size]
        start[places] = omega[: places.size]
    sought = NumberedZeros(condition, number, grid[behind - 1], grid[behind])
    return numbered_zeros(drives.look, drives.count, sought, start), condition


def _rigid(physics: AxisPhysics, motor_end: MotorEnd) -> tuple[NaturalFrequency, ...]:
    return (NaturalFrequency(0.0, 0.0),) if has_rigid_body_mode(physics, motor_end) else ()


def _sorted(poles: ComplexArray) -> tuple[NaturalFrequency, ...]:
    return tuple(
        NaturalFrequency(float(abs(s)) / (2.0 * math.pi), float((0.0 - s.real) / abs(s)))
        for s in poles[np.argsort(np.abs(poles))]
    )
